"""What the thesis measured on the rig, Tables 9.1 to 9.9, as data."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from controllers.interfaces import Law, Reference
from controllers.references.point import Step
from controllers.references.soft import Circle
from twin.errors import ScenarioError
from twin.scenario.schema import checked_settings, choices

__all__ = ["CALIBRATION", "Experiment", "Table", "chosen", "tables"]

CALIBRATION = "9.3"
"""The table whose three tracking errors the twin's parameters are identified from."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A row: one experiment on the rig.

    Attributes:
        table: Number of its table.
        name: What tells it from the table's other rows.
        controller: Kind and settings of the law.
        omega: Angular frequency of the circle in rad/s; None for the step of Table 9.1.
        predicted: Whether a Smith predictor made up for the dead time.
        cells: Column to the thesis's value.
        notes: Column to a remark on the cell.
    """

    table: str
    name: str
    controller: Mapping[str, Any]
    omega: float | None
    predicted: bool
    cells: Mapping[str, float]
    notes: Mapping[str, str]

    def law(self) -> Law:
        """The state feedback."""
        settings = dict(self.controller)
        cls = choices("controller")[settings.pop("kind")]
        law: Law = cls(**checked_settings(cls, settings))
        return law

    def path(self) -> Reference:
        """The reference: the circle of Appendix D, or the step of Table 9.1."""
        if self.omega is None:
            return Step(end=(0.15, 0.15))
        return Circle(amplitude=0.15, omega=self.omega)


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the thesis: its number, what it is about, and its rows."""

    id: str
    title: str
    rows: tuple[Experiment, ...]


@cache
def tables() -> dict[str, Table]:
    """All tables by number, in the thesis's order."""
    text = files(__package__).joinpath("data", "experiments.toml").read_text(encoding="utf-8")
    found = {}
    for entry in tomllib.loads(text)["table"]:
        rows = tuple(
            Experiment(
                table=entry["id"],
                name=row["name"],
                controller=entry["controller"],
                omega=row.get("omega"),
                predicted=entry["predicted"],
                cells=row["cells"],
                notes=row.get("notes", {}),
            )
            for row in entry["row"]
        )
        found[entry["id"]] = Table(id=entry["id"], title=entry["title"], rows=rows)
    return found


def chosen(ids: Iterable[str] = ()) -> list[Experiment]:
    """The experiments of the tables of these numbers, or of all for none, in the thesis's order.

    Raises:
        ScenarioError: If there is no such table.
    """
    wanted, known = list(ids), tables()
    for name in wanted:
        if name not in known:
            raise ScenarioError(f"no table '{name}' of experiments; there are {', '.join(known)}")
    return [
        row for name, table in known.items() if not wanted or name in wanted for row in table.rows
    ]
