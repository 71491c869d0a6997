"""`twin.lab.handed_in`.

What a class hands in, file by file and name by name; tests of twin.lab.handed_in."""

import csv
import io
import os
import socket
import unicodedata
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import ballplate as bp
from twin.base.data_file import DataError, read_regular
from twin.base.errors import ScenarioError, printable
from twin.cli import ballplate as command
from twin.lab.grade import grade, result_without_points
from twin.lab.handed_in import MAX_COPIED_FILES, collect, copy_files
from twin.lab.handing_out import check_name
from twin.lab.pages import class_page
from twin.lab.result_files import marks
from twin.lab.schema import Lab, read

LAB = """
schema = "ballplate/lab/v1"
name = "numbers"
version = 1
title = "Numbers"
answer = {kind = "numbers", file = "answer.toml", asked = {mass = "kg"}}

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
GOOD, BAD = "mass = 0.024\n", "mass = 0.1\n"
SECRET = "swordfish-is-the-key"
CODE_LAB = LAB.replace(
    'kind = "numbers", file = "answer.toml"', 'kind = "function", function = "f"'
)


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    folder = tmp_path / "lab"
    folder.mkdir()
    (folder / "lab.toml").write_text(LAB)
    return read(folder)


@pytest.fixture
def handed_in(tmp_path: Path) -> Path:
    folder = tmp_path / "in"
    folder.mkdir()
    return folder


CLASS = ("ann", "dave", "erin", "fred", "gus", "hal", "ivy", "jon", "kim", "lee", "mia")


NAMES = {
    "ann7": "Ann Lee",
    "onei1": "Mary O'Neil",
    "twin1": "Bo Li",
    "twin2": "Bo Li",
    "Ed_Fox": "",
}
"""A class by its numbers, with the names that Moodle has of it."""


@pytest.mark.parametrize(
    ("full", "student"),
    [
        ("Ann Lee", "ann7"),
        ("ann  lee", "ann7"),
        ("Mary O'Neil", "onei1"),
        ("Ed Fox", "Ed_Fox"),
        ("Bo Li", "Bo_Li"),  # two of the class have this name
        ("Zoe Ray", "Zoe_Ray"),
    ],
)
def test_a_student_is_found_by_the_name_in_the_class(lab, handed_in, full, student) -> None:
    put(handed_in / f"{full}_4711_assignsubmission_file_" / "answer.toml")
    (found,) = collect(lab, handed_in, NAMES).submissions
    assert found.student == student


def put(file: Path, text: str = GOOD) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


def graded(
    lab: Lab, folder: Path, people: list[str] | None = None, key: str = "any key"
) -> dict[str, dict[str, Any]]:
    """The result of each student, as marks.csv has it, with the text of the page."""
    kept = folder.with_name("kept")
    every = collect(lab, folder, people or ()).submissions
    found = grade(lab, key, people, every, kept, 1, lambda _: None)
    rows = {row["student"]: row for row in csv.DictReader(io.StringIO(marks(lab, found)))}
    for student, row in rows.items():
        page = kept / f"{student}.html"
        row["page"] = page.read_text() if len(student) < 100 and page.is_file() else ""
    return rows


def test_a_link_to_the_answer_of_another_student_gets_none_of_her_points(
    lab: Lab, handed_in: Path
) -> None:
    ann = put(handed_in / "ann" / "answer.toml")
    for name in ("bob", "cid", "dora", "eve", "fay"):
        (handed_in / name).mkdir()
    (handed_in / "bob" / "answer.toml").symlink_to(ann)
    (handed_in / "cid" / "answer.toml").symlink_to("../ann/answer.toml")
    (handed_in / "dora" / "answer.toml").hardlink_to(ann)
    os.mkfifo(handed_in / "eve" / "answer.toml")
    (handed_in / "fay" / "answer.toml").mkdir()
    (handed_in / "gil").symlink_to(handed_in / "ann")
    (handed_in / "hal.toml").symlink_to(ann)
    put(handed_in / "ivy" / "answer.toml")
    (handed_in / "ivy" / "rig.toml").symlink_to(ann)
    found = graded(lab, handed_in)
    why = {name: row["problem"] for name, row in found.items() if name != "ann"}
    assert {name for name, row in found.items() if row["score"]} == set()
    for name in ("bob", "cid", "gil", "hal", "ivy"):
        assert "is a link; hand in" in why[name], name
    assert "hard link" in why["dora"] + found["ann"]["problem"]
    assert "is not a regular file" in why["eve"]
    assert "is not a regular file" in why["fay"]


def test_no_page_or_mark_quotes_what_a_link_leads_to(
    lab: Lab, handed_in: Path, tmp_path: Path
) -> None:
    key = put(tmp_path / "key.txt", SECRET)
    for name, called in (("ann", "answer.toml"), ("bob", "rig.toml"), ("cid", "log.csv")):
        put(handed_in / name / "answer.toml")
        (handed_in / name / called).unlink(missing_ok=True)
        (handed_in / name / called).symlink_to(key)
    found = graded(lab, handed_in)
    assert SECRET not in repr(found)
    assert not found["ann"]["score"]
    assert not found["bob"]["score"]
    assert found["cid"]["score"] == "4.0"  # of no use to anybody, and not opened


@pytest.mark.parametrize("text", [LAB, CODE_LAB], ids=["numbers", "code"])
def test_one_answer_that_is_checked_is_not_opened_through_a_link(tmp_path: Path, text: str) -> None:
    (tmp_path / "lab.toml").write_text(text)
    name = read(tmp_path).answer.file
    (tmp_path / name).symlink_to(put(tmp_path / "key.txt", SECRET))
    found = bp.lab.check(tmp_path, tmp_path / name)
    why = found["results"][0]["cause"]["rationale"]
    assert why == f"{name}: is a link; hand in the file itself"
    assert found["answer"] == ""


def test_a_file_that_grows_without_end_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="is not a regular file"):
        read_regular(Path("/dev/zero"))
    with (tmp_path / "large").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(DataError, match="is larger than 4096 kB"):
        read_regular(tmp_path / "large")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "s"))
        with pytest.raises(DataError, match="is not a regular file"):
            read_regular(tmp_path / "s")


def test_a_labs_own_function_reads_copies_of_regular_files_alone(
    handed_in: Path, tmp_path: Path
) -> None:
    put(handed_in / "log.csv", "1")
    (handed_in / "key.csv").symlink_to(put(tmp_path / "key.txt", SECRET))
    with copy_files(handed_in) as folder:
        assert [path.name for path in folder.iterdir()] == ["log.csv"]
        assert (folder / "log.csv").read_text() == "1"
    assert not folder.exists()
    for number in range(MAX_COPIED_FILES):
        put(handed_in / f"{number}.txt", "")
    with pytest.raises(ScenarioError, match="has more than 256 files"), copy_files(handed_in):
        pass


def strange_names() -> list[bytes]:
    """Names of folders that no file of a result can have, or should."""
    return [
        b"\xff\xfe",
        b"x" * 252,
        b"\xe4\xb8\xad" * 80,  # 80 letters, 240 bytes
        b"a\nb",
        b"\x1b[31mred",
        b"=1+1",
        b"..b",
        b"a,b;c",
        b"~",
    ]


def test_no_name_of_an_entry_costs_another_student_a_mark(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "ann" / "answer.toml")
    put(handed_in / "zoe" / "answer.toml", BAD)
    for name in strange_names():
        os.mkdir(os.fsencode(handed_in) + b"/" + name)  # noqa: PTH102  bytes
    found = graded(lab, handed_in)
    assert (found["ann"]["score"], found["zoe"]["score"]) == ("4.0", "0.0")
    assert len(found) == 2 + len(strange_names()) - 1  # ..b is hidden, and told elsewhere
    others = [row for name, row in found.items() if name not in {"ann", "zoe"}]
    assert all("the name has up to 100 letters" in row["problem"] for row in others)
    assert printable("".join(map(str, others)), "") == "".join(map(str, others))
    page = class_page(lab, [{**row, "results": [], "score": None} for row in others], handed_in)
    page.encode()


def test_a_name_is_as_long_as_the_files_of_its_result_may_be() -> None:
    check_name("ä" * 100)
    for name in ("中" * 80, "x" * 101, ""):
        with pytest.raises(ScenarioError, match="up to 100 letters"):
            check_name(name)


def test_a_missing_answer_looks_different_from_a_bad_one(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "ann" / "answer.toml", BAD)
    put(handed_in / "dave" / "numbers-dave" / "answer.toml")
    put(handed_in / "erin" / "answer (1).toml")
    put(handed_in / "fred" / "numbers.zip")
    (handed_in / "gus").mkdir()
    put(handed_in / "hal" / "__MACOSX" / "._answer.toml")
    put(handed_in / "ivy" / "Answer.TOML")
    put(handed_in / "jon" / "notes.txt")
    for number in range(5):
        put(handed_in / "kim" / str(number) / "answer.toml")
    (handed_in / "lee").mkdir()
    (handed_in / "lee" / "deep").symlink_to(handed_in / "ann")
    found = graded(lab, handed_in, [*CLASS])
    wanted = {
        "ann": "",
        "dave": "no answer.toml; there is numbers-dave/answer.toml",
        "erin": "no answer.toml; there is answer (1).toml",
        "fred": "no answer.toml; there is numbers.zip: unpack it",
        "gus": "no answer.toml; there is nothing else",
        "hal": "no answer.toml; there is nothing else",
        "ivy": "no answer.toml; there is Answer.TOML",
        "jon": "no answer.toml; there is notes.txt",
        "kim": "no answer.toml; there is 0/answer.toml, 1/answer.toml, 2/answer.toml and 2 more",
        "lee": "no answer.toml; there is nothing else",
        "mia": "not handed in",
    }
    assert {name: row["problem"] for name, row in found.items()} == wanted
    assert {row["score"] for name, row in found.items() if name not in {"ann", "mia"}} == {""}
    assert found["ann"]["score"] == found["mia"]["score"] == "0.0"
    for name in wanted.keys() - {"ann", "mia"}:
        assert wanted[name].split("; ")[1].split(":")[0] in found[name]["page"], name
    assert "0 of 4 points" in found["ann"]["page"]


def test_names_of_moodle_and_canvas_are_students(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "ann_12345_assignsubmission_file_" / "answer.toml")
    put(handed_in / "ann_12345_assignsubmission_onlinetext_" / "onlinetext.html")
    put(handed_in / "bob_12346_assignsubmission_file" / "answer.toml", BAD)
    put(handed_in / "Cid Lee_12347_assignsubmission_file_answer.toml")
    put(
        handed_in
        / f"{unicodedata.normalize('NFD', 'Zoë')}_9_assignsubmission_file_"
        / "answer.toml"
    )
    put(handed_in / "O'Neil, Con_77_assignsubmission_file_" / "answer.toml")
    put(handed_in / "doedora_4711_815_answer.toml", BAD)
    put(handed_in / "doedora_4711_816_answer-1.toml", BAD)
    put(handed_in / "doedora_4711_817_answer-10.toml")
    put(handed_in / "doedora_4711_817_answer-9.toml", BAD)
    put(handed_in / "poeeve_LATE_4712_818_answer.toml")
    put(handed_in / "roefay_4713_819_numbers.zip")
    put(handed_in / "moegil_4714_820_answer.toml")
    rig = 'lab = "numbers"\nversion = 1\nstudent = "moegil"\ncode = "00"\npractice = false\n'
    put(handed_in / "moegil_4714_821_rig-2.toml", rig)
    put(handed_in / "hal.toml")
    found = graded(lab, handed_in)
    scores = {name: row["score"] for name, row in found.items()}
    assert scores == {
        "ann": "4.0", "bob": "0.0", "Cid_Lee": "4.0", "Zoë": "4.0", "O_Neil_Con": "4.0",
        "doedora": "4.0", "poeeve": "4.0", "roefay": "", "moegil": "", "hal": "4.0",
    }  # fmt: skip
    assert found["roefay"]["problem"].endswith("there is roefay_4713_819_numbers.zip: unpack it")
    assert "code: the course's key draws a different rig for moegil" in found["moegil"]["problem"]


def test_two_submissions_of_a_student_cost_no_other_mark(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "ann" / "answer.toml")
    put(handed_in / "ann.toml")
    put(handed_in / "anon_1_2_answer.toml")
    put(handed_in / "anon_1_4_answer.toml")
    put(handed_in / "zoe.toml")
    found = graded(lab, handed_in)
    assert found["zoe"]["score"] == "4.0"
    assert found["ann"]["problem"] == "two submissions: ann, ann.toml; keep one of them"
    assert found["anon"]["problem"].startswith("two submissions: anon_1_2_answer.toml, anon_1_4_")


def test_what_lies_there_and_is_no_submission_is_named(lab: Lab, handed_in: Path) -> None:
    for name in ("notes.txt", ".DS_Store", "all.zip", "._ann.toml", "bob.zip", "we\x1b[1mird.txt"):
        put(handed_in / name)
    put(handed_in / "__MACOSX" / "ann.toml")
    os.mkfifo(handed_in / "pipe")
    (handed_in / "away").symlink_to("/nowhere")
    put(handed_in / "ann.toml")
    found = collect(lab, handed_in, ["ann", "bob"])
    away, ann, bob = sorted(found.submissions, key=lambda each: each.student != "away")
    assert (away.student, ann.student, bob.student) == ("away", "ann", "bob")
    assert "is a link; hand in" in away.problem
    assert bob.problem == "no answer.toml; there is bob.zip: unpack it"
    assert sorted(found.left_out) == [
        ".DS_Store: belongs to the course system",
        "._ann.toml: belongs to the course system",
        "__MACOSX: belongs to the course system",
        "all.zip: is an archive: unpack it",
        "notes.txt: is neither a folder nor a .toml file",
        "pipe: is neither a folder nor a regular file",
        "we\\x1b[1mird.txt: is neither a folder nor a .toml file",
    ]
    people = put(handed_in.with_name("class.csv"), "id\nann\nbob\n")
    out = handed_in.with_name("marks.csv")
    given = ["lab", "grade", str(lab.folder), str(handed_in), "--class", people, "--out", out]
    done = CliRunner().invoke(
        command, [*map(str, given), "--processes", "1"], standalone_mode=False
    )
    assert done.return_value == 1, done.output
    page = out.with_suffix(".html").read_text()
    for line in found.left_out:
        assert line in page
        assert f"among the submissions: {line}" in done.stderr
    assert "\x1b" not in done.output + page


def test_marks_cannot_begin_a_formula(lab: Lab) -> None:
    students = ("=1+1", "+1", "-1", "@sum(a1)", "\t=1", "\r=1", "\uff1d1", "ann")
    found = [result_without_points(name, f"no; {name}") for name in students]
    rows = [*csv.reader(io.StringIO(marks(lab, found)))][1:]
    for name, row in zip(students, rows, strict=True):
        assert row[0] == ("ann" if name == "ann" else f"'{name}" if name > " " else printable(name))
        assert row[-1].startswith("no; '" if name not in {"ann", "\t=1", "\r=1"} else "no; ")
        for cell in row:
            assert not any(part.strip().startswith(tuple("=+-@\uff1d")) for part in cell.split(";"))


def test_the_grader_s_own_trouble_is_not_on_the_page_of_a_student(
    lab: Lab, handed_in: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(handed_in / "ann.toml")

    def breaks(*_: object, **__: object) -> None:
        raise OSError(SECRET)

    monkeypatch.setattr("twin.lab.grade.judge_answer", breaks)
    row = graded(lab, handed_in)["ann"]
    assert row["problem"] == f"the grader failed: OSError: {SECRET}"
    assert SECRET not in row["page"]
    assert "your lecturer" in row["page"]


def test_who_is_not_in_the_class_is_not_told_who_is(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "anne.toml")
    row = graded(lab, handed_in, ["anna", "bob"])["anne"]
    assert row["problem"] == "student 'anne': not in the class; did you mean 'anna'?"
    (handed_in / "zed").mkdir()
    assert "not in the class" in graded(lab, handed_in, ["anna", "bob"])["zed"]["problem"]
    assert "bob" not in row["page"]


def test_a_lab_s_own_functions_are_named_before_they_run(
    lab: Lab, handed_in: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (lab.folder / "truth.py").write_text("def mass(rig, folder):\n    return 0.024\n")
    text = (lab.folder / "lab.toml").read_text()
    text = text.replace('"plant.ball.mass"', '"truth.py:mass"')
    (lab.folder / "lab.toml").write_text(text)
    put(handed_in / "ann.toml")
    with caplog.at_level("INFO", logger="ballplate.executes"):
        assert graded(read(lab.folder), handed_in)["ann"]["score"] == "4.0"
    assert {record.getMessage() for record in caplog.records} == {
        f"runs {lab.folder / 'truth.py'} of the lab"
    }


def test_an_answer_s_ending_may_be_in_capitals(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "Ann.TOML")
    found = collect(lab, handed_in)
    assert [(each.student, each.problem) for each in found.submissions] == [("Ann", "")]
    assert not found.left_out


@pytest.mark.parametrize("name", ["answer.toml", "Answer.TOML", "rig.toml"])
def test_a_file_that_names_no_student_is_nobody_s(lab: Lab, handed_in: Path, name: str) -> None:
    put(handed_in / name)
    put(handed_in / "ann.toml")
    found = collect(lab, handed_in)
    assert [each.student for each in found.submissions] == ["ann"]
    assert found.left_out == [
        f"{name}: names no student: folders and files must have the student's name"
    ]
    put(handed_in / "answer.toml")
    assert len(collect(lab, handed_in, ["ann", Path(name).stem]).submissions) == 2


@pytest.mark.parametrize(
    "names",
    [
        ("{}_11_assignsubmission_file_/answer.toml", "{}_22_assignsubmission_file_/answer.toml"),
        ("{}_11_assignsubmission_file_answer.toml", "{}_22_assignsubmission_file_answer.toml"),
        ("{}_11_901_answer.toml", "{}_LATE_22_902_answer.toml"),
    ],
)
def test_namesakes_of_a_course_system_are_two_students(
    lab: Lab, handed_in: Path, names: tuple[str, str]
) -> None:
    """A class whose names are hidden is all Participant; the system's number tells who it is."""
    put(handed_in / names[0].format("Participant"))
    put(handed_in / names[1].format("Participant"), BAD)
    found = graded(lab, handed_in)
    assert [(name, row["score"], row["problem"]) for name, row in found.items()] == [
        ("Participant_11", "4.0", ""),
        ("Participant_22", "0.0", ""),
    ]


