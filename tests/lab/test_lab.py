"""`twin.lab.grade`: A lab: what its files may say, whose rig is whose, and what an answer gets."""

import hashlib
import json
import re
import shutil
import tomllib
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZipFile

import pathspec
import pytest

import ballplate as bp
from twin.base.errors import LawError, RecordError, ScenarioError
from twin.lab import process
from twin.lab.deals import PRACTICE_KEY, deal, reload_deal
from twin.lab.grade import grade, grade_submission
from twin.lab.handed_in import collect
from twin.lab.handing_out import fill_answer, hand_out, make_starter, read_class
from twin.lab.judge import Judge, Measured, judge_answer
from twin.lab.packs import begin, pack
from twin.lab.pages import student_page
from twin.lab.process import ANSWER_NAME, answering
from twin.lab.result_files import format_result, marks
from twin.lab.schema import PRIVATE_FILES, CheckTable, read
from twin.lab.selftest import SELF_TEST, candidates, selftest, try_answer
from twin.run.loop import simulate
from twin.scenario import load

MINI = Path(__file__).parent / "mini"
SOLUTION = (MINI / "solution.py").read_text()
KEY = "the course's own key"
MASS = """
[[check]]
name = "mass"
scenario = "hold"
number = "mass"
truth = "plant.ball.mass"
relative = true
full = 10
none = 30
points = 4
"""
WIND = """
[[check]]
name = "wind"
number = "wind"
truth = "not determined"
full = 0
none = 1
points = 1
"""
NUMBERS = f"""
schema = "ballplate/lab/v1"
name = "numbers"
version = 1
title = "Numbers"
answer = {{kind = "numbers", file = "answer.toml", asked = {{mass = "kg", wind = "m/s"}}}}
{MASS}
[[check]]
name = "width"
scenario = "hold"
number = "mass"
truth = "plant.ball.mass"
judge = "width"
relative = true
full = 20
none = 60
points = 2
after = "mass"
{WIND}"""


def of(tmp_path: Path, text: str = NUMBERS, *files: str) -> Path:
    """The folder of a lab, with some files of the small one beside its table."""
    folder = tmp_path / "numbers"
    folder.mkdir()
    (folder / "lab.toml").write_text(text)
    for name in files:
        shutil.copy(MINI / name, folder)
    return folder


def marked(folder: Path, answer: str) -> list[dict[str, Any]]:
    """What each check of a lab in a folder says of numbers."""
    (folder / "answer.toml").write_text(answer)
    return bp.lab.check(folder, folder / "answer.toml")["results"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("lab/v1", "lab/v2", "a newer one needs a newer ballplate"),
        ("version = 1", "version = 0", "version: must be greater than or equal to 1, got 0"),
        ("judge =", "jugde =", "unknown key; did you mean 'judge'?"),
        ('after = "mass"', 'after = "mas"', "check 'width': after: no check before it is 'mas'"),
        ('number = "wind"', 'number = "wnd"', "number: no 'wnd'; did you mean 'wind'?"),
        ("full = 0\nnone = 1", "full = 1\nnone = 1", "full, none: must differ"),
        ('name = "wind"', 'name = "mass"', "two of them are called 'mass'"),
        ('number = "wind"', 'metric = "rms_error"', "scenario: missing"),
        ("answer.toml", "answer.py", "file: must be .toml for numbers and parameters, else .py"),
    ],
)
def test_a_wrong_lab_is_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in NUMBERS
    with pytest.raises(ScenarioError) as caught:
        read(of(tmp_path, NUMBERS.replace(old, new)))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_check_of_the_lecturers_own_is_hidden_unless_it_says_otherwise(tmp_path: Path) -> None:
    folder = of(tmp_path)
    more = MASS.replace('name = "mass"', 'name = "more"')
    told = MASS.replace('name = "mass"', 'name = "told"') + 'visible = "after_published"\n'
    (folder / "hidden.toml").write_text(more + told)
    lab = read(folder)
    assert [each.visible for each in lab.checks(hidden=True)[3:]] == ["hidden", "after_published"]
    assert len(lab.checks(hidden=False)) == 3


def test_a_folder_without_a_lab_and_an_unknown_name_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"has no lab\.toml"):
        read(tmp_path)
    with pytest.raises(ScenarioError, match="lab 'nowhere': not found"):
        read("nowhere")


