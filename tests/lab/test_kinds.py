"""`twin.lab.process`.

Answers that are observers and functions: the same bits, one line for what goes wrong."""

import os
import pwd
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import ballplate as bp
from controllers import catalog
from twin.base.errors import LawError, ScenarioError
from twin.base.shipped import folder
from twin.lab.process import ANSWER_NAME, answering
from twin.lab.schema import AnswerTable, read
from twin.run.loop import simulate
from twin.scenario import load
from twin.study.schema import draw_rigs, read_family

MINI = Path(__file__).parent / "mini"
SOLUTION = (MINI / "solution.py").read_text()
OBSERVER = (folder() / "starts" / "observer.py").read_text()
FUNCTION = """
import numpy as np

def begin(log, late=0.0):
    at = int(np.argmax(log["time"] >= late))
    return {"start": log["measured_x"][at] + 0.002 * np.array([-1, 1])}
"""
LAB = """
schema = "ballplate/lab/v1"
name = "found"
version = 1
title = "Where was the ball put down"

[answer]
kind = "function"
function = "begin"
asked = {start = "m"}
seconds = 3

[[check]]
name = "four rigs"
scenario = "hold.toml"
set = ["duration=0.1", "metrics.start=0"]
family = "family.toml"
rigs = 4
draw = 1
number = "start"
truth = "plant.start.x"
full = 0.001
none = 0.003
points = 4

[[check]]
name = "width"
scenario = "hold.toml"
set = ["duration=0.1", "metrics.start=0"]
number = "start"
judge = "width"
given = {late = 0.05}
full = 0.0041
none = 0.02
points = 1
"""


def grade_answer(tmp_path: Path, text: str, lab: str = LAB) -> dict[str, object]:
    (tmp_path / "lab.toml").write_text(lab)
    for name in ("family.toml", "hold.toml"):
        (tmp_path / name).write_text((MINI / name).read_text())
    (tmp_path / "answer.py").write_text(text)
    return bp.lab.check(tmp_path, tmp_path / "answer.py")


@pytest.mark.long
def test_a_function_is_judged_by_the_worst_of_rigs_it_has_not_seen(tmp_path: Path) -> None:
    found = grade_answer(tmp_path, FUNCTION)
    assert [each["score"] for each in found["results"]] == [4.0, 1.0]
    assert found["results"][0]["data"]["value"] == 0
    assert found["results"][1]["data"]["value"] == pytest.approx(0.004)
    same = "def begin(log, late=0):\n    return {'start': 0.09}\n"
    (off, _) = grade_answer(tmp_path, same)["results"]
    rigs = draw_rigs(read_family(str(MINI / "family.toml")), 1, 4)
    worst = max(abs(rig.point["plant.start.x"] - 0.09) for rig in rigs)
    assert off["data"]["value"] == pytest.approx(worst)
    assert off["score"] == round(4 * min(max((0.003 - worst) / 0.002, 0), 1), 2)


@pytest.mark.short("return 3-*", "return 1 / 0-*", "import os, __main__*")
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("return 3", "begin must return a dict, gave int"),
        ("return {}", "start: must be a number in m, an interval"),
        ("return {'start': np.nan}", "start: must be a number in m, an interval"),
        ("return {'start': 1, 'stop': 2}", "stop: unknown"),
        ("return {'start': object()}", "AttributeError"),
        ("return 1 / 0", "answer.py, line 4: ZeroDivisionError"),
        pytest.param(
            "__import__('time').sleep(60)",
            "answer.py: it took longer than 1 s",
            marks=pytest.mark.long,
        ),
        ("import os, __main__; os.write(__main__._OUT, b'=12345678')", "something else"),
    ],
)
def test_a_function_that_gives_none_fails_with_one_line(
    tmp_path: Path, line: str, said: str
) -> None:
    text = f"import numpy as np\n\ndef begin(log, late=0.0):\n    {line}\n"
    lab = LAB[: LAB.rindex("[[check]]")].replace("seconds = 3", "seconds = 1")
    why = grade_answer(tmp_path, text, lab)["results"][0]["cause"]["rationale"]
    assert said in why
    assert why.startswith("answer.py")
    assert "\n" not in why


