"""`twin.cli.studies`: The commands of a lab, as a shell calls them."""

from collections.abc import Callable
from pathlib import Path

import pytest

from twin.lab import judge
from twin.lab.grade import table

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
    each = {"name": "c", "max_score": 4.0, "cause": None, "log": []}
    ends = ((True, 4.0), (False, 1.59), (False, 0.0), (None, 0.0))
    results = [{**each, "passed": passed, "score": score} for passed, score in ends]
    shown = table({"title": "T", "student": "s", "score": 1, "max_score": 1, "results": results})
    assert [row[1] for row in shown.rows] == ["passed", "partly", "failed", "skipped"]