@pytest.mark.parametrize(
    ("full", "none", "value", "points"),
    [(4, 8, 3, 4), (4, 8, 5, 3), (4, 8, 9, 0), (0.9, 0.5, 0.7, 2), (0.9, 0.5, 0.95, 4)],
)
def test_points_lie_on_a_line_between_none_and_full(
    full: float, none: float, value: float, points: float
) -> None:
    check = CheckTable(name="c", scenario="hold", points=4, full=full, none=none)
    assert check.earned(value) == pytest.approx(points)
    assert check.earned(float("nan")) == 0


def test_a_rig_is_dealt_by_hmac_of_key_lab_version_and_student() -> None:
    lab = read(MINI)
    block = KEY.encode().ljust(64, b"\0")  # RFC 2104, written out
    inner, outer = (bytes(each ^ pad for each in block) for pad in (0x36, 0x5C))
    text = hashlib.sha256(inner + b"mini 1 ann told").digest()
    assert deal(lab, "ann", KEY).code == hashlib.sha256(outer + text).hexdigest()[:16]
    later = lab.model_copy(update={"version": 2})
    others = [deal(lab, "bob", KEY), deal(lab, "ann", "another key"), deal(later, "ann", KEY)]
    assert len({each.point["plant.start.x"] for each in (deal(lab, "ann", KEY), *others)}) == 4


def test_what_is_hidden_of_a_rig_is_not_to_be_had_from_the_sheet(tmp_path: Path) -> None:
    lab, folder = read(MINI), tmp_path / "ann"
    hand_out(lab, {"ann": "."}, KEY, folder)
    true, home = reload_deal(lab, folder, KEY, "ann"), reload_deal(lab, folder, None)
    assert home.known == true.known
    assert home.point["plant.level_deg.0"] != true.point["plant.level_deg.0"]
    assert (home.true, true.true) == (False, True)
    assert str(true.point["plant.level_deg.0"]) not in "".join(
        file.read_text() for file in folder.iterdir()
    )
    assert f"START = {true.known['plant.start.x']!r}  # told" in (folder / "answer.py").read_text()
    with pytest.raises(ScenarioError, match="is it the key of this course"):
        reload_deal(lab, folder, "another key", "ann")
    with pytest.raises(ScenarioError, match=r"student: is 'ann', must be 'bob'; .* second column"):
        reload_deal(lab, folder, KEY, "bob")


def test_a_rig_to_practise_on_is_taken_without_a_key_under_any_name(tmp_path: Path) -> None:
    lab, folder = read(MINI), tmp_path / "home"
    hand_out(lab, {"annie": "."}, None, folder)
    found = reload_deal(lab, folder, None, "Ann_Lee")
    assert found == reload_deal(lab, folder, None)
    assert (found.student, found.true) == ("annie", True)
    with pytest.raises(ScenarioError, match=r"practice: .* the rig that the course hands out"):
        reload_deal(lab, folder, KEY, "Ann_Lee")
    assert lab.variant is not None
    nothing = lab.variant.model_copy(update={"told": (), "log": ""})
    alike = lab.model_copy(update={"variant": nothing})
    assert reload_deal(alike, folder, KEY, "Ann_Lee") == deal(alike, "Ann_Lee", KEY)


def test_a_class_is_the_first_column_below_its_heading(tmp_path: Path) -> None:
    file = tmp_path / "class.csv"
    file.write_text("id,name\nann,A\n\nbob@x.org,B\n")
    assert read_class(file) == {"ann": "A", "bob@x.org": "B"}
    for text, said in (
        ("id\nann\nann\n", "two students"),
        ("id\n../x\n", "letters"),
        ("id", "nobody"),
    ):
        file.write_text(text)
        with pytest.raises(ScenarioError, match=said):
            read_class(file)


