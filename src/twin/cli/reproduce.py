"""The command reproduce: the thesis's tables, simulated and measured, recomputed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli import experiments as measured
from twin.cli.options import JSON, PROCESSES
from twin.cli.output import console, print_json, progress
from twin.errors import ScenarioError
from twin.writing import check_writable

if TYPE_CHECKING:
    from twin.thesis.reproduce.compare import Cell, Results
    from twin.thesis.reproduce.tables import SimulatedTable


@click.command()
@click.argument("tables", nargs=-1, metavar="[TABLE]...")
@click.option(
    "--doc",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also write the comparison of one chapter, with figures, to this Markdown file.",
)
@click.option("--fit", is_flag=True, help="Chapter 9 only: refit the friction to Table 9.3.")
@click.option(
    "--explained",
    is_flag=True,
    help="Chapter 9 only: few numbers fitted to all tables; with --fit, fit them again.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With --fit: also write the result to this TOML file.",
)
@PROCESSES
@JSON
def reproduce(
    tables: tuple[str, ...],
    doc: Path | None,
    out: Path | None,
    processes: int | None,
    *,
    fit: bool,
    explained: bool,
    as_json: bool,
) -> int:
    """Recompute the thesis's tables and compare.

    TABLE is a number such as 8.4, or 8 or 9 for the whole chapter; without one, chapter 8. Tables
    8.1 to 8.21 were simulated, 9.1 to 9.9 measured on the rig: those the twin predicts.
    """
    from twin.thesis.experiments.tables import tables as measured_tables
    from twin.thesis.reproduce.compare import Agreement, compare
    from twin.thesis.reproduce.jobs import plan, row_results
    from twin.thesis.reproduce.report import write_doc
    from twin.thesis.reproduce.tables import chosen

    of_8, of_9 = _chapters(tables)
    _check(of_8, of_9, doc, out, fit=fit, explained=explained)
    if explained or fit or (doc is not None and of_9):
        return _of_chapter_9(of_9, doc, out, processes, fit=fit, explained=explained, json=as_json)
    wanted = chosen(of_8) if of_8 else []
    jobs = plan(wanted)
    with progress("reproducing", sum(job.cost for job in jobs)) as advance:
        each = row_results(jobs, processes, advance)
        found: Results = {(one.place, one.way): one for one in each}
    cells = compare(wanted, found)
    predicted = measured.predict(of_9) if of_9 else []
    if doc is not None:
        write_doc(doc, wanted, cells, found)
    if as_json:
        print_json([cell.as_dict() for cell in cells] + predicted)
    else:
        if wanted:
            _show(wanted, cells)
        if predicted:
            measured.show(predicted, whole=len(of_9) == len(measured_tables()))
        if doc is not None:
            console.print(f"written to {doc}")
    return int(any(cell.verdict is Agreement.DIFFERS for cell in cells))


def _check(
    of_8: list[str],
    of_9: list[str],
    doc: Path | None,
    out: Path | None,
    *,
    fit: bool,
    explained: bool,
) -> None:
    """Make sure that the options go together.

    Raises:
        ScenarioError: If not, or if nothing can be written where they say.
    """
    from twin.thesis.experiments.tables import tables as measured_tables

    whole = len(of_9) == len(measured_tables())
    wrong = {
        "--out belongs to --fit: reproduce 9 --fit --out FILE": out is not None and not fit,
        "--explained belongs to chapter 9: reproduce 9 --explained": explained
        and (of_8 or not of_9),
        "--fit belongs to chapter 9: reproduce 9 --fit": fit and of_8,
        "--explained with --fit or --doc needs all tables of chapter 9: 9": explained
        and (fit or doc is not None)
        and not whole,
        "--doc of chapter 9 needs all its tables and no others: 9": doc is not None
        and of_9
        and (of_8 or not whole),
    }
    for line, so in wrong.items():
        if so:
            raise ScenarioError(line)
    for option, file in (("--doc", doc), ("--out", out)):
        if file is not None:
            check_writable(file.parent, option)


def _of_chapter_9(
    of_9: list[str],
    doc: Path | None,
    out: Path | None,
    processes: int | None,
    *,
    fit: bool,
    explained: bool,
    json: bool,
) -> int:
    """What is asked of chapter 9 alone: to fit, to explain or to document it."""
    from twin.cli import explanation
    from twin.thesis.experiments.tables import tables as measured_tables

    if doc is not None:
        return explanation.document(doc) if explained else measured.document(doc)
    if fit and explained:
        return explanation.fit(processes, out, as_json=json)
    if fit:
        return measured.fit(out, as_json=json)
    return explanation.show(of_9, as_json=json, whole=len(of_9) == len(measured_tables()))


def _chapters(given: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """The tables asked for, by chapter; a chapter's number stands for all of its tables.

    Raises:
        ScenarioError: If there is no such table.
    """
    from twin.thesis.experiments.tables import tables as measured_tables
    from twin.thesis.reproduce.tables import tables as simulated_tables

    known = {"8": list(simulated_tables()), "9": list(measured_tables())}
    wanted = {name for item in given or ("8",) for name in known.get(item, [item])}
    for name in sorted(wanted):
        if not any(name in tables for tables in known.values()):
            raise ScenarioError(
                f"no table '{name}'; there are "
                + " and ".join(f"{tables[0]} to {tables[-1]}" for tables in known.values())
            )
    of_8, of_9 = ([name for name in tables if name in wanted] for tables in known.values())
    return of_8, of_9


def _show(wanted: list[SimulatedTable], cells: list[Cell]) -> None:
    from twin.thesis.reproduce.report import grid, sentence

    for table in wanted:
        out, notes = grid(table, cells)
        console.print(out)
        for note in notes:
            console.print(note, markup=False, style="dim")
        console.print()
    console.print(
        "exact: continuous control; sampled: at 2 ms through the seam; MuJoCo: the mechanism "
        "without rolling friction; in brackets the 5 to 95 % range of the seeds or the range of "
        "the reading; (!) an exception, !! unexplained.",
        style="dim",
    )
    console.print(sentence(cells), markup=False)