@pytest.mark.parametrize(
    ("folder", "inner"), [("lab1-ann", ".git"), ("lab1-ann", ".github"), ("Lee_Ann_ann_4711", "")]
)
def test_a_system_s_folder_belongs_to_the_student_whom_it_names(
    lab: Lab, handed_in: Path, folder: str, inner: str
) -> None:
    put(handed_in / folder / "answer.toml")
    (handed_in / folder / inner).mkdir(exist_ok=True)
    assert [each.student for each in collect(lab, handed_in).submissions] == [folder]
    found = graded(lab, handed_in, ["ann", "lee", "n"])
    assert {name: row["score"] for name, row in found.items()} == {
        "ann": "4.0",
        "lee": "0.0",
        "n": "0.0",
    }


def test_a_hyphenated_name_is_nobody_elses(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "mary-ann" / "answer.toml")
    assert "not in the class" in graded(lab, handed_in, ["ann"])["mary-ann"]["problem"]


def test_a_name_with_a_number_is_nobody_elses(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "mary_ann_2" / "answer.toml")
    put(handed_in / "ann" / "answer.toml")
    found = graded(lab, handed_in, ["ann", "bob"])
    assert "not in the class" in found["mary_ann_2"]["problem"]
    assert not found["ann"]["problem"]


def test_a_packed_answer_is_to_be_unpacked_whatever_its_name(lab: Lab, handed_in: Path) -> None:
    put(handed_in / "ann" / "answer.zip")
    (found,) = collect(lab, handed_in).submissions
    assert found.problem == "no answer.toml; there is answer.zip: unpack it"
