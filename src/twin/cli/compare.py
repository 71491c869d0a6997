"""The command compare: several scenarios, or variants of one, side by side."""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.cli.one_run import WORTH_PROCESS, exit_code, warn_of_dangers, watched, with_plant
from twin.cli.options import (
    ALL,
    JSON,
    LAW,
    PLANT,
    PROCESSES,
    SETTING,
    check_writable,
    load_scenario,
)
from twin.cli.output import console, print_json, print_metrics, print_reasons, progress
from twin.data_file import DataError, parse_toml
from twin.errors import ScenarioError

if TYPE_CHECKING:
    from twin.run.execute import Run
    from twin.run.metrics import Motion
    from twin.scenario import Scenario


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
@PROCESSES
@ALL
@JSON
def compare(
    scenarios: tuple[str, ...],
    overrides: tuple[str, ...],
    plant: str | None,
    vary: tuple[str, ...],
    out: Path | None,
    processes: int | None,
    *,
    everything: bool,
    as_json: bool,
) -> int:
    """Run several scenarios, or variants of one, side by side: one table, one picture."""
    changed = with_plant(overrides, plant)
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
    interrupted = False
    try:
        for label, done in _runs(cases, processes):
            runs[label] = done
            save(done, folder / _slug(label), {label: done.motion})
    except KeyboardInterrupt:
        interrupted = True
        if not runs:
            raise
    runs = {label: runs[label] for label in cases if label in runs}
    motions: dict[str, Motion] = {headings[label]: done.motion for label, done in runs.items()}
    title = _comparison([text.partition("=")[0] for text in vary], changed)
    draw(folder / "compare.png", motions, title, next(iter(cases.values())).rig.limits.area)
    summaries = {label: done.summary() for label, done in runs.items()}
    if as_json:
        print_json(summaries)
    else:
        console.print(title, style="bold", markup=False)
        shown = {headings[label]: each for label, each in summaries.items()}
        print_metrics(shown, everything=everything)
        print_reasons(shown)
        console.print(f"written to {folder}/: compare.png and one folder per run")
    return max(interrupted, *(exit_code(done) for done in runs.values()))


def _runs(cases: dict[str, Scenario], processes: int | None) -> Iterator[tuple[str, Run]]:
    """Label and run of every case as they come, on as many processes as are worth it."""
    from twin.jobs import cores, results
    from twin.run.execute import run as run_scenario

    if processes is None:
        long = sum(case.duration for case in cases.values()) >= 2 * WORTH_PROCESS
        processes = cores() if long else 1
    if min(processes, len(cases)) == 1:
        for label, case in cases.items():
            done = watched(case, label)
            yield label, done
            if done.outcome.interrupted:
                return
        return
    for case in cases.values():
        warn_of_dangers(case)
    with progress(", ".join(cases), len(cases), "runs") as advance:
        found = results(run_scenario, cases.items(), min(processes, len(cases)))
        for number, (label, done) in enumerate(found, 1):
            advance(number)
            yield label, done


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