@pytest.mark.parametrize("between", [",", ";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_a_class_is_read_as_spreadsheets_write_it(
    tmp_path: Path, between: str, encoding: str
) -> None:
    file = tmp_path / "class.csv"
    rows = (("id", "name"), ("M\xfcller", "A"), ("bob", '"B\r\nC"'))
    file.write_bytes("".join(between.join(row) + "\r\n" for row in rows).encode(encoding))
    assert [*read_class(file)] == ["M\xfcller", "bob"]


def test_a_starter_is_a_solution_without_what_stands_between_its_marks() -> None:
    assert make_starter(SOLUTION) == (MINI / "answer.py").read_text()
    assert "X = 2.5  # told: a.b\n" in fill_answer("X = 1  # told: a.b\n", {"a.b": 2.5})


@pytest.mark.parametrize(
    ("mass", "wind", "scores"),
    [
        ("0.024", '"not determined"', [4, 2, 1]),
        ("0.0288", "0.0", [2, 2, 0]),  # 20 % off, between 10 and 30
        ("0.0192", "0.0", [2, 2, 0]),  # as far below
        ("[0.02, 0.0296]", '"not determined"', [4, 1, 1]),  # the truth within 40 %
        ('"not determined"', '"not determined"', [0, 0, 1]),
    ],
)
def test_numbers_are_judged_by_distance_and_width(
    tmp_path: Path, mass: str, wind: str, scores: list[float]
) -> None:
    found = marked(of(tmp_path), f"mass = {mass}\nwind = {wind}\n")
    assert [each["score"] for each in found] == pytest.approx(scores, abs=0.011)
    if mass.startswith('"'):
        assert found[1]["passed"] is None
        assert "'mass' got no points" in found[1]["cause"]["rationale"]


@pytest.mark.parametrize(
    ("answer", "score"),
    [
        ("mass = 0.0264", 3),  # 10 % off
        ("mass = [0.0216, 0.0264]", 3),
        ("mass = [0.024, 0.0312]", 1),  # its upper end is 30 % off, though it holds the truth
        ("mass = [0.0168, 0.024]", 1),
        ("mass = [0.0, 1.0]", 0),
    ],
)
def test_of_an_interval_the_worse_end_may_be_judged(
    tmp_path: Path, answer: str, score: float
) -> None:
    judged_so = 'judge = "error"\nrelative = true\nfull = 20\nnone = 35\npoints = 3'
    text = NUMBERS.replace("relative = true\nfull = 10\nnone = 30\npoints = 4", judged_so)
    found = marked(of(tmp_path, text), f"{answer}\nwind = 0\n")
    assert found[0]["score"] == pytest.approx(score, abs=0.011)


def test_not_determined_where_it_is_not_is_no_wider_than_it_must_be(tmp_path: Path) -> None:
    width = WIND.replace('name = "wind"', 'name = "w"')
    folder = of(tmp_path, NUMBERS + width.replace("full = 0", 'judge = "width"\nfull = 0'))
    for wind, score in (('"not determined"', 1), ('"unknown"', 0), ("[0.0, 0.0]", 0)):
        found = marked(folder, f"mass = 0.024\nwind = {wind}\n")
        assert [each["score"] for each in found][2:] == [score, score]


def test_a_log_may_be_written_by_a_function_of_the_lab(tmp_path: Path) -> None:
    text = (MINI / "lab.toml").read_text()
    text = text.replace("told =", 'log = "log.py:write"\ntold =')
    folder = of(tmp_path, text, "family.toml", "hold.toml", "task.md", "answer.py")
    (folder / "log.py").write_text(
        "def write(point, folder):\n    (folder / 'own.txt').write_text(repr(sorted(point)))\n"
    )
    lab = read(folder)
    hand_out(lab, {"ann": "."}, KEY, tmp_path / "handed")
    assert (tmp_path / "handed" / "own.txt").read_text() == "['plant.level_deg.0', 'plant.start.x']"
    (folder / "log.py").write_text("")
    with pytest.raises(ScenarioError, match=r"log\.py: must define a function write"):
        hand_out(lab, {"ann": "."}, KEY, tmp_path / "again")
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "answer.toml: not handed in"),
        ("mass = ", "answer.toml: not a TOML file"),
        ("mass = 1\nmas = 2\nwind = 1", "mas: unknown; did you mean 'mass'?"),
        ("mass = [3, 1]\nwind = 1", "mass: must be a number in kg, an interval"),
        ("mass = true\nwind = 1", "mass: must be a number in kg"),
    ],
)
def test_a_wrong_answer_in_numbers_fails_with_one_line(
    tmp_path: Path, text: str | None, said: str
) -> None:
    folder = of(tmp_path)
    if text is not None:
        (folder / "answer.toml").write_text(text)
    found = bp.lab.check(folder, folder / "answer.toml")
    assert found["score"] == 0
    assert said in found["results"][0]["cause"]["rationale"]