@pytest.mark.long
def test_a_process_that_reads_nothing_more_keeps_nobody_waiting(tmp_path: Path) -> None:
    file = tmp_path / "answer.py"
    file.write_text(
        "import os, time, __main__\n"
        "def begin(**_):\n"
        "    os.write(__main__._OUT, b'{\"answer\": {}}\\n')\n"
        "    time.sleep(60)\n"
    )
    about = AnswerTable(kind="function", function="begin", asked={"x": "m"}, seconds=1.0)
    with answering(file, about) as process:
        assert process.call("function", {}) == {}
        with pytest.raises(LawError, match="took longer than 1 s"):
            process.call("function", {"log": np.zeros(1 << 20)})


def test_a_wrong_table_of_a_function_is_one_line(tmp_path: Path) -> None:
    for old, new, said in (
        ('function = "begin"\n', "", "function: belongs to an answer of kind function"),
        ("given = {late = 0.05}", "metric = 'rms_distance'", "metric, number: give one of them"),
        ("given = {late = 0.05}", "given = {late = 1979-05-27}", "is a date"),
    ):
        with pytest.raises(ScenarioError) as caught:
            grade_answer(tmp_path, FUNCTION, LAB.replace(old, new))
        assert said in str(caught.value)
    why = grade_answer(tmp_path, FUNCTION.replace("begin", "start"))["results"][0]["cause"]
    assert "must define a function begin" in why["rationale"]


LAW = AnswerTable(kind="law", file="answer.py", seconds=5.0)
ABOUT = AnswerTable(kind="observer", file="answer.py", seconds=5.0)
SETTINGS = ["duration=0.4", "metrics.start=0", "plant.start.x=0.05", "controller.period=0.002"]


@pytest.mark.short("law")
@pytest.mark.parametrize(
    ("about", "key", "text", "rigs"),
    [
        (LAW, "controller.kind", SOLUTION.replace('"mine"', '"here_of_lab"'), 1),
        (ABOUT, "observer.kind", OBSERVER.replace('"alpha_beta"', '"here_of_lab"'), 3),
    ],
    ids=["law", "observer"],
)
def test_an_answer_in_a_process_of_its_own_gives_the_same_bits(
    tmp_path: Path, about: AnswerTable, key: str, text: str, rigs: int
) -> None:
    file, scenario = tmp_path / "here.py", str(MINI / "hold.toml")
    file.write_text(text)
    catalog.add(file)
    each = [[*SETTINGS, f"seed={seed}"] for seed in range(rigs)]
    try:
        here = simulate([load(scenario, [*own, f"{key}=here_of_lab"]) for own in each])
    finally:
        del os.environ[catalog.ADDED_FILES_VARIABLE]
        catalog.forget()
    with answering(file, about):
        there = simulate([load(scenario, [*own, f"{key}={ANSWER_NAME}"]) for own in each])
    assert ANSWER_NAME not in catalog.registered_names()
    assert here == there
    assert len({one["rms_distance"] for one in here}) == rigs


