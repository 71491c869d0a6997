"""`twin.cli`.

A law of one's own is a law: its record says what it was, and opens where it is not."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import ballplate as bp
from controllers.catalog import catalog, forget
from controllers.interfaces import Law
from twin.base.errors import LawError

SHORT = ("--set", "controller.kind=mine", "--set", "duration=0.1", "--set", "plant.kind=lagrange")
RUN = Path("runs/circle-controller=mine-duration=0.1-plant=lagrange")

pytestmark = pytest.mark.usefixtures("own_laws", "quick_pictures", "no_pictures")


@pytest.fixture
def mine(ballplate):
    """A law in the folder of laws of the current folder."""
    assert ballplate("new", "law", "mine")[0] == 0
    forget()
    return Path("laws/mine.py")


@pytest.fixture
def rewrite(mine):
    """Writes something else in the place of a text of the law."""

    def change(old, new):
        mine.write_text(mine.read_text().replace(old, new, 1))
        forget()

    return change


def put(file, text):
    """A file of classes in the current folder, found from now on."""
    Path(file).parent.mkdir(exist_ok=True)
    Path(file).write_text(text)
    forget()


def about_law(folder):
    return json.loads(pq.read_schema(folder / "run.parquet").metadata[b"ballplate"])["classes"]


def test_a_record_says_what_the_law_was(ballplate, mine):
    ballplate("run", "circle", *SHORT)
    was = about_law(RUN)["controller"]
    assert was["settings"] == {"ball": [2.0, 2.4], "plate": [60.0, 14.0]}
    assert (was["file"], was["source"]) == ("mine.py", mine.read_text())
    assert len(was["sha256"]) == 64
    assert set(about_law(RUN)["observer"]) == {"settings"}  # one that is shipped


@pytest.mark.long
def test_a_record_without_its_law_is_shown_and_that_is_said_but_nothing_goes_on_from_it(
    ballplate, mine
):
    assert ballplate("run", "circle", *SHORT)[0] == 0
    shutil.rmtree("laws")
    forget()
    for command in (
        ("report", RUN),
        ("export", RUN, "signals.csv"),
        ("view", RUN, "--rrd", "view.rrd"),
        ("compare", RUN),
    ):
        code, _, err = ballplate(*command)
        assert code == 0
        assert err.count("controller 'mine' (it was in mine.py): not here") == 1
        assert "different version" not in err
    code, _, err = ballplate("whatif", RUN, "--at", "0.05")
    assert (code, err.count("\n")) == (2, 1)
    assert "what-if need it" in err
    with pytest.warns(UserWarning, match="controller 'mine'"):
        found = bp.load(RUN)
    assert found.finished
    assert found.classes["controller"]["settings"]["ball"] == [2.0, 2.4]
    bad = Path("runs/bad")
    bad.mkdir()
    (bad / "run.parquet").write_text("no Parquet")
    code, _, err = ballplate("compare", RUN, bad)
    assert code == 0
    assert "bad/run.parquet: not a readable Parquet file" in err
    assert ballplate("compare", bad)[0] == 2


@pytest.mark.long
def test_of_a_law_that_was_changed_both_runs_are_kept_and_what_differs_is_told(ballplate, rewrite):
    ballplate("run", "circle", *SHORT)
    rewrite("60.0", "61.0")
    code, _, err = ballplate("whatif", RUN, "--at", "0.05")
    assert (code, err.count("\n")) == (2, 2)  # before it what is run
    assert "mine.py has changed since" in err
    assert "was different: it stays" in ballplate("run", "circle", *SHORT)[1]
    other = RUN.with_name(f"{RUN.name}~2")
    plates = [about_law(each)["controller"]["settings"]["plate"] for each in (RUN, other)]
    assert plates == [[60.0, 14.0], [61.0, 14.0]]
    ballplate("report", RUN, other, "--out", "page")
    page = Path("page.html").read_text()
    row = "".join(
        f"<td[^>]*>{each}</td>\\s*"
        for each in ("controller.plate", *map(re.escape, map(str, plates)))
    )
    assert re.search(row, page)
    assert "Inner loop on the plate angle, outer loop on the ball." in page


def test_a_law_changed_within_the_second_is_the_changed_one(ballplate, mine, rewrite, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    forget()
    ballplate("run", "circle", *SHORT)
    was = mine.stat()
    rewrite("60.0", "61.0")
    os.utime(mine, ns=(was.st_atime_ns, was.st_mtime_ns))
    assert mine.stat().st_size == was.st_size
    forget()
    assert catalog(Law)["mine"]().plate == (61.0, 14.0)


@pytest.mark.long
def test_a_record_whose_law_takes_other_settings_is_shown(ballplate, rewrite):
    ballplate("run", "circle", *SHORT, "--set", "controller.plate=[50,10]", "--out", "x")
    rewrite("    plate:", "    angle:")
    code, _, err = ballplate("compare", "x")
    assert code == 0
    assert "does not take its settings" in err


OWN_REFERENCE = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from controllers.interfaces import Reference

@dataclass(frozen=True)
class Slope(Reference):
    name: ClassVar[str] = "slope"
    speed: float = 0.1

    def __call__(self, t):
        t = np.asarray(t, float)
        p = np.stack([self.speed * t, 0 * t], axis=-1)
        return np.stack([p, np.broadcast_to([self.speed, 0.0], p.shape), 0 * p, 0 * p, 0 * p])
"""