SAY = "import os, __main__; os.write(__main__._OUT"
LINES = {
    "t.true_x": "AttributeError",
    "import twin.sim.rig": "ImportError: twin.sim.rig is the grader's",
    "import mujoco": "ImportError: mujoco is the grader's",
    "open('hidden.toml')": "FileNotFoundError",
    f"open({str(MINI / 'hidden.toml')!r})": "PermissionError",
    "__import__('os').listdir('/proc')": "PermissionError",
    "open('x', 'w').write('x' * 300000)": "it writes more than 256 kB",
    "__import__('os').write(1, b'x' * 300000) and __import__('os').write(1, b'x')": "writes more",
    "__import__('time').sleep(60)": "it took longer than 1 s",
    "exec('while True: pass')": "it took longer than 1 s",
    "__import__('os').fork()": "an answer may not start a process",
    "__import__('subprocess').run(['ls'])": "an answer may not start a process",
    "__import__('os').kill(__import__('os').getppid(), 9)": "PermissionError",
    "return np.full_like(angle, np.nan)": "control must give numbers",
    "return np.full_like(angle, np.nan if t else 0.0)": "is not finite",
    "return np.full_like(angle, 1e300)": "is 1e+300; at most 1e+06",
    "return np.zeros(3)": "it gave shape (3,)",
    "raise ValueError('no')": "ValueError: no",
    "raise SystemExit": "SystemExit",
    "__import__('os')._exit(3)": "its process ended by itself (3)",
    "bytearray(8 * 1024**3)": "MemoryError",
    f"{SAY}, b'{{}}' + bytes([10]))": "something else than an answer",
    f"{SAY}, b'[1, ')": "something else than an answer",
    f"{SAY}, b'9' * 9999 + bytes([10]))": "something else than an answer",
    "raise ValueError('\\ud800')": "ValueError: ?",
}


@pytest.mark.parametrize(
    "line",
    [pytest.param(each, marks=[] if str(MINI) in each else pytest.mark.long) for each in LINES],
)
def test_what_an_answer_may_not_do_fails_with_one_line(tmp_path: Path, line: str) -> None:
    lab, file = read(MINI), tmp_path / "answer.py"
    about = lab.answer.model_copy(update={"seconds": 1.0})
    mark = "        wanted ="
    file.write_text(SOLUTION.replace(mark, f"        {line}\n{mark}"))
    settings = ["duration=0.1", "metrics.start=0", f"controller.kind={ANSWER_NAME}"]
    with pytest.raises(LawError) as caught, answering(file, about):
        simulate([load(str(MINI / "hold.toml"), settings)])
    assert LINES[line] in str(caught.value)
    assert str(caught.value).startswith("answer.py")
    assert "\n" not in str(caught.value)


@pytest.mark.long
def test_an_answer_that_prints_too_much_keeps_its_points_with_a_remark(tmp_path: Path) -> None:
    lab, file = read(MINI), tmp_path / "answer.py"
    mark = "        wanted ="
    file.write_text(SOLUTION.replace(mark, f"        print('x' * 5999)\n{mark}"))
    check = lab.check[0].model_copy(update={"set": ("duration=0.3", "metrics.start=0")})
    found = Judge(lab, deal(lab, "ann", KEY), file).result(check, [])
    assert (found["passed"], found["score"]) == (True, 2)
    assert found["remark"].startswith("It prints more than 256 kB; the rest is dropped.")
    assert found["log"][-1].startswith("xxx")
    file.write_text(SOLUTION.replace(mark, f"        print('x' * 500)\n{mark}"))
    assert Judge(lab, deal(lab, "ann", KEY), file).result(check, [])["remark"] == ""


@pytest.mark.long
def test_own_answers_of_a_lab_get_what_they_must() -> None:
    lab = read(MINI)
    for each in candidates(lab):
        found = judge_answer(lab, deal(lab, "ann", KEY), each.file, hidden=True)
        by_name = {check["name"]: check for check in found["results"]}
        assert each.name != "solution" or found["score"] == found["max_score"]
        assert each.name != "starter" or found["score"] <= 0.2 * found["max_score"]
        for name in each.fails:
            assert by_name[name]["score"] <= by_name[name]["max_score"] / 2, each.name


