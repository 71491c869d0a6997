"""The commands list, run and compare."""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.cli.options import JSON, LAW, PLANT, SETTING, check_writable, load_scenario, titled
from twin.cli.output import console, print_json, print_metrics, progress, warn
from twin.cli.rigs import RESET, RIG, print_timing
from twin.cli.rigs import chosen as on_rig
from twin.cli.viewing import VIEWING, Viewing
from twin.data_file import DataError, parse_toml, read_toml
from twin.errors import ScenarioError
from twin.shipped import shipped

if TYPE_CHECKING:
    from twin.hal.rig import Rig
    from twin.jobs import SecondProcess
    from twin.run.execute import Run
    from twin.run.metrics import Motion
    from twin.run.record import Recorder
    from twin.scenario import Scenario

PLANTS = {"mujoco": "honest twin", "lagrange": "exact equations"}
"""What the plants are called in tables, pictures and progress."""
CLEAN = "clean model"
WORTH_PROCESS = 5.0
"""Simulated seconds from which a process of its own for the clean model saves time."""


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
    changed = _with_plant(overrides, plant)
    chosen = titled(load_scenario(scenario, changed), changed)
    from twin.jobs import SecondProcess, cores
    from twin.run.execute import save

    folder = out or Path("runs") / Path(scenario).stem
    check_writable(folder)
    label = PLANTS[chosen.plant.kind] if rig is None else f"rig {Path(rig).stem}"
    compared = chosen.baseline and chosen.plant.kind == "mujoco"
    parallel = compared and rig is None and chosen.duration >= WORTH_PROCESS and cores() > 1
    with SecondProcess(wanted=parallel) as beside:
        baseline = _clean(chosen, beside) if compared else None
        with on_rig(rig, chosen, changed, reset=reset) as real, viewing.of(chosen, folder) as watch:
            done = _run(chosen, label, watch, quiet=viewing.watch, rig=real)
        if real is not None:
            print_timing(real)
        runs: dict[str, Run] = {label: done}
        if baseline is not None and not done.outcome.interrupted:
            with suppress(KeyboardInterrupt):
                runs[CLEAN] = baseline()
        save(done, folder, {label: each.motion for label, each in runs.items()}, beside)
    if as_json:
        print_json(done.summary())
    else:
        console.print(chosen.title, style="bold", markup=False)
        print_metrics({label: each.summary() for label, each in runs.items()})
        if len(runs) > 1:
            console.print(
                f"{CLEAN}: the same controller on the frictionless exact equations it was "
                "designed on, without dead time, noise or mechanism"
            )
        console.print(f"written to {folder}/: picture.png, metrics.json, run.parquet")
    viewing.keep(folder)
    return exit_code(done)


@click.command()
@click.argument("scenarios", nargs=-1, required=True)
@LAW
@SETTING
@PLANT
@click.option(
    "--vary",
    multiple=True,
    metavar="KEY=[A,B,...]",
    help="Run once for each value of a key; repeat the option for all combinations.",
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
    changed = _with_plant(overrides, plant)
    cases: dict[str, Scenario] = {}
    headings: dict[str, str] = {}
    for name in scenarios:
        named = (name,) if len(scenarios) > 1 or not vary else ()
        for variant in itertools.product(*map(_variants, vary)):
            label = " ".join((*named, *variant))
            cases[label] = load_scenario(name, (*changed, *variant))
            values = ", ".join(item.partition("=")[2] for item in variant)
            headings[label] = " ".join((*named, values)).strip()
    from twin.run.execute import save
    from twin.run.overview_plot import draw

    folder = out or Path("runs") / "compare"
    check_writable(folder)
    runs: dict[str, Run] = {}
    for label, case in cases.items():
        runs[label] = done = _run(case, label)
        save(done, folder / _slug(label), {label: done.motion})
        if done.outcome.interrupted:
            break
    motions: dict[str, Motion] = {headings[label]: done.motion for label, done in runs.items()}
    title = _comparison([text.partition("=")[0] for text in vary], changed)
    draw(folder / "compare.png", motions, title, next(iter(cases.values())).rig.limits.area)
    summaries = {label: done.summary() for label, done in runs.items()}
    if as_json:
        print_json(summaries)
    else:
        console.print(title, style="bold", markup=False)
        print_metrics({headings[label]: each for label, each in summaries.items()})
        console.print(f"written to {folder}/: compare.png and one folder per run")
    return max(exit_code(done) for done in runs.values())


def exit_code(done: Run) -> int:
    """0 for a finished run, else 1."""
    from twin.run.loop import Ending

    return 0 if done.outcome.ending is Ending.FINISHED else 1


def _run(
    scenario: Scenario,
    label: str,
    watch: Callable[[Recorder], None] = lambda _: None,
    *,
    quiet: bool = False,
    rig: Rig | None = None,
) -> Run:
    from twin.run.execute import run as run_scenario

    _warn_of_dangers(scenario)
    if quiet:
        return run_scenario(scenario, watch=watch, rig=rig)
    with progress(label, scenario.duration) as advance:
        return run_scenario(scenario, advance, watch, rig)


def _warn_of_dangers(scenario: Scenario) -> None:
    from controllers.analysis import instability, slow_observer
    from twin.run.control import build_controller

    controller = build_controller(scenario)
    dead_time = scenario.sensors.touch.dead_time
    for danger in (
        instability(controller.law, controller.observer, dead_time=dead_time),
        slow_observer(controller.law, controller.observer),
    ):
        if danger:
            warn(danger)


def _clean(scenario: Scenario, beside: SecondProcess) -> Callable[[], Run]:
    """Begin the run of the clean model in the second process, if there is one; what ends it."""
    from twin.run import execute
    from twin.scenario.clean import clean

    model = clean(scenario)
    if not beside.there:
        return lambda: _run(model, CLEAN)
    result = beside.begin(execute.run, model)
    beside.begin(execute.load_drawing)

    def finished() -> Run:
        _warn_of_dangers(model)
        with progress(CLEAN, model.duration):
            return result()

    return finished


def _with_plant(overrides: tuple[str, ...], plant: str | None) -> tuple[str, ...]:
    return (*overrides, f"plant.kind={plant}") if plant else overrides


def _variants(text: str) -> list[str]:
    """The overrides ``key=value`` that ``key=[a, b]`` or ``key=a,b`` stands for."""
    key, equals, values = text.partition("=")
    if not equals or not key or not values:
        raise ScenarioError(f"--vary '{text[:200]}': write KEY=[A,B,...], as in duration=[5,10]")
    try:
        listed: Any = parse_toml(f"values = {values}")["values"]
    except tomllib.TOMLDecodeError:
        listed = values.strip("[]").split(",")
    except DataError as error:
        raise ScenarioError(f"--vary '{key[:200]}': {error}") from None
    items = listed if isinstance(listed, list) else [listed]
    return [f"{key}={str(item).strip()}" for item in items]


def _comparison(keys: Sequence[str], changed: Sequence[str]) -> str:
    """What is compared: the keys whose values stand over the columns, and what all runs share."""
    over = f"Comparison over {', '.join(keys)}" if keys else "Comparison"
    return f"{over} ({', '.join(changed)})" if changed else over


def _slug(label: str) -> str:
    return "".join(char if char.isalnum() or char in "._-" else "-" for char in label)


def _title(path: Path) -> str:
    try:
        return str(read_toml(path).get("title", ""))
    except DataError as error:
        return f"(unreadable: {error})"