def test_where_a_reference_of_ones_own_led_is_in_the_record(ballplate):
    put("laws/slope.py", OWN_REFERENCE)
    ballplate(
        "run", "circle", "--set", "reference.kind=slope", "--set", "duration=0.1", "--out", "x"
    )
    shutil.rmtree("laws")
    forget()
    with pytest.warns(UserWarning, match="reference 'slope'"):
        found = bp.load("x")
    np.testing.assert_allclose(found.reference[:, 0], 0.1 * found.motion.time, atol=1e-12)
    np.testing.assert_allclose(found.followed(0.05)[1], [0.1, 0.0], atol=1e-9)
    assert found.followed(found.motion.time).shape == (5, len(found.motion.time), 2)
    assert ballplate("view", "x", "--rrd", "x.rrd")[0] == 0


WRONG = {
    "raise NameError('kp')": "line 24: NameError: kp",
    "import sys; sys.exit(3)": "line 24: SystemExit: 3",
    "input()": "line 24: EOFError",
    "return np.zeros((3, 2))": "it gave shape (3, 2)",
    "return 1j * np.ones((1, 2))": "it gave complex numbers of shape (1, 2)",
    "return None": "it gave None",
    "self.before = x": "its state is `memory`",
    "x[4]": "shape (1, 8)",  # a state is rows, of one rig, too
}
STUDY = """
title = "both"
scenario = "circle"
set = ["duration=0.1", "metrics.start=0.05", "baseline=false", "plant.kind=lagrange"]
method = "grid"
[parameters."plant.friction.rolling_mm"]
values = [0.0]
unit = "mm"
[[variants]]
name = "lqr"
set = ["controller.kind=lqr"]
[[variants]]
name = "mine"
set = ["controller.kind=mine"]
"""


BRIEF = {"duration": 0.1, "plant": {"kind": "lagrange"}}
BOTH = ('controller.kind=["lqr","mine"]', "--set", "duration=0.1", "--set", "plant.kind=lagrange")
BEGIN = "        position, velocity"
COMMANDS = {
    "run": (("run", "circle", *SHORT), None),
    "explain": (("explain", "circle", *SHORT, "-j", "1"), None),
    "sweep": (("sweep", "circle", *BOTH, "-j", "1"), "sweep.csv"),
    "compare": (("compare", "circle", "--vary", *BOTH), "compare.png"),
    "study": (("study", "both.toml", "--processes", "1"), "rows.csv"),
}
"""A command, and what it writes of the law that does not go wrong."""


@pytest.mark.short("*-run", "*-explain", "*-compare")
@pytest.mark.parametrize(
    ("text", "command"),
    [*((text, "run") for text in WRONG), *((next(iter(WRONG)), each) for each in COMMANDS)][1:],
)
def test_a_law_that_goes_wrong_is_one_line_and_the_other_is_kept(ballplate, rewrite, text, command):
    rewrite(BEGIN, f"        if t > 0.05: {text}\n{BEGIN}")
    Path("both.toml").write_text(STUDY)
    arguments, kept = COMMANDS[command]
    code, out, err = ballplate(*arguments)
    said = " ".join((out + err).split())
    assert said.count(WRONG[text]) == 1
    assert "mine.py" in said
    assert "Traceback" not in said
    if kept is None:
        assert code == 1
        assert "at 0.052 s" in said
        assert not list(Path().glob("runs/*/run.parquet"))
    else:
        (file,) = Path("runs").glob(f"*/{kept}")
        assert "lqr" in file.read_text() if file.suffix == ".csv" else file.stat().st_size