def a_result() -> dict[str, object]:
    folder = {"passed": True, "cause": None, "visible": "visible"}
    why = {"passed": False, "cause": {"rationale": "too\x07 slow", "help": "the plot"}}
    each = {"score": 1.5, "max_score": 2.0, "log": [], "description": "d", "name": "one"}
    skipped = {**each, **why, "name": "three", "passed": None, "visible": "after_published"}
    found = [{**each, **folder}, {**each, **why, "name": "two", "visible": "hidden"}, skipped]
    own = dict.fromkeys(("version", "code", "answer", "versions"), "")
    return {"lab": "mini", "title": "T", "score": 4.5, "seconds": 1, "results": found, **own}


def test_a_result_is_written_as_gradescope_classroom50_and_junit_have_it() -> None:
    found = json.loads(format_result(a_result(), "gradescope"))
    assert found["score"] == 4.5
    tests = found["tests"]
    assert [each["visibility"] for each in tests] == ["visible", "hidden", "after_published"]
    assert {each["status"] for each in tests} == {"passed", "failed"}
    assert "Look: the plot" in tests[1]["output"]
    room = json.loads(format_result(a_result(), "classroom50"))
    assert room["schema"] == "classroom50/result/v1"
    assert (room["score"], room["max-score"]) == (150, 200)
    assert all(type(each["score"]) is int for each in room["tests"])
    suite = ElementTree.fromstring(format_result(a_result(), "junit"))
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("3", "1", "1")
    assert [len(case) for case in suite] == [0, 1, 1]


def test_marks_of_a_class_are_kept_and_no_answer_is_judged_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = of(tmp_path)
    lab, handed_in, kept = read(folder), tmp_path / "in", tmp_path / "kept"
    for name, mass in (("ann", 0.024), ("bob", 1.0), ("eve", 0.024)):
        (handed_in / name).mkdir(parents=True)
        text = f'mass = {mass}\nwind = "not determined"\n'
        (handed_in / name / "answer.toml").write_text(text)
    (handed_in / "eve" / "rig.toml").write_text(
        'lab = "numbers"\nversion = 1\nstudent = "eve"\ncode = "00"\npractice = false\n'
    )
    asked: list[str] = []

    def counted(judge: Judge, check: CheckTable) -> Measured:
        asked.append(f"{judge.dealt.student} {check.name}")
        return measure(judge, check)

    measure = Judge.measure
    monkeypatch.setattr(Judge, "measure", counted)

    def graded() -> dict[str, dict[str, object]]:
        people, every = ["ann", "bob", "cid"], collect(lab, handed_in).submissions
        found = grade(lab, KEY, people, every, kept, 1, lambda _: None)
        return {str(each["student"]): each for each in found}

    first = graded()
    assert {name: each["score"] for name, each in first.items()} == {
        "ann": 7, "bob": 1, "cid": 0, "eve": None
    }  # fmt: skip
    assert first["cid"]["problem"] == "not handed in"
    assert "student 'eve': not in the class" in str(first["eve"]["problem"])
    every = [f"{name} {check}" for name in ("ann", "bob") for check in ("mass", "wind")]
    assert sorted(asked) == sorted([*every, "ann width"])  # bob has no points for the mass
    before = {
        file.name: file.stat().st_mtime_ns for file in kept.iterdir() if "eve" not in file.name
    }
    asked.clear()
    assert graded() == first
    after = {
        file.name: file.stat().st_mtime_ns for file in kept.iterdir() if "eve" not in file.name
    }
    assert (asked, after) == ([], before)
    (kept / "bob.json").write_text('{"kept_as": "half a')  # as of a disk that was full
    (handed_in / "ann" / "answer.toml").write_text("mass = 0.024\nwind = 1\n")
    assert graded()["ann"]["score"] == 6
    assert sorted(asked) == sorted([*every, "ann width"])
    assert graded()["bob"]["score"] == 1
    assert len(asked) == 5
    lines = marks(lab, list(graded().values())).splitlines()
    assert lines[0] == "student,score,max_score,mass,width,wind,problem"
    assert lines[1] == "ann,6.0,7.0,4.0,2.0,0.0,"


