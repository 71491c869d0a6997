"""What the thesis measured on the rig, Tables 9.1 to 9.9, as data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache

from twin.thesis import tables as numbered

CALIBRATION = "9.3"
"""The table whose three tracking errors the twin's parameters are identified from."""
FIFTEEN = ("9.2", "9.4", "9.5", "9.6", "9.7")
"""The tables of the 15 tracking errors that are predicted, but for those of the sliding mode."""
SLIDING = ("9.8", "9.9")
"""The tables of the sliding mode."""
LATE, EARLY = ("9.2", "9.4", "9.6", "9.8"), ("9.3", "9.5", "9.7", "9.9")
"""Tables without and with predictor, pair by pair."""


@dataclass(frozen=True, kw_only=True)
class MeasuredExperiment:
    """A row: one experiment on the rig.

    Attributes:
        table: Number of its table.
        name: What distinguishes it from the table's other rows.
        omega: Angular frequency of the circle in rad/s; None for the step of Table 9.1.
        cells: Column to the thesis's value.
        notes: Column to a remark on the cell.
    """

    table: str
    name: str
    omega: float | None
    cells: Mapping[str, float]
    notes: Mapping[str, str]

    @property
    def scenario(self) -> str:
        """Name of the scenario that has its law, predictor and reference."""
        omega = "" if self.omega is None else f"_{round(100 * self.omega):03d}"
        return f"thesis/{self.table.replace('.', '_')}{omega}"


@dataclass(frozen=True, kw_only=True)
class MeasuredTable:
    """A table of the thesis: its number, what it is about, and its rows."""

    id: str
    title: str
    rows: tuple[MeasuredExperiment, ...]


@cache
def tables() -> dict[str, MeasuredTable]:
    """All tables by number, in the thesis's order."""
    found = {}
    for entry in numbered.data(__package__, "experiments")["table"]:
        rows = tuple(
            MeasuredExperiment(
                table=entry["id"],
                name=row["name"],
                omega=row.get("omega"),
                cells=row["cells"],
                notes=row.get("notes", {}),
            )
            for row in entry["row"]
        )
        found[entry["id"]] = MeasuredTable(id=entry["id"], title=entry["title"], rows=rows)
    return found


def chosen(ids: Iterable[str] = ()) -> list[MeasuredExperiment]:
    """The experiments of the tables of these numbers, or of all for none, in the thesis's order.

    Raises:
        ScenarioError: If there is no such table.
    """
    known = numbered.chosen(tables(), ids, "of experiments")
    return [row for table in known for row in table.rows]