OBSERVER = """
from dataclasses import dataclass
from typing import ClassVar

from ballplate.observers import Array, Measurement, Observer


@dataclass(kw_only=True)
class Odd(Observer):
    name: ClassVar[str] = "odd"

    def correct(self, measurement: Measurement) -> Array:
        return ANSWER

    def predict(self, u: Array) -> None:
        pass
"""


@pytest.mark.parametrize(
    ("answer", "said", "predictor"),
    [
        ("measurement.y", "shape (1, 4)", "smith"),
        ("measurement.y", "shape (1, 4)", None),
        ("None", "None", "smith"),
        ("1j * self.x", "comp", None),
    ],
)
def test_an_observer_that_gives_no_estimate_is_one_line(ballplate, answer, said, predictor):
    put("laws/odd.py", OBSERVER.replace("ANSWER", answer))
    chosen = ["observer.kind=odd", "baseline=false"]
    chosen += ['predictor={kind="smith",delay=0.04}'] if predictor else []
    given = [word for each in chosen for word in ("--set", each)]
    code, _, err = ballplate("run", "circle", *SHORT[2:], *given)
    *_, line = err.splitlines()
    assert code == 1
    assert "laws/odd.py, line 12: correct must give the estimate" in line
    assert f"it gave {said}" in line


@pytest.mark.long
def test_in_a_study_an_observer_that_gives_no_estimate_is_told(ballplate):
    put("laws/odd.py", OBSERVER.replace("ANSWER", "measurement.y"))
    Path("both.toml").write_text(STUDY.replace("controller.kind=mine", "observer.kind=odd"))
    assert "correct must give the estimate" in " ".join(ballplate("study", "both.toml")[1].split())


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (BEGIN, f"        return x[..., :2] * np.nan\n{BEGIN}", "control must give numbers; of"),
        (BEGIN, f"        return np.zeros(3)\n{BEGIN}", r"control .*it gave shape \(3,\)"),
        (BEGIN, f"        return None\n{BEGIN}", "control .*it gave None"),
        (BEGIN, f"        return [[0.0, 0.0]]\n{BEGIN}", "control .* in an array; it gave a list"),
        (BEGIN, f"        return x[..., :2] > 1\n{BEGIN}", "control .*it gave bool of shape"),
        ("reference: Reference, ", "", r"control takes \(self, t, x, reference, q\)"),
    ],
    ids=["numbers", "shape", "none", "list", "bool", "signature"],
)
def test_a_law_that_does_not_answer_is_told_before_anything_runs(
    ballplate, rewrite, old, new, said
):
    rewrite(old, new)
    code, out, err = ballplate("run", "circle", *SHORT)
    assert (code, out) == (2, "")
    assert re.search(rf"laws/mine.py, line \d+: {said}", err)


@pytest.mark.parametrize(
    ("old", "new", "lacks"),
    [
        ("def control(", "def contrl(", "Mine lacks control"),
        ('    name: ClassVar[str] = "mine"\n', "", "Mine lacks a name of its own"),
        ("class Mine(Law)", "class Mine", "Mine is not derived from Law; write class Mine(Law)"),
    ],
)
def test_a_law_without_name_or_method_is_told_to_who_asks_for_it(
    ballplate, rewrite, old, new, lacks
):
    rewrite(old, new)
    code, _, err = ballplate("run", "circle", *SHORT)
    what, wrong = err.splitlines()
    assert code == 2
    assert what == f"ballplate: runs what lies in {Path('laws').resolve()}: mine"
    assert f"laws/mine.py: {lacks}" in wrong


TUNE = """
title = "t"
family = "placed"
set = ["controller.kind=mine", "baseline=false"]
draw = 1
certificate_draw = 2
rigs = [1]
candidates = 2
certificate = 1
search = ["plant.kind=lagrange"]
verdict = ["plant.kind=lagrange"]
[fields."controller.ball.0"]
loguniform = [1.0, 3.0]
[limits]
effort = 30.0
[[tasks]]
name = "hold"
scenario = "hold"
set = ["duration=0.1", "metrics.start=0.05"]
scale = 0.001
"""
OWN = """
[[experiments]]
name = "own"
scenario = "circle"
set = ["controller.kind=mine"]
measured.rms_error = { value = 0.01, uncertainty = 0.001 }
"""
OTHER = OWN.replace("own", "other").replace("mine", "lqr")
FIT = f"""
title = "f"
set = ["plant.kind=lagrange", "duration=0.1", "metrics.start=0.05", "baseline=false"]
population = 4
generations = 1
restarts = 1
[parameters.friction]
key = "plant.friction.rolling_mm"
low = 0.1
high = 0.3
unit = "mm"
{OWN}"""


