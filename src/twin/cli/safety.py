"""The command safety: every fault injected, its detection and reaction judged."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli.options import JSON, PROCESSES
from twin.cli.output import console, print_json, progress
from twin.jobs import cores
from twin.writing import check_writable

if TYPE_CHECKING:
    from rich.table import Table

    from twin.safety.row import FaultRow


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
    from twin.safety.cases import CASES
    from twin.safety.doc import write_doc
    from twin.safety.trial import run_all

    if doc is not None:
        check_writable(doc.parent, "--doc")
    with progress("fault matrix", len(CASES)) as advance:
        rows = run_all(processes or cores(), advance)
    if doc is not None:
        write_doc(doc, rows)
    if not as_json:
        console.print(_table(rows))
        good = sum(row.good for row in rows)
        click.echo(f"{good} of {len(rows)} faults were detected in time, safe, and recovered")
        if doc is not None:
            click.echo(f"written to {doc}")
    if as_json:
        print_json([row.as_dict() for row in rows])
    return 0 if all(row.good for row in rows) else 1


def _table(rows: list[FaultRow]) -> Table:
    from rich.table import Table

    from twin.safety.row import HEADING, cells

    table = Table(*HEADING, "verdict")
    for row in rows:
        verdict = "good" if row.good else f"[bold red]BAD[/bold red]: {', '.join(row.failures)}"
        table.add_row(*cells(row), verdict)
    return table
