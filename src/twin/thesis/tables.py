"""What the tables of both chapters have in common: a data file, and a choice by number."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Any, TypeVar

from twin.errors import ScenarioError

Numbered = TypeVar("Numbered")


def data(package: str, name: str) -> dict[str, Any]:
    """The content of ``data/<name>.toml`` of a package."""
    text = files(package).joinpath("data", f"{name}.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def chosen(known: Mapping[str, Numbered], ids: Iterable[str], what: str) -> list[Numbered]:
    """The tables of these numbers, or all of them for none, in the thesis's order.

    Args:
        known: Number to table, in the thesis's order.
        ids: Their numbers.
        what: What there is no table of, in words.

    Raises:
        ScenarioError: If there is no such table.
    """
    wanted = list(ids)
    for name in wanted:
        if name not in known:
            raise ScenarioError(f"no table '{name}' {what}; there are {', '.join(known)}")
    return [table for name, table in known.items() if not wanted or name in wanted]