@pytest.mark.parametrize(
    ("command", "always", "text"),
    [
        ("tune", True, "return np.zeros((3, 2))"),
        pytest.param("tune", False, "raise NameError('kp')", marks=pytest.mark.long),
        ("fit", True, "raise NameError('kp')"),
    ],
)
def test_in_a_search_a_law_that_goes_wrong_is_one_line(ballplate, rewrite, text, always, command):
    rewrite(BEGIN, f"        if t >= {0 if always else 0.05}: {text}\n{BEGIN}")
    Path("t.toml").write_text({"tune": TUNE, "fit": FIT}[command])
    code, out, err = ballplate(command, "t.toml", "--processes", "1" if always else "2")
    said = " ".join((out + err).split())
    # what does not answer at all is no law, which is told before anything runs
    probed = always and command == "tune" and "zeros" in text
    assert (code, said.count(WRONG[text]), said.count("mine.py")) == (1 + probed, 1, 1)
    if command == "fit":
        Path("t.toml").write_text(FIT + OTHER)
        code, out, err = ballplate(
            command, "t.toml", "--processes", "1", "--no-leave-out", "--json"
        )
        assert (code, err.count(WRONG[text])) == (1, 1)
        assert list(Path("runs/fit-t").rglob("*.parquet"))


def test_from_python_a_law_that_goes_wrong_is_the_same_line(rewrite):
    text, wrong = next(iter(WRONG.items()))
    rewrite(BEGIN, f"        if t > 0.05: {text}\n{BEGIN}")
    with pytest.raises(LawError, match=re.escape(wrong)):
        bp.run("circle", controller="mine", **BRIEF)
    done = bp.sweep("circle", {"controller.kind": ["lqr", "mine"]}, processes=1, **BRIEF)
    assert done["outcome"] == ["finished", "failed"]
    assert wrong in done["reason"][1]
    assert done.rows[1]["outcome_time"] is None
    assert "failed at" not in str(done.table())


def test_a_field_that_no_scenario_can_hold_is_told_and_breaks_nothing_else(ballplate, rewrite):
    rewrite("    def control", "    K: np.ndarray = None\n\n    def control")
    code, _, err = ballplate(
        "run", "circle", "--set", "controller.kind=lqr", "--set", "duration=0.1"
    )
    assert code == 0
    (line,) = (line for line in err.splitlines() if "not imported" in line)
    assert "laws/mine.py" in line
    assert "Mine.K: no scenario can hold a ndarray; write K: tuple[float, ...]" in line
    assert ballplate("run", "circle", *SHORT)[0] == 2


@pytest.fixture
def laws(mine, monkeypatch):
    """The module of the law as a script or a notebook imports it."""
    monkeypatch.syspath_prepend(str(Path.cwd()))
    for name in [each for each in sys.modules if each.partition(".")[0] == "laws"]:
        monkeypatch.delitem(sys.modules, name)
    return importlib.import_module("laws.mine")


def test_a_law_imported_from_its_folder_runs_as_an_object(laws):
    done = bp.run("circle", controller=laws.Mine(plate=(50.0, 12.0)), **BRIEF)
    assert done.scenario.controller.settings == {"plate": [50.0, 12.0]}
    assert done.classes["controller"]["file"] == "mine.py"


def test_a_law_changed_and_imported_again_is_the_changed_one(laws, mine):
    before = bp.run("circle", controller=laws.Mine(), **BRIEF)
    text = mine.read_text(encoding="utf-8")
    field = next(line for line in text.splitlines() if line.strip().startswith("plate:"))
    mine.write_text(text.replace(field, f"    more: float = 1.0\n{field}"), encoding="utf-8")
    done = bp.run("circle", controller=importlib.reload(laws).Mine(more=2.0), **BRIEF)
    assert done.scenario.controller.settings["more"] == 2.0
    marks = {run.classes["controller"]["sha256"] for run in (before, done)}
    assert len(marks) == 2


def test_of_two_files_with_one_name_of_a_law_both_are_named(ballplate, mine):
    for folder in ("alice", "bob"):
        put(f"{folder}/law.py", mine.read_text())
    shutil.rmtree("laws")
    code, _, err = ballplate(
        "run", "circle", "--law", "alice/law.py", "--law", "bob/law.py", *SHORT
    )
    assert (code, err.count("\n")) == (2, 1)
    assert "alice/law.py" in err
    assert "bob/law.py" in err


