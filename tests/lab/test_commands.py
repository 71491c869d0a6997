"""`twin.cli.studies`: The commands of a lab, as a shell calls them."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from twin.lab import judge
from twin.lab.grade import table
from twin.lab.judge import Judge, Measured
from twin.lab.schema import deal, read
from twin.lab.words import TABLES

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


def test_a_check_with_some_of_its_points_is_shown_as_partly_passed() -> None:
    each = {"name": "c", "max_score": 4.0, "cause": None, "log": [], "remark": ""}
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
    english = TABLES["en"]
    for language, table_ in TABLES.items():
        assert set(table_) == set(english), language
        for name in set(english) - {"metrics"}:
            parts = [set(re.findall(r"{(\w+)}", each[name])) for each in (table_, english)]
            assert parts[0] == parts[1], (language, name)
