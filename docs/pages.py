"""What the scripts of this folder share: templates, kept results, batches, points of laws."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from ballplate.changes import KeyChange
from controllers.arrays import Array
from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.base.page import render_template as filled_template
from twin.base.writing import write_json, write_whole
from twin.run.loop import drive
from twin.run.metrics import Ending
from twin.run.record import Recorder
from twin.scenario.load import read
from twin.scenario.schema import Scenario
from twin.sim.rig import SimulatedRig
from twin.study.compiled import carry_out_compiled
from twin.study.work import ScenarioRuns, c_code, code, digest

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HERE = Path(__file__).parent


def filled(name: str, **parts: Any) -> str:
    """The page of a template in this folder."""
    return filled_template(HERE / f"{name}.template.md", **parts)


def parts(name: str, text: str) -> dict[str, str]:
    """The pages in a text, file name to page; a line ``<!-- NAME.md -->`` begins another one."""
    first, *others = re.split(r"^<!-- ([\w-]+\.md) -->\n", text, flags=re.MULTILINE)
    pages = {name: first, **dict(zip(others[::2], others[1::2], strict=True))}
    return {file: page.rstrip() + "\n" for file, page in pages.items()}


def write(path: Path, text: str) -> None:
    """Write the pages of a text, the first to a path and the others beside it.

    Raises:
        RecordError: If a file cannot be written.
    """
    for file, page in parts(path.name, text).items():
        write_whole(path.parent / file, page)


def planned(name: str) -> dict[str, Any]:
    """What a script of this folder is to run; a law ``of`` a scenario sets what that has of it."""
    plan = tomllib.loads((HERE / f"{name}.toml").read_text(encoding="utf-8"))
    for law in plan.get("laws", ()):
        if "of" in law:
            tables = read(law["of"])[0]
            law["set"] = [KeyChange.of(key, tables[key]).text for key in ("controller", "observer")]
    return plan


def said(value: float | None, form: str = ".3g") -> str:
    """A number of a table; a dash where there is none."""
    return "-" if value is None else f"{value:{form}}"


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share, in %; of none, all that there can be."""
    ends = stats.binomtest(hits, max(count, 1)).proportion_ci(method="wilson")
    return 100 * float(ends.low), 100 * float(ends.high)


def clopper_pearson(hits: int, count: int) -> tuple[float, float]:
    """Exact 95 % interval of a share by Clopper and Pearson, in %."""
    ends = stats.binomtest(hits, count).proportion_ci(method="exact")
    return 100 * float(ends.low), 100 * float(ends.high)


def kept(name: str, key: str, make: Callable[[], Any]) -> Any:
    """What is kept in runs/NAME under a key, else what is made and then kept."""
    file = HERE.parent / "runs" / name / f"{key}.json"
    if file.is_file():
        return json.loads(file.read_text(encoding="utf-8"))
    found = make()
    write_json(file, found)
    return found


def compiled_rows(
    name: str, runs: Sequence[Scenario], columns: Collection[str]
) -> list[dict[str, Any]]:
    """Columns of runs in C, a row each: as kept in runs/NAME, or simulated and then kept."""

    def simulate() -> list[dict[str, Any]]:
        work = ScenarioRuns(runs)
        rows = carry_out_compiled(work.jobs(work.tasks))
        return [{column: row[column] for column in columns} for row in rows]

    texts = (code(), c_code(), *(each.model_dump_json() for each in runs))
    found: list[dict[str, Any]] = kept(name, digest(" ".join(texts)), simulate)
    return found


def driven(
    rig: SimulatedRig,
    controller: Controller,
    duration: float,
    keep: Callable[[int, Measurement], None] | None = None,
    channels: tuple[str, ...] = ("state",),
    every: int = 1,
) -> tuple[Recorder, Array, list[bool]]:
    """What rigs of a batch did: the record, where their balls were to be, and who finished.

    Args:
        rig: The rigs, not switched on.
        controller: Theirs.
        duration: Of the run in s.
        keep: Shown number and measurement of every period before anything is done in it.
        channels: What is recorded.
        every: Control periods from one instant of the record to the next.

    Returns:
        The record; positions in m, shape (K, rigs, 2); and whether each rig finished.
    """
    period, rigs = controller.period, len(rig.supervisor.state)
    record = Recorder(round(duration / period), rigs, period, keep=channels, every=every)
    with np.errstate(all="ignore"):
        outcomes = drive(rig, controller, duration, record, keep=keep)
    desired = controller.reference(record.time)[0].reshape(record.length, -1, 2)
    return record, desired, [outcome.ending is Ending.FINISHED for outcome in outcomes]


def points(
    axis: Axes,
    found: Sequence[float | None],
    beyond: float,
    words: tuple[str, str],
    *,
    full: bool,
    large: bool,
) -> None:
    """A law's numbers from below upwards, and red crosses where there is none.

    Args:
        axis: Where.
        found: One per law.
        beyond: Where the crosses are.
        words: For the legend: what points are, and crosses.
        full: Whether points are filled, else open.
        large: Whether crosses are.
    """
    rows, gone = np.arange(len(found)), np.array([value is None for value in found])
    x = np.array([beyond if value is None else value for value in found])
    face = "tab:blue" if full else "none"
    look: dict[str, Any] = {"facecolors": face, "edgecolors": "tab:blue", "label": words[0]}
    look |= {"zorder": 3}  # above the lines of the grid
    axis.scatter(x[~gone], rows[~gone], s=30, **look)
    axis.scatter(
        x[gone], rows[gone], s=40 if large else 15, marker="x", c="tab:red", label=words[1]
    )
