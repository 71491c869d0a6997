"""The command safety: every fault injected, its detection and reaction judged."""

from __future__ import annotations

from pathlib import Path

import click
from rich.table import Table

from twin.cli.options import JSON, PROCESSES, check_writable
from twin.cli.output import console, print_json, progress
from twin.jobs import cores
from twin.safety.cases import CASES
from twin.safety.doc import write_doc
from twin.safety.matrix import FaultRow, run_all


@click.command()
@click.option(
    "--doc",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the safety case as Markdown.",
)
@PROCESSES
@JSON
def safety(doc: Path | None, processes: int | None, *, as_json: bool) -> int:
    """Inject every fault into a rig on emulated devices, and judge detection and reaction."""
    if doc is not None:
        check_writable(doc.parent, "--doc")
    with progress("fault matrix", len(CASES)) as advance:
        rows = run_all(processes or cores(), advance)
    if doc is not None:
        write_doc(doc, rows)
    if as_json:
        print_json([row.as_dict() for row in rows])
    else:
        console.print(_table(rows))
        good = sum(row.good for row in rows)
        console.print(f"{good} of {len(rows)} faults were detected in time, safe, and recovered")
        if doc is not None:
            console.print(f"written to {doc}")
    return 0 if all(row.good for row in rows) else 1


def _table(rows: list[FaultRow]) -> Table:
    table = Table("fault", "condition", "allowed ms", "detected ms", "run", "verdict")
    for row in rows:
        seen = "-" if row.detected is None else f"{1e3 * row.detected:.0f}"
        table.add_row(
            row.name,
            row.condition or "none",
            f"{1e3 * row.allowed:.0f}" if row.condition else "-",
            seen if row.condition else "-",
            row.ending,
            "good" if row.good else "[bold red]BAD[/bold red]",
        )
    return table