def test_points_and_texts_change_without_a_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "mini"
    shutil.copytree(MINI, folder)
    brief = (folder / "hold.toml").read_text().replace("duration = 3.0", "duration = 0.4")
    (folder / "hold.toml").write_text(brief.replace("start = 1.5", "start = 0.2"))
    (tmp_path / "in").mkdir()
    shutil.copy(MINI / "mutants" / "no_integrator.py", tmp_path / "in" / "ann.py")
    kept, text = tmp_path / "kept", (folder / "lab.toml").read_text()

    def graded() -> dict[str, Any]:
        lab = read(folder)
        handed_in = collect(lab, tmp_path / "in").submissions
        return grade(lab, KEY, None, handed_in, kept, 1, lambda _: None)[0]

    first, page = graded(), (kept / "ann.html").read_text()
    assert "<svg" in page
    monkeypatch.setattr(process.subprocess, "Popen", lambda *_, **__: pytest.fail("a process"))
    changed = text.replace("points = 4", "points = 8").replace("none = 0.065", "none = 0.5")
    changed = changed.replace("Plot the tilt", "Draw the tilt").replace("scenario =", "scenario  =")
    (folder / "lab.toml").write_text(changed)
    again = graded()
    value = first["results"][1]["data"]["value"]
    assert again["results"][1]["data"]["value"] == value
    assert again["results"][1]["score"] == pytest.approx(8 * (0.5 - value) / 0.46, abs=0.01)
    new_page = (kept / "ann.html").read_text()
    assert "Draw the tilt" in new_page
    assert re.findall(r"<svg.*?</svg>", new_page, re.S) == re.findall(r"<svg.*?</svg>", page, re.S)
    (folder / "lab.toml").write_text(text.replace("seeds = [1, 2]", "seeds = [1, 3]"))
    with pytest.raises(pytest.fail.Exception, match="a process"):
        graded()


def test_a_key_of_another_course_is_one_line_and_costs_no_other_mark(tmp_path: Path) -> None:
    lab = read(of(tmp_path))
    hand_out_to = tmp_path / "in"
    (tmp_path / "numbers" / "task.md").write_text("# T\n")
    (tmp_path / "numbers" / "answer.toml").write_text("mass = 1\nwind = 1\n")
    hand_out(lab, {"ann": "ann", "bob": "bob"}, KEY, hand_out_to)
    handed_in = collect(lab, hand_out_to).submissions
    for key, whole in ((KEY, True), (PRACTICE_KEY, False)):
        grade_each = partial(grade_submission, lab, key, None, tmp_path, "source")
        found = [grade_each(each) for each in handed_in]
        assert all(("problem" not in each) == whole for each in found)
    assert "is it the key of this course" in found[0]["problem"]


@pytest.mark.parametrize("target", ["wheel", "sdist"])
def test_no_package_has_what_no_student_is_handed(target: str) -> None:
    root = Path(__file__).parents[2]
    build = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["hatch"]["build"]
    spec = pathspec.GitIgnoreSpec.from_lines(build["targets"][target]["exclude"])
    for name in (
        "solution.py",
        "solution.toml",
        "mutants/x.py",
        "key.txt",
        "course-key.txt",
        *PRIVATE_FILES[1:-1],
    ):
        lies = f"scenarios/labs/any/{name}"
        assert spec.match_file(f"{lies}/x" if name == "mutants" else lies), name
    for name in ("lab.toml", "task.md", "answer.py", "family.toml"):
        assert not spec.match_file(f"scenarios/labs/any/{name}")


LOGGED = """
schema = "ballplate/lab/v1"
name = "logged"
version = 1
title = "Where was the ball put down"
answer = {kind = "numbers", asked = {start = "m"}}

[variant]
family = "family.toml"
keys = ["plant.start.x"]
log = "hold.toml"
set = ["duration=0.1", "metrics.start=0"]

[[check]]
name = "key"
scenario = "hold.toml"
number = "start"
truth = "plant.start.x"
full = 0.003
none = 0.01
points = 1

[[check]]
name = "own"
number = "start"
truth = "truth.py:twice"
full = 0.003
none = 0.01
points = 1
"""


