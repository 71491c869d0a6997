"""`twin.cli`.

What a command cannot do is one line and exit code 2; nothing is printed, run or written."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from twin.run.finished import record_run, run
from twin.scenario import load

LOG = "time [s],measured_x [m],measured_phi [rad],measured_y [m],measured_theta [rad]\n"
LAW = """
from controllers.classical import LQR
class Mine(LQR):
    name = "afl"
"""
FILES = {
    "log.csv": LOG + "".join(f"{0.002 * k:.3f},0.15,0,0,0\n" for k in range(200)),
    "german.csv": LOG.replace(",", ";") + "0;0,1;0;0;0\n",
    "tabs.csv": LOG.replace(",", "\t") + "0\t0\t0\t0\t0\n",
    "bars.csv": LOG.replace(",", "|") + "0|0|0|0|0\n",
    "header.csv": LOG,
    "blank.csv": " \n",
    "twice.csv": LOG.replace("measured_y [m]", "measured_x [mm]") + "0,0,0,0,0\n",
    "rig.toml": '[touch]\nport = "/dev/null"\ncalibration_file = "not-yet.json"\n',
    "there.toml": "",
    "typed.toml": 'parameters = "hobby"\n[plant.linkage]\nphi_deg = [[-40, -14], [40, 14]]\n'
    "theta_deg = [[-40, -14], [0, 0.1], [40, 14]]\n",
    "ard.csv": "t,X,u\n" + "".join(f"{0.02 * k:.2f},{k % 90},{k % 7}\n" for k in range(200)),
    "listed.toml": 'title = "a"\nscenario = "hold"\nmethod = "grid"\nset = {duration = 1}\n'
    '[parameters."plant.friction.rolling_mm"]\nvalues = [0.1]\n',
    "notes.txt": "words",
    "wrong.py": "x = 1\nx = (",
    "empty.py": "",
    "twice.py": LAW,
    "own.py": LAW.replace('"afl"', '"own"'),
    "a_file": "",
}
"""What lies in the folder, beside a run of the circle in ``made``."""

CIRCLE = {
    "amplitude=0.1": "did you mean 'reference.amplitude'",
    "friction=0": "did you mean 'plant.friction.rolling_mm' or",
    "controller.computing_time=-1": "must be greater than or equal to 0 or 'measured'",
    "parameters=hoby": "rig 'hoby': not found; did you mean 'hobby'?",
    "rig.limits.angle_deg=20": "the cams reach 10; set plant.kind=lagrange",
    "reference.omega=1e-300": "is not finite at some time",
}
"""What is changed of the circle to what is told."""
CHANGES = {
    "plant.ball.radius=0.03": "plant.ball.radius: cannot change during",
    "duration=3": "duration: cannot change during a run",
    "controller.kind=pod": "no 'pod'",
    "plant.friction.rolling_mm=-1": "must be greater than or equal",
}
"""The same of a run that goes on from a moment."""
RODS = {
    "plant.linkage.crank_mm=[20,28]": "phi locks at 8.85 deg; rig.limits.angle_deg = 15 needs 1.1",
    "plant.spring.preload=50": "plant.spring.preload: a plate on rods has none",
    "rig.cams=per_axis": "must be 'table' (all of its lengths) or 'ratio'",
}
"""The same of the course rig in MuJoCo."""
TYPED = {
    "plant.kind=mujoco": "phi_deg: the mechanism has cams or rods and no table of tilts; set plant",
    "plant.linkage.phi_deg=[[-40,-14],[-50,0],[40,14]]": "both rising, got [[-40.0, -14.0], [-50",
    "plant.linkage.phi_deg=[[-40,-14,0],[40,14,0]]": "phi_deg.0: must have at most 2 values, has 3",
    "plant.linkage.phi_deg=[[-40],[40]]": "phi_deg.0: must have more values than 1",
    "plant.linkage.phi_deg=[[1,nan],[2,3]]": "phi_deg.0.1: must be a finite number",
    "plant.linkage.crank_mm=[40,28]": "rod_mm and arm_mm must be above 0",
    "rig.cams=per_axis": "must be 'table' (all of its lengths) or 'ratio'",
    "plant.servo.acceleration_deg=-1": "acceleration_deg: must be greater than or equal to 0",
}
"""The same of a rig whose table somebody typed by hand."""
VALUES = ("a", "a=", "a=1", "a=1:2", "a=1:2:1", "a=1:2:x", "a=1:inf:3", "a=1:2:3:4")
ARDUINO = "--columns time=t,measured_x=X:mm,command_phi=u:deg"
ARD = "--columns time=t,measured_x=X,command_phi=u"
NAMES = ("My-Law", "lambda", "../x")
LINES = {
    "run": "SCENARIO",
    "export circle own.c --law own.py --set controller.kind=own": "'own' has no form in C",
    "identify ard.csv --columns": "requires an argument",
    "exprt made a.csv": "No such command 'exprt'; did you mean 'export'?",
    "qqq": "No such command 'qqq'; ballplate --help lists all",
    "run cirle": "did you mean 'circle'",
    "run foo": "cure, cure_afl, cure_backstepping, excite, hold, line, sine, step; `",
    "run circle --beside crue": "did you mean 'cure'",
    "run circle --plant real": "mujoco",
    "run circle --rig rig.toml --plant lagrange": "describes a simulated rig",
    "run circle --frobnicate": "--frobnicate",
    "run circle --out /proc/nowhere": "cannot be written",
    "run circle --out=": "--out: names no folder",
    "run circle --set duration=1 --set duration=2": "given 2 times",
    "run circle --view --serve": "choose one",
    "run circle --rig hobby": "--rig hobby: names a file of a real rig; 'hobby' is a simulated one",
    "run circle --learn": "only with --shadow",
    "analyse sign": "not found",
    "reproduce 8.22": "no table '8.22'; there are 8.1 to 8.21 and 9.1 to 9.9",
    "trace made": "made/trace.log: no such trace; only a run with --rig keeps one",
    "trace mine/note.log": "no such trace; did you mean 'mine/notes.txt'?",
    "report runs/nothing": "runs/nothing: no such run folder",
    "study frictoin": "did you mean 'friction'? (known: chapter9,",
    "study friction --out a_file": "cannot be written: a file is where a folder should be",
    "compare hold --vary duration": "ballplate: --vary 'duration': write KEY=",
    "compare circle --vary controller.kind=[]": "--vary controller.kind: give at least one value",
    "sweep circle duration=1:2:2 --vary seed=[1,1]": "ballplate: --vary seed: 1 is given twice",
    "sweep circle duration=1:2:2 --vary seed=1 --vary seed=2": "--vary seed: is given twice",
    "compare no.csv circle": "no.csv: cannot be read: No such file or directory",
    "compare log.csv": "a log has no reference; name the scenario",
    "report runs/circle": "runs/circle is not there yet; first: ballplate run circle",
    "identify runs/excite": "runs/excite is not there yet; first: ballplate run excite",
    "report foreign.parquet": "not a record of ballplate",
    "report log.csv": "a log, not a run; ballplate compare log.csv SCENARIO",
    "export scope.log a.csv": "a log, not a run; ballplate compare scope.log SCENARIO, with --col",
    "view scope.log log.csv": "scope.log: not a run",
    "report scope.mat": "a log, not a run; ballplate compare scope.mat SCENARIO",
    "whatif scope.log --at 0.1": "give --scenario NAME",
    "export plain out.csv": "plain: not a run, which is a folder with run.parquet, or this file",
    "report made --out /proc/no/a": "--out /proc/no/a: cannot be written",
    "report made --out mine": "--out mine: is a folder",
    "view made --rrd /proc/no.rrd": "--rrd /proc/no.rrd: cannot be written",
    "export made /proc/no.csv": "FILE /proc/no.csv: cannot be written",
    "export circle /proc/no.fmu": "FILE /proc/no.fmu: cannot be written",
    "run circle --rig emulated --trace /proc/no.log": "--trace /proc/no.log: cannot be written",
    "calibrate cams --out /proc/no.json": "--out /proc/no.json: cannot be written",
    "trace scope.log --log /proc/no.csv": "--log /proc/no.csv: cannot be written",
    "whatif made --at 0.05 --out /proc/no": "--out /proc/no: cannot be written",
    "lab grade signs . --out /proc/no.csv": "--out /proc/no.csv: cannot be written",
    "lab grade signs . --out mine": "--out mine: is a folder; give a file",
    "bench verify nope": "nope: no finished entry: no such folder; ballplate bench run writes one",
    "bench table mine": "mine: no finished entry: it has no scores.json",
    "run circle --on nope": "--on: rig 'nope': not found (known:",
    "run circle --on scope.log": "--on: scope.log: not a TOML file:",
    "play hold --on tubbe": "--on: rig 'tubbe': not found; did you mean 'tube'?",
    "run circle --on nope.toml": "--on: rig 'nope.toml': not found",
    "identify log.csv --on nope": "--on: rig 'nope': not found",
    "whatif log.csv --at 0.1 --on nope": "--on: rig 'nope': not found",
    "whatif log.csv --at 0.1 --scenario nope": "--scenario: scenario 'nope': not found",
    "identify --plan --scenario sine --scenario nope": "--scenario: scenario 'nope': not found",
    "doctor --scenario nope": "--scenario: scenario 'nope': not found",
    "run circle --beside nope": "--beside: scenario 'nope': not found",
    "export made a.webp --beside nope": "--beside: nope: no such run folder",
    "shadow log.csv --reference nope": "--reference: log nope: not found",
    "lab new mine2 --like nope": "--like: lab 'nope': not found",
    "lab grade signs . --class nope": "--class: nope: cannot be read",
    "report": "no run in runs/ yet",
    "report round": "round: not a readable Parquet file",
    "identify german.csv": "columns are separated by ';'",
    "identify tabs.csv": "columns are separated by tabs; write ','",
    "compare bars.csv circle": "columns are separated by '|'; write ','",
    "compare header.csv circle": "header.csv: has no row below its header",
    "whatif blank.csv --at 0.1 --scenario circle": "blank.csv: is empty",
    "identify twice.csv": "measured_x: two columns",
    "identify ard.csv --columns time=t,measured_x=X:mm,command_phi=X": "both are column X of",
    "shadow ard.csv --on tube": "(it has t, X, u); try: ballplate shadow ard.csv --on tube --col",
    "shadow log.csv --ball soild": "--ball soild: give hollow (3/5), solid (5/7) or a share",
    "shadow made --ball solid": "--ball: not allowed; a run states its ball",
    "run circle --on tube --on beam": "--on: given 2 times; give it once",
    "study friction --samples 8": "samples: has no effect on a grid of values",
    "study listed.toml": """set: must be a list, got {"duration": 1}; write it as ["duration=1"]""",
    "export circle rig.FMU": "rig.FMU: unknown ending; known: .csv, .mat, .parquet, .mcap, moving",
    "export circle rig.slx": ".mp4; of a scenario: .fmu, .c",
    f"compare ard.csv circle {ARDUINO}": "ard.csv: has no positions along y, where the scenario's",
    f"whatif ard.csv --at 2 --scenario circle {ARDUINO}": "or a scenario along x, such as line;",
    f"identify ard.csv --ball-height 142 {ARD}": "ballplate: --ball-height: 142: give metres",
    f"identify ard.csv --ball-height 0 --parameters lever {ARD}": "--ball-height: it determines",
    "export circle mine.c": "mine: is no folder of an earlier export",
    "new law afl": "law 'afl': the name is taken by controllers.classical",
    "new observer afl": "observer 'afl': the name is taken by",
    "new observer mine --like pid": "--like: for a law or a scenario",
    "new law mine2 --like PID": "--like: no 'PID'; did you mean 'pid'? (known: cascade, pid,",
    "new scenario mine2 --like crue": "--like: scenario 'crue': not found; did you mean 'cure'?",
    "describe LQR": "nothing called 'LQR'; did you mean 'lqr'?",
    "run circle --set controller.kind=PID": "no 'PID'; did you mean 'pid'?",
    "run circle duration=3": "unexpected 'duration=3'; to change a key, write --set duration=3",
    "compare circle duration=3": "'duration=3': not found; to change a key, write --set duration=3",
    "run circle --set controller.Q=[1, 2]": "unexpected '2]'; put a value with blanks or quotes in",
    "compare circle --vary controller.kind=[afl, lqr]": "'lqr]': not found; put a value with",
    "new scenario there": "there.toml: exists",
    "run hold --law absent.py": "--law absent.py: no such file",
    "run hold --law notes.txt": "--law notes.txt: not a Python file",
    "run hold --law wrong.py": "wrong.py, line 2: SyntaxError",
    "run hold --law empty.py": "--law empty.py: no law, observer or reference in it has a name",
    "run hold --law twice.py": "the name 'afl' is taken by",
    "whatif made --at 9": "--at 9: made/run.parquet goes from 0 to 0.098 s",
    "whatif made --at -1": "--at -1: made/run.parquet goes from 0 to",
    "whatif made --at 0.05 --scenario circle": "is a record, which states what ran",
    "whatif log.csv --at 0.1": "give --scenario NAME",
    **{f"run circle --set {change}": words for change, words in CIRCLE.items()},
    **{f"whatif made --at 0.05 --set {change}": words for change, words in CHANGES.items()},
    **{f"run circle --set {key} --on course --plant mujoco": told for key, told in RODS.items()},
    **{f"run circle --set {key} --on typed.toml": told for key, told in TYPED.items()},
    "run circle --set plant.friction.rolling_mm=0.18mm": '"0.18mm"; write it without',
    "run circle --set controller.gains=5": "controller.gains: must be a list, got 5",
    "run circle --set controller.gains=[1,2,3": '"[1,2,3"; is a bracket missing',
    "run hold --set fault=[{at=1.0,name='unplugg'}]": "no fault 'unplugg'; did you mean 'unplug'",
    "run hold --set controller.dither_deg=1": "; a key of controller.kind = stable_inversion",
    "lab check signs": "answer.py: not in this folder; give the folder that `ballplate lab start`",
    "run hold --set fault=[{at=1.0,name='unplug'}]": "[[fault]]: only the virtual rig",
    "compare circle --vary duration=[5,10] --vary duration=[3]": "--vary duration: is given twice",
    "sweep circle duration=1:2:2 --vary duration=[3]": "--vary duration: is what the sweep varies",
    "compare circle --separator ;": "--separator: needs --columns",
    "compare circle --columns time=t": "--columns: describe a log",
    "shadow log.csv --separator ;": "--separator: with --columns only",
    "whatif made --at 0.05 --separator ;": "--separator: made/run.parquet is a record",
    "identify made --on tube": "--on: needs --columns; a run states its rig",
    "identify made --hold-out 0.9": "ballplate: --hold-out: must be 0 to 0.8, got 0.9",
    "identify made --hold-out=-1": "ballplate: --hold-out: must be 0 to 0.8, got -1",
    "identify made --hold-out made": "--hold-out: must be 0 to 0.8; a second log needs --columns",
    "identify made --hold-out nope": "--hold-out: log nope: not found; give a run.parquet",
    "run circle --set abc": "ballplate: --set 'abc': write key=value",
    "whatif made --at 0.05 --set abc": "ballplate: --set 'abc': write key=value",
    "whatif made --at 0.05 --branch seed=1;abc": "ballplate: --branch 'abc': write key=value",
    "run circle --on=-5": "ballplate: --on: rig '-5': not found",
    "run circle --board nope": "ballplate: --board: must be cortex-m4, host or the file of a",
    "export made film.webp --fps 0": "ballplate: --fps 0: must be from 1 to 50",
    "export made film.webp --size 1": "ballplate: --size 1: must be from 300 to 1200",
    "export made film.webp --seconds nan": "ballplate: --seconds nan: must be from 0.001 to 3600",
    "export made film.webp --from 1 --to 0": "ballplate: --from 1, --to 0 s: must be within 0 to",
    "identify made --ball-height 0.1": "--ball-height: needs --columns; a run states its rig",
    "run circle --rig emulated --fault 3": "write 'SECONDS LINE', as in '3.0 unplug'",
    "tune pid --set nonsense=1": "ballplate: circle.toml: nonsense: unknown key",
    "tune pid --on nope": "ballplate: --on: rig 'nope': not found",
    "lab check signs log.csv --as junit": "--as junit: needs --out",
    "lab check signs log.csv --out mine": "--out mine: is a folder; give a file",
    "lab check signs log.csv --page a_file/page.html": "--page a_file/page.html: cannot be written",
    "lab grade signs mine --out marks.pdf": "--out marks.pdf: must end in .csv",
    "lab pack signs --for gradescope --out a.tar": "--out a.tar: must end in .zip",
    "doctor --rig rig.toml --ball": "--ball: tilts the plate until the ball rolls; it needs --move",
    "calibrate cams --on tube": "calibrate: turns both axes of a plate by two AKD drives",
    "calibrate lost-motion --on beam": "calibrate: turns both axes of a plate by two AKD drives",
    "calibrate touch --rig rig.toml": "/dev/null: not a serial port",
    **{f"sweep circle {each}": "FIRST:LAST:NUMBER" for each in VALUES},
    "sweep circle a=[]": "ballplate: sweep a: give at least one value",
    **{f"new law {name}": "must be small letters, digits and _" for name in NAMES},
}
"""A command line to words of what is told."""
TABLE = [(line.split(), words) for line, words in LINES.items()]
TABLE += [
    (["describe", ""], "nothing called ''; `ballplate describe` lists every key"),
    (["run", "circle", "--out", ""], "--out: names no folder"),
    (["export", "made", ""], "FILE: names no file"),
    (
        ["identify", "ard.csv", "--columns", "time=t measured_x=ball x:mm"],
        "put commas between the columns: time=t,measured_x=ball x:mm",
    ),
    (["report", "n" * 5000], "no file can have so long a name"),
]
IDS = [" ".join(arguments)[:60] for arguments, _ in TABLE]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with files that are not what they should be."""
    place = tmp_path_factory.mktemp("mistakes")
    for name, text in FILES.items():
        (place / name).write_text(text)
    (place / "round").symlink_to("round")
    (place / "scope.log").write_text("time;x;y\n0;1;2\n0.1;2;3\n")
    (place / "plain").write_text("time x y\n0 1 2\n")
    (place / "scope.mat").write_bytes(b"MATLAB 5.0 MAT-file".ljust(128))
    (place / "mine").mkdir()
    (place / "mine" / "notes.txt").write_text("of somebody")
    keys = ("plant.kind=lagrange", "duration=0.1", "metrics.start=0")
    record_run(run(load("circle", keys)), place / "made")
    pq.write_table(pa.table({"a": [1.0]}), place / "foreign.parquet")
    return place


