"""`twin.lab.process`.

Answers that are programs in any language: told numbers, say numbers, within the same limits."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from controllers import catalog
from controllers.interfaces import Feedback, Law, Measurement, Observer
from controllers.per_rig import SampledReference
from controllers.references import Circle
from twin.base.errors import LawError, ScenarioError
from twin.lab import child
from twin.lab.process import ANSWER_NAME, answering
from twin.lab.schema import AnswerTable

EXAMPLES = Path(__file__).parents[2] / "examples"
PERIOD = 0.002
STRANGE = "it sent something else than an answer"
PATH = SampledReference(Circle(amplitude=0.15, omega=0.75), PERIOD)
OTHER = """
import struct, sys
def read(n):
    return struct.unpack(f'<{n}d', sys.stdin.buffer.read(8 * n)) if n else ()
def say(*numbers):
    sys.stdout.buffer.write(struct.pack(f'<{1 + len(numbers)}d', len(numbers), *numbers))
    sys.stdout.flush()
while head := sys.stdin.buffer.read(8):
    what, time, *told = read(int(*struct.unpack('<d', head)))
"""


def compiled(folder: Path) -> AnswerTable:
    """The example in C."""
    if not (compiler := shutil.which("cc") or shutil.which("gcc")):
        pytest.skip("no C compiler here")
    flags = ["-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
    source = EXAMPLES / "entry_c" / "law.c"
    subprocess.run([compiler, *flags, "-o", folder / "law", source], check=True)
    return AnswerTable(kind="law", file="law", command=("./law",))


def script(folder: Path) -> AnswerTable:
    """The example in JavaScript."""
    if not shutil.which("node"):
        pytest.skip("no Node.js here")
    shutil.copy(EXAMPLES / "entry_js" / "law.js", folder)
    return AnswerTable(kind="law", file="law.js", command=("node", "law.js"))


def feedback(time: float, numbers: np.ndarray) -> Feedback:
    x, equivalent, rate, requested = np.split(numbers, [8, 16, 18], axis=-1)
    none = numbers[..., :0]
    return Feedback(time, x, equivalent, none, rate, requested, PATH, none)


@pytest.mark.short("script")
@pytest.mark.parametrize("example", [compiled, script])
def test_the_examples_give_what_the_same_law_gives_in_numpy(tmp_path, example) -> None:
    about = example(tmp_path)
    rng = np.random.default_rng(3)
    with answering(tmp_path / about.file, about) as asked:
        law = catalog.catalog(Law)[ANSWER_NAME]()
        for rigs in (7, 3):  # a second run begins without what the first has summed up
            q = np.zeros((rigs, 2))
            law.start(rng.normal(size=(rigs, 8)), PATH, PERIOD)
            for tick in range(40):
                numbers = rng.normal(scale=0.1, size=(rigs, 20))
                r, x = PATH(tick * PERIOD), numbers[:, 8:16]
                e, v = r[0] - x[:, [0, 4]], r[1] - x[:, [1, 5]]
                tilt = np.array([1, -1]) * (r[2] + 4 * e + 4 * v + q) / 7
                wanted = 400 * (tilt - x[:, [2, 6]]) - 40 * x[:, [3, 7]]
                got = law.command(feedback(tick * PERIOD, numbers))
                np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-9)
                q += PERIOD * e
        assert asked.failure is None


def write_program(folder: Path, lines: str, **settings: object) -> AnswerTable:
    """A program that is told what any program is, in Python without the twin."""
    (folder / "law.txt").write_text(OTHER + lines)
    command = (sys.executable, "-IS", "law.txt")
    return AnswerTable.model_validate(
        {"kind": "law", "file": "law.txt", "command": command, "seconds": 1.0} | settings
    )


def commanded(folder: Path, about: AnswerTable) -> np.ndarray:
    with answering(folder / about.file, about):
        law = catalog.catalog(Law)[ANSWER_NAME]()
        law.start(np.arange(16.0).reshape(2, 8), PATH, PERIOD)
        given = np.arange(40.0).reshape(2, 20)
        law.command(feedback(0.5, given))
        return law.command(feedback(0.502, given))


def test_a_program_is_told_what_the_page_says(tmp_path) -> None:
    lines = """
    if what == 0:
        assert (time, told) == (0.002, [float(k) for k in range(16)])
        continue
    assert what == 1
    say(told[20], told[50 + 1], told[-30], time)
