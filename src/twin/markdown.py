"""Markdown of the generated documents."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any


def table(
    headings: Sequence[str], rows: Iterable[Sequence[str]], words: Collection[int] = (0,)
) -> str:
    """A table and the empty line after it.

    Args:
        headings: One per column.
        rows: One cell per column each.
        words: The columns of words, which stand to the left; from the end if negative. All others
            hold numbers and stand to the right.
    """
    count = len(headings)
    left = {column % count for column in words}
    rule = "|".join("---" if column in left else "--:" for column in range(count))
    lines = [_row(headings), f"|{rule}|", *map(_row, rows)]
    return "\n".join(lines) + "\n"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def filled(template: Path, **parts: Any) -> str:
    """The page of a template in Jinja's language; every part that it names must be given."""
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415  heavy: a table needs none

    how = Environment(trim_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined)
    return how.from_string(template.read_text(encoding="utf-8")).render(parts)
