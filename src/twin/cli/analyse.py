"""The commands analyse and reproduce: a scenario's loop; the thesis's tables computed again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import click

from ballplate.changes import changes_of, scenario_of
from twin.cli.options import JSON, LAW, PROCESSES, SCENARIO, SETTING, Command
from twin.cli.output import Shown, bold, dim, progress, show
from twin.errors import ScenarioError
from twin.page import Table, digits

if TYPE_CHECKING:
    from twin.scenario import Scenario
    from twin.thesis.chapter8 import Results, SimulatedTable, ThesisCell
    from twin.thesis.chapter9 import Row


Numbers = dict[str, Any]
"""A part of what ``--json`` prints."""


@click.command(cls=Command, example="analyse circle --set controller.kind=lqr")
@SCENARIO(default="sine")
@LAW
@SETTING
@JSON
def analyse(scenario: str, overrides: tuple[str, ...]) -> None:
    """Analyse the loop of a scenario: poles and margins of law, observer and predictor.

    SCENARIO [sine] gives the controller and the dead time of its screen.
    """
    chosen = scenario_of(scenario, changes_of(overrides, {}))
    loop = _loop(chosen)
    show({"scenario": chosen.title, "loop": loop}, _told(loop))


def _loop(scenario: Scenario) -> Numbers:
    """The scenario's own controller, observer and predictor as a sampled loop."""
    from controllers.analysis import loop_row
    from twin.run.assemble import build_controller

    controller = build_controller(scenario)
    dead_time = scenario.sensors.touch.dead_time
    return {
        "controller": scenario.controller.kind,
        "observer": scenario.observer.kind,
        "predictor": None if scenario.predictor is None else scenario.predictor.delay,
        "dead_time": dead_time,
        **loop_row(controller.law, controller.observer, dead_time),
    }


def _told(found: Numbers) -> Iterator[Shown]:
    """The scenario's own loop in words and a table."""
    parts = [found["controller"], found["observer"]]
    if found["predictor"] is not None:
        parts.append(f"predictor {1000 * found['predictor']:g} ms")
    parts.append(f"dead time {1000 * found['dead_time']:g} ms")
    title = f"The scenario's sampled loop: {', '.join(parts)}"
    if found["reason"]:
        yield f"{title}: {found['reason']}"
        return
    lines = [(cut, *_margins(row)) for cut, row in found["margins"].items()]
    yield Table(title, ("cut at", *MARGINS), lines)
    yield f"poles in 1/s, slowest first: {_poles(found['poles'])}"
    if not found["stable"]:
        yield bold("this loop is unstable")
    if found["hold_left_out"]:
        yield "controller: the law's hold and how late its command comes are not in this loop"


MARGINS = ("gain", "phase deg", "disk", "delay ms", "crossover rad/s")


def _margins(row: Numbers | None) -> list[str]:
    if row is None:
        return ["unstable"]
    gain = f"{_shown(row['gain_down'] or 0.0)} to {_shown(row['gain_up'])}"
    rest = (("phase", 1), ("disk", 1), ("delay", 1000), ("crossover", 1))
    return [gain, *(_shown(row[key], scale) for key, scale in rest)]


SLOWEST = 10
"""Poles that are printed."""


def _poles(pairs: Sequence[Sequence[float]]) -> str:
    """Poles for people: conjugate ones as a±bj."""
    upper = [(real, imag) for real, imag in pairs if imag > -1e-6]
    shown = [f"{re:.3g}±{im:.3g}j" if im > 1e-4 else f"{re:.3g}" for re, im in upper[:SLOWEST]]
    return ", ".join(shown) + (", ..." if len(upper) > SLOWEST else "")


def _shown(value: float | None, scale: float = 1.0) -> str:
    return "∞" if value is None else f"{scale * value:.3g}"


@click.command(cls=Command, example="reproduce 8.1 8.4")
@click.argument("tables", nargs=-1, metavar="[TABLE]...")
@PROCESSES
@JSON
def reproduce(tables: tuple[str, ...], processes: int | None) -> int:
    """Recompute the thesis's tables and compare.

    TABLE is a number such as 8.4, or 8 or 9 for the whole chapter; without one, chapter 8. Tables
    8.1 to 8.21 were simulated. 9.1 to 9.9 were measured on the rig: the twin predicts them from one
    number, friction, and explains them by four, each table also by numbers fitted without it.
    """
    from twin.jobs import cores
    from twin.thesis import chapter8, chapter9

    of_8, of_9 = _chapters(tables)
    wanted = [chapter8.tables()[name] for name in of_8]
    jobs = chapter8.plan(wanted)
    with progress("reproducing", sum(job.cost for job in jobs)) as advance:
        each = chapter8.row_results(jobs, processes, advance)
        found: Results = {(one.place, one.way): one for one in each}
    cells = chapter8.compare(wanted, found)
    measured: list[Row] = []
    if of_9:
        with progress("predicting and explaining", 1.0) as advance:
            measured = chapter9.rows(of_9, advance, processes=processes or cores())
    shown = chain(
        _simulated(wanted, cells) if wanted else (),
        _measured(measured) if measured else (),
    )
    show([cell.as_dict() for cell in cells] + measured, shown)
    return int(any(cell.verdict is chapter8.Agreement.DIFFERS for cell in cells))


def _chapters(given: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """The tables asked for, by chapter; a chapter's number stands for all of its tables.

    Raises:
        ScenarioError: If there is no such table.
    """
    from twin.thesis import chapter8, chapter9

    known = {"8": list(chapter8.tables()), "9": list(chapter9.tables())}
    wanted = {name for item in given or ("8",) for name in known.get(item, [item])}
    for name in sorted(wanted):
        if not any(name in tables for tables in known.values()):
            raise ScenarioError(
                f"no table '{name}'; there are "
                + " and ".join(f"{tables[0]} to {tables[-1]}" for tables in known.values())
            )
    of_8, of_9 = ([name for name in tables if name in wanted] for tables in known.values())
    return of_8, of_9


def _measured(rows: list[Row]) -> Iterator[Shown]:
    """The cells of chapter 9, thesis beside twin."""
    from twin.thesis.chapter8 import COLUMNS

    keys = ("thesis", "frictionless", "predicted", "explained", "held_out")
    lines = [
        (
            *(row["table"], row["row"]),
            f"{row['column']} [{COLUMNS[row['column']].unit}]",
            *(digits(row[key], "") for key in keys),
            "fitted" if row["calibration"] else "",
        )
        for row in rows
    ]
    heads = ("table", "row", "quantity", *(key.replace("_", " ") for key in keys), "")
    yield Table("", heads, lines, words=range(len(heads)))


def _simulated(wanted: list[SimulatedTable], cells: list[ThesisCell]) -> Iterator[Shown]:
    from twin.thesis.chapter8 import HEADINGS, lines, sentence

    for table in wanted:
        rows, notes = lines([cell for cell in cells if cell.table == table.id])
        yield Table(f"Table {table.id}: {table.title}", HEADINGS, rows, words=(0, 1, -1))
        yield from map(dim, notes)
        yield ""
    yield dim(
        "exact: continuous control, as kept; sampled: at 2 ms through the seam; MuJoCo: the "
        "mechanism without rolling friction; in brackets the 5 to 95 % range of the seeds or the "
        "range of the reading; (!) an exception, !! unexplained."
    )
    yield sentence(cells)