def test_a_log_of_the_students_rig_has_what_its_computer_knows_and_no_truth(tmp_path: Path) -> None:
    folder = of(tmp_path, LOGGED, "family.toml", "hold.toml", "task.md")
    (folder / "answer.toml").write_text("start = 0\n")
    (folder / "truth.py").write_text(
        "def twice(rig, folder):\n    return 2 * rig['plant.start.x']\n"
    )
    solution = folder / "solution.py"
    solution.write_text(
        "import csv\ndef answer(rig, folder):\n"
        "    rows = list(csv.DictReader((folder / 'log.csv').read_text().splitlines()))\n"
        "    return {'start': float(rows[0]['measured_x [m]'])}\n"
    )
    lab = read(folder)
    found = try_answer(lab, SELF_TEST.key, (solution, "ann"))
    assert [each["score"] for each in found["results"]] == [1.0, 0.0]
    assert try_answer(lab, SELF_TEST.key, (folder / "answer.toml", "ann"))["score"] == 0
    hand_out(lab, {"ann": "."}, KEY, tmp_path / "ann")
    heads = (tmp_path / "ann" / "log.csv").read_text().splitlines()[0]
    assert "applied_phi_acc [rad/s^2]" in heads
    assert "true" not in heads
    at_home = bp.lab.check(folder, tmp_path / "ann")
    assert [each["passed"] for each in at_home["results"]] == [None, None]
    assert "your lecturer" in at_home["results"][0]["cause"]["rationale"]


def test_a_pack_for_a_course_system_has_what_it_needs_and_no_solution(tmp_path: Path) -> None:
    lab = read(MINI)
    for system, out in (("gradescope", "x.zip"), ("classroom50", "room"), ("folder", "students")):
        pack(lab, system, tmp_path / out, KEY, None)
    with ZipFile(tmp_path / "x.zip") as file:
        names = set(file.namelist())
        modes = {each.filename: each.external_attr >> 16 & 0o777 for each in file.infolist()}
    assert {
        "setup.sh",
        "run_autograder",
        "secret/key.txt",
        "lab/lab.toml",
        "lab/hidden.toml",
    } <= names
    assert modes["run_autograder"] & 0o111
    assert modes["secret/key.txt"] == 0o600
    assert (tmp_path / "room" / "secret").stat().st_mode & 0o777 == 0o700
    room, given = (
        {path.name for path in (tmp_path / each).rglob("*")} for each in ("room", "students")
    )
    assert {"autograder.py", "hidden.toml", "key.txt"} <= room
    for every in (room, given, {Path(name).name for name in names}):
        assert every.isdisjoint({"solution.py", "mutants", "sign.py"})
    assert given.isdisjoint({"hidden.toml", "key.txt"})
    cells = json.loads((tmp_path / "students" / "mini.ipynb").read_text())["cells"]
    assert "".join(cells[-2]["source"]).startswith("%%writefile answer.py\n")
    with pytest.raises(ScenarioError, match="exists; give a new one"):
        pack(lab, "gradescope", tmp_path / "x.zip", KEY, None)


def test_a_student_may_have_a_notebook_of_the_own_rig(tmp_path: Path) -> None:
    lab = read(MINI)
    hand_out(lab, {"ann": "ann", "bob": "bob"}, KEY, tmp_path / "class", notebook=True)
    for student in ("ann", "bob"):
        own = tmp_path / "class" / student
        cells = json.loads((own / "mini.ipynb").read_text(encoding="utf-8"))["cells"]
        *sheet, starter, check = ("".join(each["source"]) for each in cells)
        assert "\n\n".join(sheet).split() == (own / "task.md").read_text(encoding="utf-8").split()
        filled = (own / lab.answer.file).read_text(encoding="utf-8")
        assert starter == f"%%writefile {lab.answer.file}\n{filled}".strip()
        assert check.endswith('bp.lab.check("mini")')
    hand_out(lab, {"ann": "."}, KEY, tmp_path / "without")
    assert not list((tmp_path / "without").glob("*.ipynb"))


def test_a_key_in_the_folder_of_a_lab_goes_to_nobody(tmp_path: Path) -> None:
    folder = tmp_path / "mini"
    shutil.copytree(MINI, folder)
    (folder / "course-key.txt").write_text(KEY)
    for system in ("folder", "classroom50"):
        pack(read(folder), system, tmp_path / system, KEY, None)
        holds = {
            path.name for path in (tmp_path / system).rglob("*")
            if path.is_file() and KEY in path.read_text()
        }  # fmt: skip
        assert holds == ({"key.txt"} if system == "classroom50" else set())
    (folder / "readme.txt").write_text(f"the key is {KEY}\n")
    for system, name in (("folder", "again"), ("gradescope", "again.zip")):
        with pytest.raises(ScenarioError, match=r"readme\.txt: contains the course's key"):
            pack(read(folder), system, tmp_path / name, KEY, None)
        assert not (tmp_path / name).exists()