@pytest.mark.short("return self.x*", "self.true-*")
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("return self.x[..., :3]", "correct must give the estimate (..., 8)"),
        ("self.x = np.zeros(3); return np.zeros((2, 8))", "here real numbers of shape (2, 8)"),
        ("self.x = self.x * np.nan; return self.x", "is not finite"),
        ("measurement.state[0]", "TypeError: 'NoneType'"),
        ("self.true", "AttributeError"),
    ],
)
def test_an_observer_that_gives_none_fails_with_one_line(
    tmp_path: Path, line: str, said: str
) -> None:
    file, begin = tmp_path / "answer.py", "        e = measurement.y"
    file.write_text(OBSERVER.replace(begin, f"        {line}\n{begin}"))
    with pytest.raises(LawError) as caught, answering(file, ABOUT):
        simulate([load(str(MINI / "hold.toml"), [*SETTINGS, f"observer.kind={ANSWER_NAME}"])])
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.long
def test_an_observers_lab_tells_a_good_one_from_a_perverse_one(tmp_path: Path) -> None:
    lab = (
        LAB[: LAB.index("[answer]")]
        + '[answer]\nkind = "observer"\n\n[[check]]\nname = "held"\nscenario = "hold.toml"\n'
        + 'metric = "rms_distance"\nfull = 0.03\nnone = 0.06\npoints = 2\n'
    )
    set_ = '\nset = ["duration=2.0", "metrics.start=1.0", "plant.start.x=0.05"]\n'
    texts = (OBSERVER, OBSERVER.replace("+= self._alpha", "-= self._alpha"))
    scores = [grade_answer(tmp_path, text, lab + set_)["score"] for text in texts]
    assert read(tmp_path).answer.file == "answer.py"
    assert scores == [2.0, 0.0]


@pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="grades as root, on Linux")
def test_where_root_grades_an_answer_is_nobody_and_holds_nothing_of_roots(tmp_path: Path) -> None:
    secret, file = tmp_path / "secret.txt", tmp_path / "answer.py"
    secret.write_text("truth")
    file.write_text(f"""
import ctypes, os
import scipy.signal
def tries(**_):
    open('own.txt', 'w').write('mine')
    calls = {{
        'root': lambda: os.setuid(0),
        'own': lambda: os.chown('.', 0, 0),
        'write': lambda: open({str(secret)!r}, 'a'),
    }}
    found = {{'fork': ctypes.CDLL(None).fork()}}  # this passes the hook
    for name, call in calls.items():
        try:
            call()
        except PermissionError:
            found[name] = 'refused'
    return found
""")
    about = AnswerTable(kind="function", function="tries", asked={"x": "m"}, seconds=5.0)
    with answering(file, about) as process:
        refused = {"fork": -1, "root": "refused", "own": "refused", "write": "refused"}
        assert process.call("function", {}) == refused
        status = Path(f"/proc/{process.process.pid}/status").read_text()
        said = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
    nobody = pwd.getpwnam("nobody")
    assert said["Uid"].split() == 4 * [str(nobody.pw_uid)]
    assert said["Gid"].split() == 4 * [str(nobody.pw_gid)]
    assert said["Groups"].split() == []
    search = 1 << 2  # CAP_DAC_READ_SEARCH; one of a container has CAP_DAC_OVERRIDE instead
    for name in ("CapEff", "CapPrm"):
        assert int(said[name], 16) in {0, search, 1 << 1}
    assert int(said["CapInh"], 16) == int(said["CapAmb"], 16) == 0


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks Linux")
def test_what_other_processes_take_of_a_processor_counts_for_nobody(tmp_path: Path) -> None:
    file = tmp_path / "answer.py"
    file.write_text(
        "import time\n"
        "def work(seconds):\n"
        "    while time.process_time() < seconds: pass\n"
        "    return {'x': 1}\n"
    )
    about = AnswerTable(kind="function", function="work", asked={"x": "m"}, seconds=2.0)
    loop = [sys.executable, "-c", "while True: pass"]
    # each in a session of its own, as the answer is: Linux shares processors among sessions
    rivals = [
        subprocess.Popen(loop, start_new_session=True) for _ in range(4 * (os.cpu_count() or 1))
    ]
    try:
        begin = time.monotonic()
        with answering(file, about) as process:
            assert process.call("function", {"seconds": 1.2}) == {"x": 1}
            assert time.monotonic() - begin > 2.0
            with pytest.raises(LawError, match="took longer than 2 s"):
                process.call("function", {"seconds": 60.0})
    finally:
        for each in rivals:
            each.kill()
            each.wait()
