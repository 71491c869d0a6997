"""The commands list and run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli.one_run import WORTH_PROCESS, exit_code, warn_of_dangers, watched, with_plant
from twin.cli.options import ALL, JSON, LAW, PLANT, SETTING, check_writable, load_scenario, titled
from twin.cli.output import console, print_json, print_metrics, print_reasons, progress
from twin.cli.rigs import RESET, RIG, print_timing
from twin.cli.rigs import chosen as on_rig
from twin.cli.viewing import VIEWING, Viewing
from twin.data_file import DataError, read_toml
from twin.errors import ScenarioError
from twin.shipped import shipped

if TYPE_CHECKING:
    from twin.jobs import SecondProcess
    from twin.run.execute import Run
    from twin.scenario import Scenario

PLANTS = {"mujoco": "honest twin", "lagrange": "exact equations"}
"""What the plants are called in tables, pictures and progress."""
CLEAN = "clean model"


@click.command("list")
@JSON
def list_scenarios(*, as_json: bool) -> None:
    """List the scenarios that can be run by name."""
    found = {name: _title(path) for name, path in shipped().items()}
    if as_json:
        print_json(found)
        return
    width = max(map(len, found), default=0)
    for name, title in found.items():
        console.print(f"[bold]{name:<{width}}[/bold]  {title}")


@click.command()
@click.argument("scenario")
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
@click.option("--resume", is_flag=True, help="Go on with the run in the run folder, interrupted.")
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
    as_json: bool,
) -> int:
    """Run a scenario: a name shown by `ballplate list`, or a TOML file."""
    changed = with_plant(overrides, plant)
    chosen = titled(load_scenario(scenario, changed), changed)
    others = {name: load_scenario(name, changed) for name in beside}
    from twin.jobs import SecondProcess, cores
    from twin.report.summary import judged
    from twin.run.execute import save, versions
    from twin.run.folders import former, free, run_folder
    from twin.run.past import interrupted

    named = run_folder(scenario, (*changed, *([] if rig is None else [f"rig={Path(rig).stem}"])))
    folder = out or (named if rig is None else free(named))
    if resume and rig is not None:
        raise ScenarioError("--resume: only a simulated run can be gone on with; leave out --rig")
    past = interrupted(folder, chosen, versions()) if resume else None
    check_writable(folder)
    label = PLANTS[chosen.plant.kind] if rig is None else f"rig {Path(rig).stem}"
    compared = chosen.baseline and chosen.plant.kind == "mujoco"
    parallel = compared and rig is None and chosen.duration >= WORTH_PROCESS and cores() > 1
    with SecondProcess(wanted=parallel) as second:
        baseline = _clean(chosen, second) if compared else None
        with on_rig(rig, chosen, changed, reset=reset) as real, viewing.of(chosen, folder) as watch:
            done = watched(chosen, label, watch, quiet=viewing.watch, rig=real, past=past)
        if real is not None:
            print_timing(real)
        runs: dict[str, Run] = {label: done}
        if baseline is not None and not done.outcome.interrupted:
            with suppress(KeyboardInterrupt):
                runs[CLEAN] = baseline()
        for name, other in {} if done.outcome.interrupted else others.items():
            with suppress(KeyboardInterrupt):
                runs[name] = watched(other, name)
        replaced = former(folder)
        save(done, folder, {label: each.motion for label, each in runs.items()}, second)
    model = runs.get(CLEAN)
    sentence = judged(done, model)
    if as_json:
        compared_with = model.summary() if model else None
        print_json({**done.summary(), "verdict": sentence, "baseline": compared_with})
    else:
        console.print(chosen.title, style="bold", markup=False)
        print_metrics(
            {label: each.summary() for label, each in runs.items()}, everything=everything
        )
        if model:
            print_reasons({CLEAN: model.summary()})
            console.print(
                f"{CLEAN}: the same controller on the frictionless exact equations it was "
                "designed on, without dead time, noise or mechanism"
            )
        console.print(sentence, style="bold", markup=False)
        files = "picture.png, metrics.json, run.parquet"
        console.print(f"written to {folder}/{replaced}: {files}", markup=False, soft_wrap=True)
        console.print(
            f"more: --all for every indicator; ballplate report, view, explain {scenario}",
            style="dim",
            markup=False,
            soft_wrap=True,
        )
    viewing.keep(folder)
    return exit_code(done)


def _title(path: Path) -> str:
    try:
        return str(read_toml(path).get("title", ""))
    except DataError as error:
        return f"(unreadable: {error})"


def _clean(scenario: Scenario, beside: SecondProcess) -> Callable[[], Run]:
    """Begin the run of the clean model in the second process, if there is one; what ends it."""
    from twin.run import execute
    from twin.scenario.clean import clean

    model = clean(scenario)
    if not beside.there:
        return lambda: watched(model, CLEAN)
    result = beside.begin(execute.run, model)
    beside.begin(execute.load_drawing)

    def finished() -> Run:
        warn_of_dangers(model)
        with progress(CLEAN, model.duration):
            return result()

    return finished