def test_an_answer_of_another_kind_is_named(tmp_path: Path) -> None:
    (tmp_path / "answer.toml").write_text("mass = 1\n")
    why = bp.lab.check(MINI, tmp_path)["results"][0]["cause"]["rationale"]
    assert why == "answer.py: not handed in; an answer here is a law, not answer.toml"


def test_a_page_of_a_student_has_no_hidden_check(tmp_path: Path) -> None:
    folder = of(tmp_path)
    (folder / "hidden.toml").write_text(MASS.replace('name = "mass"', 'name = "secret"'))
    (folder / "answer.toml").write_text('mass = 1\nwind = "<i>"\n')
    lab = read(folder)
    judge = Judge(lab, deal(lab, "ann", KEY), folder / "answer.toml")
    result = judge_answer(lab, judge.dealt, judge.file, hidden=True)
    for everything in (False, True):
        page = student_page(judge, result, everything=everything)
        assert ("secret" in page) == everything
        assert "0 of 11 points" in page
        assert "<i>" not in page
    assert "Checks that are not shown: 0 of 4 points." in student_page(
        judge, result, everything=False
    )


def test_a_new_lab_is_one_and_its_starter_is_made_from_its_solution(tmp_path: Path) -> None:
    begin("my_own", tmp_path / "lab")
    lab = read(tmp_path / "lab")
    assert (lab.name, lab.title, len(lab.checks(hidden=True))) == ("my_own", "My own", 3)
    assert make_starter(lab.text("solution.py")) == lab.text("answer.py")
    assert len(candidates(lab)) == 5
    assert "NAME" not in "".join(lab.text(each) for each in ("lab.toml", "task.md", "notes.md"))
    with pytest.raises(RecordError, match="exists; give a new folder"):
        begin("my_own", tmp_path / "lab")
    for name in ("My own", "-x", "-"):
        with pytest.raises(ScenarioError, match=f"NAME '{name}': must be lower-case letters"):
            begin(name, tmp_path / "other")


@pytest.mark.long
def test_a_new_lab_passes_its_own_selftest(tmp_path: Path) -> None:
    begin("my_own", tmp_path / "lab")
    found = list(selftest(read(tmp_path / "lab"), 2))
    assert len(found) == 6
    assert all(each.good for each in found if "graded within" not in each.what), found


def test_a_lab_like_a_shipped_one_is_whole_and_has_no_key(tmp_path: Path) -> None:
    old, folder = read("friction"), tmp_path / "mine"
    begin("friction2", folder, old)
    new = read(folder)
    files = {each.relative_to(old.folder) for each in old.folder.rglob("*.*")}
    files = {each for each in files if "__pycache__" not in each.parts}
    assert {each.relative_to(folder) for each in folder.rglob("*.*")} == files
    assert (new.name, new.title, new.hidden) == ("friction2", old.title, old.hidden)
    assert new.check == old.check
    assert [each.fails for each in candidates(new)] == [each.fails for each in candidates(old)]
    for sheet in ("task.md", "task.de.md"):
        assert "ballplate lab check friction2`" in new.text(sheet)
        assert "cd friction2-ID`" in new.text(sheet)
    assert new.text("answer.py").startswith('"""Lab `friction2`:')
    (folder / "course-key.txt").write_text(KEY)
    begin("third", tmp_path / "third", read(folder))
    assert not (tmp_path / "third" / "course-key.txt").exists()


def test_a_scenario_runs_on_the_rig_of_a_sheet_by_one_option(tmp_path: Path) -> None:
    lab, file = read("friction"), tmp_path / "ann" / "rig.toml"
    hand_out(lab, {"ann": "."}, KEY, tmp_path / "ann")
    arm = deal(lab, "ann", KEY).known["plant.friction.rolling_mm"]
    own = load("circle", [f"parameters={file}"])
    assert own.plant.friction.rolling_mm == arm
    assert own.plant.level_deg == load("circle").plant.level_deg  # hidden
    without = load("circle", ["plant.friction.rolling_mm=0", f"parameters={file}"])
    assert without.plant.friction.rolling_mm == 0
    file.write_text(file.read_text().replace("[told]", "[told]\n'plant.fiction' = 1"))
    with pytest.raises(ScenarioError, match=r"circle.toml with .*rig.toml: .*fiction"):
        load("circle", [f"parameters={file}"])
    file.write_text('lab = "a"\nstudent = "b"\ntold = 3\n')
    with pytest.raises(ScenarioError, match="told: must be a table"):
        load("circle", [f"parameters={file}"])
