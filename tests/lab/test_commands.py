"""`twin.cli.labs`: The commands of a lab, as a shell calls them."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from twin.lab import judge
from twin.lab.deals import deal
from twin.lab.handing_out import hand_out
from twin.lab.judge import Judge, Measured
from twin.lab.packs import begin
from twin.lab.pages import Drawing, class_page, student_page
from twin.lab.result_texts import table
from twin.lab.schema import read
from twin.lab.words import WORD_TABLES

Command = Callable[..., tuple[int, str, str]]
MINI = Path(__file__).parent / "mini"


def test_the_name_of_a_missing_answer_is_one_line_at_once(
    ballplate: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(judge, "judge_answer", lambda *_, **__: pytest.fail("was judged"))
    (tmp_path / "answer.py").write_text("")
    code, printed, errors = ballplate("lab", "check", MINI, "anwser.py")
    assert (code, printed) == (2, "")
    assert errors.splitlines() == ["ballplate: anwser.py: no such file; did you mean 'answer.py'?"]


@pytest.mark.parametrize("command", ["variants", "grade", "pack"])
def test_a_lecturer_without_the_key_is_warned(
    command: str, ballplate: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("class.csv").write_text("id\nann\n")
    Path("key").write_text("a key of the course")
    Path("submissions").mkdir()
    Path("submissions/ann.md").write_text("no answer")
    words = {
        "variants": [MINI, "class.csv"],
        "grade": [MINI, "submissions"],
        "pack": [MINI, "--for", "classroom50"],
    }[command]
    warned = "without --key the rigs are for practice"
    assert warned in ballplate("lab", command, *words, "--out", "one.csv")[2]
    _, _, errors = ballplate("lab", command, *words, "--out", "two.csv", "--key", "key")
    assert warned not in errors


def test_a_check_with_some_of_its_points_is_shown_as_partly_passed() -> None:
    each = {"name": "c", "title": "c", "max_score": 4.0, "cause": None, "log": [], "remark": ""}
    ends = ((True, 4.0), (False, 1.59), (False, 0.0), (None, 0.0))
    results = [{**each, "passed": passed, "score": score} for passed, score in ends]
    about = {"title": "T", "language": "en", "student": "s", "score": 1, "max_score": 1}
    shown = table({**about, "results": results})
    assert [row[1] for row in shown.rows] == ["passed", "partly", "failed", "skipped"]


def test_the_sentence_about_a_check_has_words_and_units_and_no_keys() -> None:
    lab = read("friction")
    judging = Judge(lab, deal(lab, "ann", "a key"), Path("answer.py"))
    followed, hidden = lab.check[1], read(MINI).hidden[0]
    said = judging.describe(followed, Measured(4.0771, 1))
    assert said == "tracking error e_tt 4.08 % (all points up to 3.1 %, none above 4.4 %)"
    said = judging.describe(hidden, Measured(0.75, 4, "fell (x)"))
    within = "3 of 4 runs with RMS distance, steady of at most 50 mm"
    assert said == f"{within} (all points from 90 %, none below 50 %); fell (x)"
    cause = {"rationale": "r", "help": followed.look}
    each = {
        "name": "c",
        "title": "c",
        "max_score": 4.0,
        "cause": cause,
        "log": [],
        "remark": "",
        "passed": False,
        "score": 1.0,
    }
    about = {"title": "T", "language": "en", "student": "s", "score": 1, "max_score": 1}
    shown = table({**about, "results": [each]}).rows[0][3]
    assert "Sweep controller.factor and draw" in shown


def test_every_language_has_every_sentence_with_the_same_parts() -> None:
    english = WORD_TABLES["en"]
    for language, table_ in WORD_TABLES.items():
        assert set(table_) == set(english), language
        for name in set(english) - {"metrics"}:
            parts = [set(re.findall(r"{(\w+)}", str(each[name]))) for each in (table_, english)]
            assert parts[0] == parts[1], (language, name)


def test_a_lab_in_german_has_its_sheet_checks_and_pages_in_german(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "reibung"
    begin("reibung", folder, read("friction"))
    text = (folder / "lab.toml").read_text("utf-8")
    (folder / "lab.toml").write_text(text.replace('language = "en"', 'language = "de"'), "utf-8")
    lab, english = read(folder), read("friction")
    hand_out(lab, {"ann": "."}, None, tmp_path / "ann")
    sheet = (tmp_path / "ann" / "task.md").read_text("utf-8")
    assert "## Wie bewertet wird" in sheet
    assert "## Ihre Anlage\n\nann, Code " in sheet
    assert "ballplate lab check reibung`" in sheet
    limits = [
        re.findall(r"\| (\d) \| (.*?\d.*?) \| (.*?) \|", each.sheet) for each in (lab, english)
    ]
    assert limits[0] == limits[1] != []

    monkeypatch.setattr(Judge, "measure", lambda *_: Measured(4.0771, 1))
    dealt = deal(lab, "ann", "a key")
    result = judge.judge_answer(lab, dealt, tmp_path / "ann" / "answer.py", hidden=True)
    page = student_page(
        Judge(lab, dealt, tmp_path), result, everything=True, drawing=Drawing("", problem="x")
    )
    assert "Bahnfehler e_tt 4.08 % (alle Punkte bis 3.1 %, keine über 4.4 %)" in page
    found = [{**result, "cause": None}]
    every = page + class_page(lab, found, tmp_path)
    for each in lab.checks(hidden=True):
        assert each.texts["de"].name in every
        assert each.name not in every
    assert "teilweise" in every
    assert not re.search(
        r"\b(points|passed|failed|checks?|students?|none)\b",
        re.sub(r"<style>.*?</style>|<[^>]*>", "", every, flags=re.S),
    )
