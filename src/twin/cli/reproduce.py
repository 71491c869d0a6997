"""The command reproduce: the thesis's tables, simulated and measured, recomputed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from twin.cli.options import JSON, PROCESSES
from twin.cli.output import console, print_json, progress
from twin.errors import ScenarioError

if TYPE_CHECKING:
    from twin.thesis.chapter8 import Cell, Results, SimulatedTable
    from twin.thesis.chapter9 import Row


@click.command()
@click.argument("tables", nargs=-1, metavar="[TABLE]...")
@PROCESSES
@JSON
def reproduce(tables: tuple[str, ...], processes: int | None, *, as_json: bool) -> int:
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
    if as_json:
        print_json([cell.as_dict() for cell in cells] + measured)
    else:
        if wanted:
            _show(wanted, cells)
        if measured:
            _show_measured(measured, whole=len(of_9) == len(chapter9.tables()))
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


def _show_measured(rows: list[Row], *, whole: bool) -> None:
    """Print the cells of chapter 9, thesis beside twin, and for the whole chapter the goals."""
    from twin.page import Table, digits, terminal
    from twin.thesis import chapter9

    keys = ("thesis", "frictionless", "predicted", "explained", "held_out")
    heads = ("table", "row", "quantity", *(key.replace("_", " ") for key in keys), "")
    found = [
        (
            row["table"],
            row["row"],
            f"{row['column']} [{chapter9.COLUMNS[row['column']][1]}]",
            *(digits(row[key], "") for key in keys),
            "fitted" if row["calibration"] else "",
        )
        for row in rows
    ]
    console.print(terminal(Table("", heads, found, words=(0, 1, 2, -1))))
    if not whole:
        return
    for goal in chapter9.goals(rows):
        verdict = "reached" if goal.reached else "not reached"
        console.print(f"predicted: {verdict}: {goal.sentence}: {goal.found}", markup=False)
    scatter = chapter9.scatter()
    for each in chapter9.held_out_goals(rows):
        verdict = each.verdict(scatter[each.sentence])
        console.print(f"held out: {verdict}: {each.sentence}: {each.value:.3f}", markup=False)


def _show(wanted: list[SimulatedTable], cells: list[Cell]) -> None:
    from twin.page import Table, terminal
    from twin.thesis.chapter8 import HEADINGS, lines, sentence

    for table in wanted:
        rows, notes = lines([cell for cell in cells if cell.table == table.id])
        console.print(f"Table {table.id}: {table.title}", markup=False, style="italic")
        console.print(terminal(Table("", HEADINGS, rows, words=(0, 1, -1))))
        for note in notes:
            console.print(note, markup=False, style="dim")
        console.print()
    console.print(
        "exact: continuous control, as kept; sampled: at 2 ms through the seam; MuJoCo: the "
        "mechanism without rolling friction; in brackets the 5 to 95 % range of the seeds or the "
        "range of the reading; (!) an exception, !! unexplained.",
        style="dim",
    )
    console.print(sentence(cells), markup=False)