@pytest.mark.usefixtures("own_laws")
@pytest.mark.parametrize(("arguments", "words"), TABLE, ids=IDS)
def test_a_mistake_is_one_line_and_writes_nothing(ballplate, folder, monkeypatch, arguments, words):
    monkeypatch.chdir(folder)
    before = sorted(Path().rglob("*"))
    code, out, err = ballplate(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("ballplate: ")
    assert err.count("\n") == 1
    assert words in err
    assert sorted(each for each in Path().rglob("*") if "__pycache__" not in each.parts) == before


def test_a_message_that_quotes_what_was_given_commands_no_terminal(ballplate):
    code, out, err = ballplate("run", "circle", "--set", "controller.kind=\x1b[2Jlqr\x9b1m")
    assert code == 2
    assert not {"\x1b", "\x9b"} & set(out + err)
    assert "\\x1b[2Jlqr" in err


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999"])
@pytest.mark.parametrize(
    "command",
    [
        "calibrate lost-motion --amplitude",
        "calibrate cams --reach",
        "play circle --seconds",
    ],
)
def test_a_number_that_is_none_is_within_no_limits(ballplate, command, number):
    code, _, errors = ballplate(*command.split(), number)
    assert code == 2
    assert "Invalid value for" in errors


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999"])
def test_a_moment_that_is_no_number_is_one_line(ballplate, tmp_path, number):
    settings = ["plant.kind=lagrange", "plant.step=0.002", "duration=0.1"]
    done = run(load("circle", settings))
    record_run(done, tmp_path / "r")
    code, _, errors = ballplate("whatif", str(tmp_path / "r"), "--at", number)
    assert code == 2
    assert "must be a finite time" in errors


@pytest.mark.usefixtures("own_laws")
def test_an_error_in_a_law_of_one_s_own_is_one_line_with_its_place(ballplate, tmp_path):
    text = "    def command(self, measured):\n        return 1 / 0\n"
    (tmp_path / "mine.py").write_text(LAW.replace('"afl"', '"mine"') + text)
    settings = ["--set", "controller.kind=mine", "--set", "duration=0.1"]
    code, _, errors = ballplate("run", "circle", "--law", str(tmp_path / "mine.py"), *settings)
    assert code == 1
    assert "Traceback" not in errors
    assert "mine.py" in errors
    assert "division by zero" in errors


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("--out", "."), "--out .: is a folder; give a file"),
        (("--out", "/proc/none/sheet.csv"), "--out /proc/none/sheet.csv: cannot be written"),
        (
            ("--list", "--out", "sheet.csv"),
            "--out: not allowed with --list, which injects no fault",
        ),
    ],
)
def test_a_sheet_that_cannot_be_written_is_refused_before_any_fault(
    typed, words, ballplate, tmp_path
):
    code, out, err = ballplate("safety", "--only", "heartbeat", *typed)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert not list(tmp_path.iterdir())