@pytest.mark.parametrize(
    ("chosen", "key"),
    [(SHORT, None), (SHORT[2:], "controller.kind=mine"), (SHORT[2:], "observer.kind=odd")],
)
def test_a_file_given_by_law_of_which_nothing_is_used_is_told(ballplate, mine, chosen, key):
    observer = OBSERVER.replace("ANSWER", "self.x")
    put("other.py", observer if key == "observer.kind=odd" else mine.read_text())
    shutil.rmtree("laws")
    code, _, err = ballplate("run", "circle", "--law", "other.py", *chosen)
    assert code == 0
    told = f"--law other.py: nothing of it is used; name it, as --set {key}"
    assert told in err if key else "nothing of it" not in err


def test_what_a_law_prints_is_not_in_the_json(ballplate, rewrite):
    rewrite("        r = reference(t)", "        print('hello')\n        r = reference(t)")
    once = ballplate("run", "circle", *SHORT, "--json")
    assert json.loads(once[1])["outcome"] == "finished"
    assert "hello" in once[2]


@pytest.mark.long
def test_what_a_law_prints_in_another_process_is_not_in_the_json(mine, rewrite):
    rewrite("        r = reference(t)", "        print('hello')\n        r = reference(t)")
    vary = ["--vary", "plant.friction.rolling_mm=[0, 0.1]", "-j", "2"]
    done = subprocess.run(
        [Path(sys.executable).with_name("ballplate"), "compare", "circle", *SHORT, *vary, "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert len(json.loads(done.stdout)) == 2
    assert "hello" in done.stderr


def test_of_a_law_that_says_nothing_of_itself_no_sentence_is_shown(ballplate, mine):
    lines = mine.read_text().splitlines()
    start = next(n for n, line in enumerate(lines) if line.startswith("class "))
    del lines[start + 1]  # its docstring
    mine.write_text("\n".join(lines))
    forget()
    told = ballplate("describe", "mine", "--law", mine)[1]
    assert "controller.ball = " in told
    assert "factory" not in told


MARK = "import pathlib\npathlib.Path('executed.txt').write_text('x')\n"
READERS = {
    "report": ("report", RUN),
    "export": ("export", RUN, "c.csv"),
    "view": ("view", RUN, "--rrd", "v.rrd"),
    "describe": ("describe", "lqr"),
    "describe laws": ("describe", "laws"),
    "bench list": ("bench", "list"),
    "lab list": ("lab", "list"),
    "study": ("study", "friction", "--plan"),
    "list": ("list",),
    "trace": ("trace", RUN),
    "bench verify": ("bench", "verify", RUN),
}


def test_what_only_reads_does_not_run_the_laws_of_a_folder(ballplate, mine):
    ballplate("run", "circle", *SHORT)
    mine.write_text(MARK + mine.read_text())
    for name, given in READERS.items():
        forget()
        code, _, err = ballplate(*given)
        assert code == (2 if name in {"trace", "bench verify"} else 0), err
        assert "runs what lies in" not in err, name
        assert not Path("executed.txt").exists(), name
    forget()
    code, _, err = ballplate("describe", "mine")
    assert code == 2
    assert "laws/mine.py: not run by a command that only reads; --law laws/mine.py does" in err
    assert not Path("executed.txt").exists()
    assert "controller.ball" in ballplate("describe", "mine", "--law", mine)[1]
    assert Path("executed.txt").exists()
    Path("executed.txt").unlink()
    code, _, err = ballplate("run", "circle", *SHORT, "--out", "again")
    assert code == 0
    assert err.splitlines()[0] == f"ballplate: runs what lies in {Path('laws').resolve()}: mine"
    assert Path("executed.txt").read_text() == "x"


@pytest.mark.long
def test_the_tab_key_does_not_run_the_laws_of_a_folder(mine):
    mine.write_text(MARK + mine.read_text())
    words = {"COMP_WORDS": "ballplate run circle --set controller.kind=", "COMP_CWORD": "4"}
    done = subprocess.run(
        [Path(sys.executable).with_name("ballplate")],
        env={**os.environ, **words, "_BALLPLATE_COMPLETE": "bash_complete"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "controller.kind=lqr" in done.stdout
    assert not Path("executed.txt").exists()
