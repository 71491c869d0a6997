"""The command compare: several scenarios, or variants of one, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from twin.cli import completion as tab
from twin.cli.options import ALL, JSON, LAW, PLANT, PROCESSES, SETTING, VARY, with_plant
from twin.cli.output import Terminal, print_json, print_metrics, print_reasons, say
from twin.report.numbers import own_settings, ranking
from twin.shipped import find


@click.command()
@click.argument("sources", nargs=-1, required=True, shell_complete=tab.sources)
@LAW
@SETTING
@PLANT
@VARY
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder [runs/compare-SOURCES-CHANGES]."
)
@PROCESSES
@ALL
@JSON
def compare(
    sources: tuple[str, ...],
    overrides: tuple[str, ...],
    plant: str | None,
    vary: tuple[str, ...],
    out: Path | None,
    processes: int | None,
    *,
    everything: bool,
    as_json: bool,
) -> int:
    """Run several scenarios, or variants of one, side by side: one table, one picture.

    SOURCES are scenarios, finished runs (run folders, or `last`), and CSV logs, which are laid over
    what the twin predicts for the scenario beside them.
    """
    from twin.run.files import sorted_out

    for name in sorted_out(sources).scenarios:
        find(name)  # a wrong name is told before anything heavy is imported
    from ballplate.comparing import compare as compare_sources
    from twin.run.files import run_folder
    from twin.run.logs import distances
    from twin.scenario.variants import parsed, varied

    over, changed = parsed(vary), with_plant(overrides, plant)

    def folder_of(names: Sequence[str]) -> Path:
        stems = (Path(name).stem if name.endswith(".toml") else Path(name).name for name in names)
        return run_folder(f"compare-{'-'.join(stems)}", (*varied(over), *changed))

    found = compare_sources(
        *sources,
        vary=over,
        settings=changed,
        out=out or folder_of,
        processes=processes,
        reporter=Terminal(),
    )
    summaries = found.summaries()
    if as_json:
        print_json(summaries)
    else:
        say(found.title, style="bold")
        shown = {found.headings[label]: each for label, each in summaries.items()}
        print_metrics(shown, everything=everything)
        print_reasons(shown)
        finished = [label for label in found if label not in found.folders]
        say(*own_settings({found.headings[each]: found[each] for each in finished}))
        measured = {label: found[label] for label in found.logs}
        say(*distances(measured, found.motions), ranking(shown), style="bold")
        files = f"compare.png, compare.json{' and one folder per run' if found.folders else ''}"
        say(f"written to {found.folder}/{found.replaced}: {files}", whole=True)
    early = (not found[label].finished for label in found.folders)
    return int(found.interrupted or any(early))