"""
    got, wanted = commanded(tmp_path, write_program(tmp_path, lines)), PATH(0.502)[0]
    assert got.tolist() == [wanted.tolist(), [20.0, 0.502]]


def test_an_observer_may_be_a_program(tmp_path) -> None:
    lines = """
    if what:
        rigs = len(told) // (6 if what == 1 else 2)
        say(*[what + 10 * rig + told[-1] for rig in range(rigs) for _ in range(16)])
"""
    about = write_program(tmp_path, lines, kind="observer")
    with answering(tmp_path / about.file, about):
        observer = catalog.catalog(Observer)[ANSWER_NAME]()
        observer.start(np.zeros((2, 8)))
        seen = Measurement(0.1, np.zeros((2, 4)), np.zeros(2), np.array([False, True]))
        assert observer.correct(seen).tolist() == [[2.0] * 8, [12.0] * 8]
        observer.predict(np.full((2, 2), 0.5))
        assert observer.equivalent.tolist() == [[2.5] * 8, [12.5] * 8]


@pytest.mark.short(
    "    if what: sys.exit()-*",
    "    if what: say(0, 0)-*",
    "    if what: say(float('nan')*",
    "    if what: print('hello')*",
)
@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("    if what: 1 / 0", "ended by itself (1): ZeroDivisionError: division by zero"),
        ("    if what: __import__('os').kill(__import__('os').getpid(), 11)", "by itself (-11)"),
        ("    if what: sys.exit()", "its process ended by itself (0)"),
        ("    if what: say(float('nan'), 0, 0, 0)", "a number that it gives is not finite"),
        ("    if what: say(0, 0, 1e7, 0)", "a number that it gives is 1e+07"),
        ("    if what: say(0, 0)", f"{STRANGE} of 4 numbers"),
        ("    if what: say(*[0] * 8)", f"{STRANGE} of 4 numbers"),
        ("    if what: print('hello'); sys.stdout.flush()", STRANGE),
        pytest.param(
            "    if what: __import__('time').sleep(60)",
            "it took longer than 1 s",
            marks=pytest.mark.long,
        ),
        pytest.param("    while what: pass", "it took longer than 1 s", marks=pytest.mark.long),
        ("    while what: say(*[0] * 1000)", STRANGE),
    ],
)
def test_a_program_that_fails_is_told_in_one_line(tmp_path, lines, said) -> None:
    with pytest.raises(LawError) as caught:
        commanded(tmp_path, write_program(tmp_path, lines))
    assert said in str(caught.value)
    assert str(caught.value).startswith("law.txt: ")
    assert "\n" not in str(caught.value)


def test_a_program_that_cannot_be_begun_is_told_in_one_line(tmp_path) -> None:
    about = write_program(tmp_path, "")
    (tmp_path / "law.txt").write_bytes(b"\x7fELF no program")
    for command, said in (
        (("no-such-program",), "command: 'no-such-program': no such program here"),
        (("./law.txt",), "law.txt: OSError: [Errno 8] Exec format error"),
    ):
        with pytest.raises((LawError, ScenarioError)) as caught:
            commanded(tmp_path, about.model_copy(update={"command": command}))
        assert str(caught.value).startswith(said)
        assert "\n" not in str(caught.value)
    for kind in ("function", "numbers"):
        with pytest.raises(ValueError, match="command: belongs to an answer of kind law or obs"):
            AnswerTable(kind=kind, asked={"x": "m"}, function="f" if kind == "function" else "",
                        command=("node",))  # fmt: skip


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")
def test_a_program_reads_nothing_of_the_rigs_and_writes_nowhere_else(tmp_path) -> None:
    if not shut_in_here():
        pytest.skip("this system cannot shut a process in")
    secret = tmp_path / "rigs.csv"
    secret.write_text("truth")
    lines = f"""
    found = 0
    for place, mode in (({str(secret)!r}, 'r'), ({str(secret)!r}, 'a'), ('/etc/passwd', 'r')):
        try:
            open(place, mode)
        except PermissionError:
            found += 1
    open('own.txt', 'w').write('mine')
    if what: say(found, 0, 0, 0)
"""
    assert commanded(tmp_path, write_program(tmp_path, lines))[0, 0] == 3


def shut_in_here() -> bool:
    """Whether this system has Landlock, asked in a process that is not needed any more."""
    asks = f"import sys; sys.path.insert(0, {str(Path(child.__file__).parents[2])!r})\n"
    asks += "from twin.lab import child; print(child.shut_in(child.readable()))"
    return subprocess.check_output([sys.executable, "-c", asks], text=True).strip() == "True"
