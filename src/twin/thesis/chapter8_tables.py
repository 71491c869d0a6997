"""Tables 8.1 to 8.21 as data: every row is a scenario and the thesis's cells.

A row's own tables are merged over `IDEAL_RIG`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Mask
from twin.base.data_file import read_packaged
from twin.hal.cams import FixedRatio
from twin.hal.interface import Transmission
from twin.run.plants import PlantKind, register
from twin.scenario.load import check
from twin.scenario.merging import merge_tables, put
from twin.scenario.schema import Scenario
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.interface import Plant
from twin.thesis.columns import PACKAGE_NAME

TOLERANCES_PERCENT = {"full_state": 4.0, "observers": 5.0, "tracking": 5.0}
"""Data file to the deviation in % that a value may have from the thesis's."""
CONTROL_PERIOD_S = 0.002
FINE_STEP_S, COARSE_STEP_S = 0.0005, 0.002
"""Physics steps of the mechanism in s: the steady errors of full state feedback, 0.1 mm and less,
shrink with the step; with noise nothing changes by more than 0.01 % between 0.5 and 2 ms."""
IDEAL_RIG = read_packaged(PACKAGE_NAME, "data/ideal.toml")
"""A rig with the imperfections that a row gives, and no others; nothing saturates."""


class Reason(StrEnum):
    """Why a cell is known not to agree with the thesis, the weakest reason first.

    UNEXPLAINED: no reason is known. FITTED: a reason that was fitted to the cell afterwards, which
    the thesis's text does not give. NOT_GIVEN: the cell depends on a number that the thesis does
    not give. COPIED: the cell repeats a number of a different table. ARTEFACT: an artefact of the
    thesis's computation, shown by computing it.
    """

    UNEXPLAINED = "unexplained"
    FITTED = "fitted"
    NOT_GIVEN = "not given"
    COPIED = "copied"
    ARTEFACT = "artefact"


REASON_WORDS = {
    Reason.UNEXPLAINED: "unexplained",
    Reason.FITTED: "with a reason that was fitted to them afterwards",
    Reason.NOT_GIVEN: "that depend on numbers which the thesis does not give",
    Reason.COPIED: "that repeat the numbers of another table",
    Reason.ARTEFACT: "by an artefact of the thesis's computation",
}
"""The reasons in words, behind a number of cells."""


class Disagreement(NamedTuple):
    """Why a cell is known not to agree, as the data file has it.

    Attributes:
        because: What kind of reason there is.
        note: In words.
    """

    because: Reason
    note: str


@dataclass(frozen=True, kw_only=True)
class SimulatedRow:
    """A row: one simulation of the thesis.

    Attributes:
        name: What distinguishes it from the table's other rows.
        detail: Its settings in words.
        setup: The tables of its scenario, without those of ``IDEAL``.
        seeds: Number of runs that differ in their noise.
        bands: Settling band in %, then the narrowest and the widest it may have been read with.
        cells: Column to the thesis's value.
        notes: Column to a remark on the cell.
        causes: Column to what made the thesis's values of this kind inexact.
        exceptions: Column to why this cell is known not to agree.
    """

    name: str
    detail: str = ""
    setup: Mapping[str, Any]
    seeds: int
    bands: Sequence[float]
    cells: Mapping[str, float]
    notes: Mapping[str, str] = field(default_factory=dict)
    causes: Mapping[str, str]
    exceptions: Mapping[str, Disagreement] = field(default_factory=dict)

    def scenario(self, way: str, period: float = CONTROL_PERIOD_S) -> Scenario:
        """What runs, on the plant of ``sampled`` or ``mujoco``, at a control period in s."""
        mechanism = way == "mujoco"
        step = COARSE_STEP_S if "disturbance" in self.setup else FINE_STEP_S
        settings = {
            "plant.kind": "mujoco" if mechanism else "endless",
            "plant.ball_spin": "free" if mechanism else "thesis",
            "plant.step": min(step, period) if mechanism else period,
            "rig.period": period,
        }
        return check(put(merge_tables(IDEAL_RIG, self.setup), settings.items()), self.name)


@dataclass(frozen=True, kw_only=True)
class SimulatedTable:
    """A table of the thesis.

    Attributes:
        id: Its number.
        title: Its subject.
        group: The data file it stands in.
        bound: Deviation in % that a value may have.
        shared: How all tables of the group were made, as far as that was found out.
        own: How this one was made.
        rows: Its rows.
    """

    id: str
    title: str
    group: str
    bound: float
    shared: tuple[str, ...]
    own: tuple[str, ...]
    rows: tuple[SimulatedRow, ...]


@cache
def tables() -> dict[str, SimulatedTable]:
    """All tables by number, in the thesis's order."""
    found = {}
    for group, bound in TOLERANCES_PERCENT.items():
        content = read_packaged(PACKAGE_NAME, f"data/{group}.toml")
        for entry in content["table"]:
            common = {
                "seeds": content.get("seeds", 1),
                "bands": entry.get("bands", (5.0,)),
                "causes": {**content.get("causes", {}), **entry.get("causes", {})},
            }
            setup = merge_tables(content["setup"], entry.get("setup", {}))
            found[entry["id"]] = SimulatedTable(
                id=entry["id"],
                title=entry["title"],
                group=group,
                bound=bound,
                shared=tuple(content["remarks"]),
                own=tuple(entry.get("remarks", ())),
                rows=tuple(_row(common | row, setup) for row in entry["row"]),
            )
    return dict(sorted(found.items(), key=lambda item: int(item[0].split(".")[1])))


def _row(about: Mapping[str, Any], setup: Mapping[str, Any]) -> SimulatedRow:
    """A row of a data file, over the setup of its table."""
    exceptions = {
        column: Disagreement(Reason(each["because"]), each["note"])
        for column, each in about.get("exceptions", {}).items()
    }
    own = {"setup": merge_tables(setup, about.get("setup", {})), "exceptions": exceptions}
    return SimulatedRow(**{**about, **own})


class EndlessPlate(ExactPlant):
    """The equations as the thesis simulates them: its plate has no edge."""

    @property
    def on_plate(self) -> Mask:
        """Always, shape (N,)."""
        return np.ones(self.rigs, bool)


def _endless(scenarios: Sequence[Scenario], _: int) -> tuple[Plant, Transmission]:
    plant = scenarios[0].plant
    endless = EndlessPlate(rigs=len(scenarios), step=plant.step, ball_spin=plant.ball_spin)
    return endless, FixedRatio()


register("endless", PlantKind(_endless, "equations of the thesis", least=2))
