"""The commands list and run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ballplate.catalogue import scenarios
from ballplate.running import CLEAN
from ballplate.running import run as run_scenario
from twin.cli import completion as tab
from twin.cli.options import ALL, JSON, LAW, PLANT, RESET, RIG, SETTING, load_scenario, with_plant
from twin.cli.output import (
    Terminal,
    print_json,
    print_metrics,
    print_reasons,
    print_titles,
    progress,
    say,
    warn,
)
from twin.cli.viewing import VIEWING, Viewing
from twin.errors import LogError
from twin.shipped import find

if TYPE_CHECKING:
    from twin.shadow.examine import Examined


@click.command("list")
@JSON
def list_scenarios(*, as_json: bool) -> None:
    """List the scenarios that can be run by name."""
    print_titles(scenarios(), as_json=as_json)


@click.command()
@click.argument("scenario", shell_complete=tab.scenarios)
@LAW
@SETTING
@PLANT
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [runs/SCENARIO-CHANGES].")
@click.option(
    "--beside",
    multiple=True,
    metavar="SCENARIO",
    help="Run this one as well, simulated, for table and picture; may be repeated.",
)
@RIG
@RESET
@click.option("--resume", is_flag=True, hidden=True)
@click.option("--shadow", is_flag=True, help="Let the twin run beside it: alarms with causes.")
@VIEWING
@ALL
@JSON
def run(
    scenario: str,
    overrides: tuple[str, ...],
    plant: str | None,
    out: Path | None,
    beside: tuple[str, ...],
    rig: str | None,
    viewing: Viewing,
    *,
    reset: bool,
    everything: bool,
    resume: bool,
    shadow: bool,
    as_json: bool,
) -> int:
    """Run a scenario: a name shown by `ballplate list`, or a TOML file."""
    find(scenario)  # a wrong name is told before anything heavy is imported
    if resume:
        warn("--resume: runs are exact again; it begins anew")
    from twin.run.files import former, free, run_folder
    from twin.run.finished import of_other_class

    changed = with_plant(overrides, plant)
    named = run_folder(scenario, (*changed, *([] if rig is None else [f"rig={Path(rig).stem}"])))
    own = out is None and rig is None
    other = own and of_other_class(named, lambda: load_scenario(scenario, changed))
    folder = out or (free(named) if other or rig is not None else named)
    replaced, named_out = former(folder), folder
    replaced += f" (the law of the run in {named}/ was another: it stays)" if other else ""
    terminal = Terminal()
    done = run_scenario(
        scenario,
        changed,
        beside=beside,
        out=folder,
        on=rig,
        reset=reset,
        watch=lambda chosen: terminal.watching(viewing, chosen, folder, twin=shadow),
        reporter=terminal,
    )
    if done.folder != folder and done.folder is not None:
        folder = done.folder
        replaced = f" ({named_out}/ keeps its finished run)"
    examined = _examined(folder) if shadow else None
    model = done.baseline
    if as_json:
        compared_with = model.summary() if model else None
        told = {} if examined is None else {"shadow": examined.numbers}
        print_json({**done.summary(), "verdict": done.verdict, "baseline": compared_with, **told})
    else:
        say(done.title, style="bold")
        shown = {label: each.summary() for label, each in done.shown.items()}
        print_metrics(shown, everything=everything)
        if model is not None:
            print_reasons({CLEAN: model.summary()})
            say(
                f"{CLEAN}: the same controller on the frictionless exact equations it was "
                "designed on, without dead time, noise or mechanism"
            )
        say(done.verdict, style="bold")
        say(*([] if examined is None else examined.sentences))
        files = "picture.png, metrics.json, run.parquet"
        files += "" if examined is None else ", shadow.html, shadow.json, shadow.parquet"
        say(f"written to {folder}/{replaced}: {files}", whole=True)
        more = f"more: --all for every indicator; ballplate report, view, explain {scenario}"
        say(more, style="dim", whole=True)
    viewing.keep(folder)
    return int(not done.finished)


def _examined(folder: Path) -> Examined | None:
    """What the twin says of the run as a whole: the same as `ballplate shadow RUN`."""
    from twin.shadow.examine import examine

    try:
        with progress("the twin beside the whole run", 1.0) as advance:
            return examine(folder, folder, progress=advance)
    except LogError as error:
        warn(f"{error}; the run itself is in {folder}/")
        return None
