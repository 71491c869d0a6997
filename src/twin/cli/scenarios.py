"""The commands list, run and compare."""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from controllers.analysis import instability, slow_observer
from twin.cli.options import JSON, PLANT, SETTING, check_writable
from twin.cli.output import console, print_json, print_metrics, progress, warn
from twin.cli.rigs import RESET, RIG, tell
from twin.cli.rigs import chosen as on_rig
from twin.cli.viewing import VIEWING, Viewing
from twin.errors import ScenarioError
from twin.hal.rig import Rig
from twin.run.assemble import build_controller
from twin.run.execute import Run, save
from twin.run.execute import run as run_scenario
from twin.run.loop import Ending
from twin.run.metrics import Motion
from twin.run.picture import draw
from twin.run.record import Recorder
from twin.scenario import Scenario, load, shipped
from twin.scenario.clean import clean

PLANTS = {"mujoco": "honest twin", "lagrange": "exact equations"}
"""What the plants are called in tables and pictures."""


@click.command("list")
@JSON
def list_scenarios(*, as_json: bool) -> None:
    """Show the scenarios that can be run by name."""
    found = {name: _title(path) for name, path in shipped().items()}
    if as_json:
        print_json(found)
        return
    width = max(map(len, found), default=0)
    for name, title in found.items():
        console.print(f"[bold]{name:<{width}}[/bold]  {title}")


@click.command()
@click.argument("scenario")
@SETTING
@PLANT
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [runs/SCENARIO].")
@RIG
@RESET
@VIEWING
@JSON
def run(
    scenario: str,
    overrides: tuple[str, ...],
    plant: str | None,
    out: Path | None,
    rig: str | None,
    viewing: Viewing,
    *,
    reset: bool,
    as_json: bool,
) -> int:
    """Run a scenario: a name shown by `ballplate list`, or a TOML file."""
    chosen = load(scenario, _with_plant(overrides, plant))
    folder = out or Path("runs") / Path(scenario).stem
    check_writable(folder)
    with on_rig(rig, chosen, reset=reset) as real, viewing.of(chosen, folder) as watch:
        done = _run(chosen, watch=watch, quiet=viewing.watch, rig=real)
    if real is not None:
        tell(real)
    label = PLANTS[chosen.plant.kind] if real is None else f"rig {Path(str(rig)).stem}"
    runs: dict[str, Run] = {label: done}
    if chosen.baseline and chosen.plant.kind == "mujoco" and not done.outcome.interrupted:
        runs["clean model"] = _run(clean(chosen))
    save(done, folder, {label: each.motion for label, each in runs.items()})
    if as_json:
        print_json(done.summary())
    else:
        console.print(f"[bold]{chosen.title}[/bold]")
        print_metrics({label: each.summary() for label, each in runs.items()})
        if len(runs) > 1:
            console.print(
                "clean model: the same controller on the frictionless exact equations it was "
                "designed on, without dead time, noise or mechanism"
            )
        console.print(f"written to {folder}/: picture.png, metrics.json, run.parquet")
    viewing.keep(folder)
    return exit_code(done)


@click.command()
@click.argument("scenarios", nargs=-1, required=True)
@SETTING
@PLANT
@click.option(
    "--vary",
    multiple=True,
    metavar="KEY=[A,B,...]",
    help="Run once with each of these values of a key; repeat for combinations.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/compare].")
@JSON
def compare(
    scenarios: tuple[str, ...],
    overrides: tuple[str, ...],
    plant: str | None,
    vary: tuple[str, ...],
    out: Path | None,
    *,
    as_json: bool,
) -> int:
    """Run several scenarios, or variants of one, side by side: one table, one picture."""
    cases: dict[str, Scenario] = {}
    for name in scenarios:
        for variant in itertools.product(*map(_variants, vary)):
            label = " ".join((*([name] if len(scenarios) > 1 or not vary else []), *variant))
            cases[label] = load(name, (*_with_plant(overrides, plant), *variant))
    folder = out or Path("runs") / "compare"
    check_writable(folder)
    runs: dict[str, Run] = {}
    for label, case in cases.items():
        runs[label] = done = _run(case, label)
        save(done, folder / _slug(label), {label: done.motion})
        if done.outcome.interrupted:
            break
    motions: dict[str, Motion] = {label: done.motion for label, done in runs.items()}
    first = next(iter(runs.values())).scenario
    draw(folder / "compare.png", motions, "Comparison", first.rig.limits.area)
    summaries = {label: done.summary() for label, done in runs.items()}
    if as_json:
        print_json(summaries)
    else:
        print_metrics(summaries)
        console.print(f"written to {folder}/: compare.png and a run folder each")
    return max(exit_code(done) for done in runs.values())


def exit_code(done: Run) -> int:
    """0 for a finished run, else 1."""
    return 0 if done.outcome.ending is Ending.FINISHED else 1


def _run(
    scenario: Scenario,
    label: str = "",
    watch: Callable[[Recorder], None] = lambda _: None,
    *,
    quiet: bool = False,
    rig: Rig | None = None,
) -> Run:
    controller = build_controller(scenario)
    dead_time = scenario.sensors.touch.dead_time
    for danger in (
        instability(controller.law, controller.observer, dead_time=dead_time),
        slow_observer(controller.law, controller.observer),
    ):
        if danger:
            warn(danger)
    if quiet:
        return run_scenario(scenario, watch=watch, rig=rig)
    with progress(label or scenario.title, scenario.duration) as advance:
        return run_scenario(scenario, advance, watch, rig)


def _with_plant(overrides: tuple[str, ...], plant: str | None) -> tuple[str, ...]:
    return (*overrides, f"plant.kind={plant}") if plant else overrides


def _variants(text: str) -> list[str]:
    """The overrides ``key=value`` that ``key=[a, b]`` or ``key=a,b`` stands for."""
    key, equals, values = text.partition("=")
    if not equals or not key or not values:
        raise ScenarioError(f"--vary '{text}': write KEY=[A,B,...], as in duration=[5,10]")
    try:
        listed: Any = tomllib.loads(f"values = {values}")["values"]
    except tomllib.TOMLDecodeError:
        listed = values.strip("[]").split(",")
    items = listed if isinstance(listed, list) else [listed]
    return [f"{key}={str(item).strip()}" for item in items]


def _slug(label: str) -> str:
    return "".join(char if char.isalnum() or char in "._-" else "-" for char in label)


def _title(path: Path) -> str:
    try:
        return str(tomllib.loads(path.read_text(encoding="utf-8")).get("title", ""))
    except (OSError, tomllib.TOMLDecodeError) as error:
        return f"(unreadable: {error})"
