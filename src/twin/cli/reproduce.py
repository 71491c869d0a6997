"""The command reproduce: the thesis's simulation tables, computed anew."""

from __future__ import annotations

from pathlib import Path

import click

from twin.cli.output import console, print_json, progress
from twin.cli.scenarios import JSON, check_writable
from twin.reproduce.compare import Cell, Findings, Verdict, compare
from twin.reproduce.doc import write_doc
from twin.reproduce.pool import findings
from twin.reproduce.report import grid, sentence
from twin.reproduce.tables import Table, chosen
from twin.reproduce.work import plan


@click.command()
@click.argument("tables", nargs=-1, metavar="[TABLE]...")
@click.option(
    "--doc",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the comparison with figures to this Markdown file, too.",
)
@click.option("--processes", type=click.IntRange(min=1), help="Processors to use [all].")
@JSON
def reproduce(
    tables: tuple[str, ...], doc: Path | None, processes: int | None, *, as_json: bool
) -> int:
    """Compute the thesis's Tables 8.1 to 8.21 anew and lay them beside its values.

    TABLE is a table's number such as 8.4; without one, all of them are computed.
    """
    wanted = chosen(tables)
    if doc is not None:
        check_writable(doc.parent)
    jobs = plan(wanted)
    with progress("reproducing", sum(job.cost for job in jobs)) as advance:
        found: Findings = {(one.place, one.way): one for one in findings(jobs, processes, advance)}
    cells = compare(wanted, found)
    if doc is not None:
        write_doc(doc, wanted, cells, found)
    if as_json:
        print_json([cell.as_dict() for cell in cells])
    else:
        _show(wanted, cells)
        if doc is not None:
            console.print(f"written to {doc}")
    return int(any(cell.verdict is Verdict.DIFFERS for cell in cells))


def _show(wanted: list[Table], cells: list[Cell]) -> None:
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
