"""The command that computes the thesis's tables again."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

import click

from twin.base.errors import ScenarioError
from twin.base.page import Table, digits
from twin.cli import options
from twin.cli.output import Shown, dim, progress, show

if TYPE_CHECKING:
    from twin.thesis.chapter8 import ThesisCell
    from twin.thesis.chapter8_runs import Results
    from twin.thesis.chapter8_tables import SimulatedTable
    from twin.thesis.chapter9 import Row


@options.command(example="reproduce 8.1 8.4")
@click.argument("tables", nargs=-1, metavar="[TABLE]...")
@options.PROCESSES_OPTION
@options.JSON_OPTION
def reproduce(tables: tuple[str, ...], processes: int | None) -> int:
    """Recompute the thesis's tables and compare.

    TABLE is a number such as 8.4, or 8 or 9 for the whole chapter; without one, chapter 8. Tables
    8.1 to 8.21 were simulated. 9.1 to 9.9 were measured on the rig: the twin predicts them from one
    number, friction, and explains them by four, each table also by numbers fitted without it.
    """
    from twin.base.jobs import cores
    from twin.thesis import chapter8, chapter8_runs, chapter8_tables, chapter9

    of_8, of_9 = _chapters(tables)
    wanted = [chapter8_tables.tables()[name] for name in of_8]
    jobs = chapter8_runs.plan(wanted)
    with progress("reproducing", sum(job.cost for job in jobs)) as advance:
        each = chapter8_runs.row_results(jobs, processes, advance)
        found: Results = {(one.place, one.way): one for one in each}
    cells = chapter8.compare(wanted, found)
    measured: list[Row] = []
    if of_9:
        with progress("predicting and explaining", 1.0) as advance:
            measured = chapter9.rows(of_9, advance, processes=processes or cores())
    shown = chain(
        _chapter8_tables(wanted, cells) if wanted else (),
        _chapter9_tables(measured) if measured else (),
    )
    show([cell.as_dict() for cell in cells] + measured, shown)
    return int(any(cell.verdict is chapter8.Agreement.DIFFERS for cell in cells))


def _chapters(given: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """The tables asked for, by chapter; a chapter's number stands for all of its tables.

    Raises:
        ScenarioError: If there is no such table.
    """
    from twin.thesis import chapter8_tables, chapter9

    known = {"8": list(chapter8_tables.tables()), "9": list(chapter9.tables())}
    wanted = {name for item in given or ("8",) for name in known.get(item, [item])}
    for name in sorted(wanted):
        if not any(name in tables for tables in known.values()):
            raise ScenarioError(
                f"no table '{name}'; there are "
                + " and ".join(f"{tables[0]} to {tables[-1]}" for tables in known.values())
            )
    of_8, of_9 = ([name for name in tables if name in wanted] for tables in known.values())
    return of_8, of_9


def _chapter9_tables(rows: list[Row]) -> Iterator[Shown]:
    """The cells of chapter 9, thesis next to twin."""
    from twin.thesis.columns import THESIS_COLUMNS

    keys = ("thesis", "frictionless", "predicted", "explained", "held_out")
    lines = [
        (
            *(row["table"], row["row"]),
            f"{row['column']} [{THESIS_COLUMNS[row['column']].unit}]",
            *(digits(row[key], "") for key in keys),
            "fitted" if row["calibration"] else "",
        )
        for row in rows
    ]
    heads = ("table", "row", "quantity", *(key.replace("_", " ") for key in keys), "")
    yield Table("", heads, lines, words=range(len(heads)))


def _chapter8_tables(wanted: list[SimulatedTable], cells: list[ThesisCell]) -> Iterator[Shown]:
    from twin.thesis.chapter8 import CHAPTER8_HEADINGS, lines, sentence

    for table in wanted:
        rows, notes = lines([cell for cell in cells if cell.table == table.id])
        yield Table(f"Table {table.id}: {table.title}", CHAPTER8_HEADINGS, rows, words=(0, 1, -1))
        yield from map(dim, notes)
        yield ""
    yield dim(
        "exact: continuous control, as kept; sampled: at 2 ms through the seam; MuJoCo: the "
        "mechanism without rolling friction; in brackets the 5 to 95 % range of the seeds or the "
        "range of the reading; (!) does not agree for the reason noted, !! unexplained."
    )
    yield sentence(cells)
