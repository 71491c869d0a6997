"""Writes settings.md of this folder: python docs/settings.py."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path

from twin.markdown import table
from twin.scenario.describe import Key, about, described, every_kind

INTRODUCTION = """\
# Every setting

Written by docs/settings.py. `--set KEY=VALUE` sets one on the command line, the tables of a
scenario file do so for good; `ballplate describe NAME` shows what stands here of a key, a table, or
a law, observer or reference.
"""


def page() -> str:
    """Every setting, as Markdown."""
    parts = [INTRODUCTION]
    for name, keys in groupby(described(), lambda key: key.key.rpartition(".")[0]):
        parts += [f"## {name or 'The scenario'}\n", _table(keys)]
    for kind, settings in every_kind().items():
        sentence = _cell(about(kind))
        shown = _table(settings) if settings else "It has no settings.\n"
        parts += [f"## {kind}\n", f"{sentence}\n", shown]
    return "\n".join(parts)


def _table(keys: Iterable[Key]) -> str:
    headings = ("key", "default", "unit", "type", "allowed", "meaning")
    rows = [
        (
            f"`{key.key}`",
            f"`{key.value}`",
            key.unit,
            key.type,
            _cell(key.allowed),
            _cell(key.meaning + (" Mechanism only." if key.plants else "")),
        )
        for key in keys
    ]
    return table(headings, rows, range(len(headings)))


def _cell(text: str) -> str:
    """A text that no table and no formatting takes apart."""
    return text.replace("|", r"\|").replace("*", r"\*")


if __name__ == "__main__":
    Path(__file__).with_suffix(".md").write_text(page(), encoding="utf-8")
