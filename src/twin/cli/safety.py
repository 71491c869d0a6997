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

    from twin.safety.mutations import MutationResult
    from twin.safety.row import FaultRow


@click.command()
@click.option(
    "--doc",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the safety case as Markdown.",
)
@click.option(
    "--mutate",
    is_flag=True,
    help="Then take away one line of defence after the other: every row that relies on it must "
    "turn bad.",
)
@PROCESSES
@JSON
def safety(doc: Path | None, processes: int | None, *, mutate: bool, as_json: bool) -> int:
    """Inject every fault into a rig on emulated devices, and judge detection and reaction."""
    from twin.safety.cases import CASES
    from twin.safety.doc import write_doc
    from twin.safety.matrix import run_all
    from twin.safety.mutations import jobs, run_mutations

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
    mutations = []
    if mutate:
        with progress("mutations", len(jobs())) as advance:
            mutations = run_mutations(processes or cores(), advance)
    if as_json and mutate:
        print_json(
            {
                "rows": [row.as_dict() for row in rows],
                "mutations": [each.as_dict() for each in mutations],
            }
        )
    elif as_json:
        print_json([row.as_dict() for row in rows])
    for each in mutations if not as_json else []:
        click.echo(_line(each))
    right = all(row.good for row in rows) and all(each.noticed for each in mutations)
    return 0 if right else 1


def _line(result: MutationResult) -> str:
    """A mutation, and who noticed it."""
    verdict = "noticed" if result.noticed else "NOT NOTICED"
    total = len(result.rows) + len(result.unnoticed)
    names = "; ".join(result.rows) or "none"
    left = f"; good all the same: {'; '.join(result.unnoticed)}" if result.unnoticed else ""
    count = f"{len(result.rows)} of {total} rows"
    return f"{verdict}: {result.name} ({result.change}): {count}: {names}{left}"


def _table(rows: list[FaultRow]) -> Table:
    from rich.table import Table

    from twin.safety.words import HEADING, cells

    table = Table(*HEADING, "verdict")
    for row in rows:
        verdict = "good" if row.good else f"[bold red]BAD[/bold red]: {', '.join(row.failures)}"
        table.add_row(*cells(row), verdict)
    return table
