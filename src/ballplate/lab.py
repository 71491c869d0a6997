r"""Answers of labs are assessed from a program, as ``ballplate lab check`` does.

Examples:
    >>> from pathlib import Path
    >>> import ballplate as bp
    >>> file = Path("answer.toml")
    >>> _ = file.write_text("[predictor]\ndelai = 0.05\n")  # misspelt
    >>> found = bp.lab.check("deadtime", file, student="ann")
    >>> found["score"], found["max_score"]
    (0.0, 10.0)
    >>> print(found["results"][0]["cause"]["rationale"])
    answer.toml: predictor.delai: may not be set (allowed: predictor.delay, observer.poles)
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


def check(
    lab: str | Path,
    answer: str | Path | None = None,
    *,
    student: str | None = None,
    key: str | None = None,
    hidden: bool = False,
    page: str | Path | None = None,
) -> dict[str, Any]:
    """The result of an answer: ``score``, ``max_score``, and ``results``, one a check.

    Each of ``results`` has ``name``, ``passed`` (None if it was skipped), ``score``, ``max_score``
    and ``cause`` with ``rationale`` and ``help``. What an answer does wrong is part of the result,
    never an error.

    Args:
        lab: Name of a shipped lab, or the folder of any.
        answer: The file; by default what the lab calls it, in the current folder. A ``rig.toml``
            next to it names the student.
        student: The student, where no ``rig.toml`` names one.
        key: The course's key; without one, what is hidden of a rig is a value to practise on.
        hidden: Whether hidden checks are graded, too.
        page: HTML file to write with the result and a picture of the run that lost most points.

    Raises:
        ScenarioError: If there is no such lab, something in it is wrong, or the rig belongs to a
            different student, lab or key.
    """
    from twin.lab import judge, schema
    from twin.lab.deals import reload_deal

    found = schema.read(lab)
    file = Path(answer or found.answer.file)
    if file.is_dir():
        file /= found.answer.file
    dealt = reload_deal(found, file.parent, key, student)
    result = judge.judge_answer(found, dealt, file, hidden=hidden)
    if page is not None:
        from twin.base.writing import write_whole
        from twin.lab.pages import student_page

        judging = judge.Judge(found, dealt, file)
        write_whole(Path(page), student_page(judging, result, everything=hidden))
    return result
