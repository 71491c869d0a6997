"""The thesis's Tables 8.1 to 8.21 as data: what was simulated, what came out, what is known."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from twin.errors import ScenarioError

FILES = {"full_state": 4.0, "observers": 5.0, "tracking": 5.0}
"""Data file to the deviation in % that a value may have from the thesis's."""


@dataclass(frozen=True, kw_only=True)
class SimulatedRow:
    """A row: one simulation of the thesis.

    Attributes:
        name: What distinguishes it from the table's other rows.
        detail: Its settings in words.
        setup: Its settings; see ``twin.thesis.reproduce.cases``.
        cells: Column to the thesis's value.
        notes: Column to a remark on the cell.
        causes: Column to what made the thesis's values of this kind inexact.
        exceptions: Column to the reason why this cell cannot be reproduced.
    """

    name: str
    detail: str
    setup: Mapping[str, Any]
    cells: Mapping[str, float]
    notes: Mapping[str, str]
    causes: Mapping[str, str]
    exceptions: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class SimulatedTable:
    """A table of the thesis.

    Attributes:
        id: Its number.
        title: What it compares.
        group: The data file it stands in.
        bound: Deviation in % that a value may have.
        shared: How all tables of the group were made, as far as that was found out.
        own: How this one was made.
        rows: Its rows.
        fitted: Settings, and their label, that fit better than those of the text; or None.
    """

    id: str
    title: str
    group: str
    bound: float
    shared: tuple[str, ...]
    own: tuple[str, ...]
    rows: tuple[SimulatedRow, ...]
    fitted: Mapping[str, Any] | None

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns, in the thesis's order."""
        return tuple(self.rows[0].cells)


@cache
def tables() -> dict[str, SimulatedTable]:
    """All tables by number, in the thesis's order."""
    found = {}
    for group, bound in FILES.items():
        text = files(__package__).joinpath("data", f"{group}.toml").read_text(encoding="utf-8")
        content = tomllib.loads(text)
        for entry in content["table"]:
            found[entry["id"]] = _table(entry, group, bound, content)
    return dict(sorted(found.items(), key=lambda item: int(item[0].split(".")[1])))


def chosen(ids: Iterable[str]) -> list[SimulatedTable]:
    """The tables of these numbers, or all of them for none, in the thesis's order.

    Raises:
        ScenarioError: If there is no such table.
    """
    wanted = list(ids)
    for name in wanted:
        if name not in tables():
            raise ScenarioError(f"no table '{name}' to reproduce; there are {', '.join(tables())}")
    return [table for name, table in tables().items() if not wanted or name in wanted]


def merged(settings: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with more of them laid over; of another ``kind``, a table is replaced whole."""
    out = dict(settings)
    for key, value in more.items():
        old = out.get(key)
        if isinstance(value, dict) and isinstance(old, dict) and value.get("kind") in _same(old):
            out[key] = merged(old, value)
        else:
            out[key] = value
    return out


def _same(settings: Mapping[str, Any]) -> tuple[Any, ...]:
    return (None, settings.get("kind"))


def _table(
    entry: Mapping[str, Any], group: str, bound: float, content: Mapping[str, Any]
) -> SimulatedTable:
    setup = merged(content["setup"], entry.get("setup", {}))
    rows = tuple(
        SimulatedRow(
            name=row["name"],
            detail=row.get("detail", ""),
            setup=merged(setup, row.get("setup", {})),
            cells=row["cells"],
            notes=row.get("notes", {}),
            causes={**content.get("causes", {}), **entry.get("causes", {})},
            exceptions=row.get("exceptions", {}),
        )
        for row in entry["row"]
    )
    return SimulatedTable(
        id=entry["id"],
        title=entry["title"],
        group=group,
        bound=bound,
        shared=tuple(content["remarks"]),
        own=tuple(entry.get("remarks", ())),
        rows=rows,
        fitted=entry.get("fitted"),
    )
