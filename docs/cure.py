"""Makes cure.md and its picture: who wins against friction, dead time and noise, and by how much.

uv run python docs/cure.py                  # what cure.toml says
uv run python docs/cure.py --rigs 20        # more rigs of the family
uv run python docs/cure.py --finished       # a page of what has been simulated, at once
Finished tasks are kept in runs/cure and used again while scenarios and code stay the same.
"""

from __future__ import annotations

import inspect
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import click
import numpy as np
from pages import HERE, filled, kept, planned, points, said

from twin.base.writing import write_whole

EVERY = 5
BAND = 0.005
FLOOR = "circle 0.75 rad/s"
"""Task for which the cure is compared with the least that is possible."""
KINDS = {
    "tracking": ("e_tt", "%"),
    "median": ("median distance", "mm"),
    "rms": ("RMS distance", "mm"),
    "settled": ("within 5 mm for good after", "s"),
}


class Cell(NamedTuple):
    """What a law reached on a task."""

    nominal: float | None
    """Mean of the runs of the nominal rig; None if the ball was lost, or it never settled."""
    worst: float | None
    """Of the rigs of the family; None if one of them was lost or never settled."""
    missing: int
    """How many rigs that holds for."""
    span: tuple[float, float]
    """Least and largest of the runs of the nominal rig."""
    rigs: list[float | None]
    """Every rig of the family."""


def scenarios(plan: dict[str, Any], task: dict[str, Any]) -> list[Any]:
    """Of every law in turn: the nominal rig with several noises, then those of the family."""
    from twin.study.schema import drawn, read_family  # noqa: PLC0415
    from twin.study.work import Builder  # noqa: PLC0415

    build = Builder(plan["scenario"])
    rigs = drawn(read_family(plan["family"]), plan["draw"], plan["rigs"])
    found = []
    for law in plan["laws"]:
        fixed = settings(plan, task, law)
        found += [build([*fixed, f"seed={noise}"], {}) for noise in range(plan["noises"])]
        found += [build([*fixed, f"seed={rig.seed}"], rig.point) for rig in rigs]
    return found


def settings(plan: dict[str, Any], task: dict[str, Any], law: dict[str, Any]) -> list[str]:
    """What a law on a task sets of the scenario."""
    turns, omega = str(task.get("turns", [task["omega"]])), str(task["omega"])
    texts = [text.replace("TURNS", turns).replace("OMEGA", omega) for text in law["set"]]
    return [*plan["set"], *task["set"], *texts]


def key(runs: list[Any], judged: str) -> str:
    """What tells runs of one batch and what is judged of them from every other."""
    from twin.study.work import code, digest  # noqa: PLC0415

    how = f"{inspect.getsource(simulated)} {BAND} {EVERY}"
    return digest(" ".join((code(), judged, how, *(each.model_dump_json() for each in runs))))


def known(
    runs: list[Any], judged: str = "tracking", *, simulate: bool = True
) -> list[float | None] | None:
    """What is judged of scenarios that run as one batch, on the true ball: as kept or simulated.

    None if it is not known.
    """
    return kept("cure", key(runs, judged), lambda: simulated(runs, judged), simulate=simulate)


def simulated(runs: list[Any], judged: str) -> list[float | None]:
    """The same, by one batch."""
    from twin.run.assemble import assemble  # noqa: PLC0415
    from twin.run.loop import drive  # noqa: PLC0415
    from twin.run.metrics import (  # noqa: PLC0415
        Ending,
        Motion,
        measure,
    )
    from twin.run.record import Recorder  # noqa: PLC0415

    rig, controller = assemble(runs, threads=1)
    duration, period = runs[0].duration, runs[0].rig.period
    record = Recorder(
        round(duration / period), len(runs), period, keep=("state", "applied"), every=EVERY
    )
    with np.errstate(all="ignore"):
        outcomes = drive(rig, controller, duration, record)
    wished = controller.reference(record.time)[0].reshape(record.length, -1, 2)
    found: list[float | None] = []
    for number, (scenario, outcome) in enumerate(zip(runs, outcomes, strict=True)):
        motion = Motion.of(record, wished[:, number], number)
        way = np.hypot(*motion.error.T)
        value: float | None = None
        if outcome.ending is Ending.FINISHED and judged == "tracking":
            value = measure(motion, outcome, start=scenario.metrics.start)["tracking_error_percent"]
        elif outcome.ending is Ending.FINISHED and judged == "median":
            value = 1e3 * float(np.median(way[motion.time >= scenario.metrics.start]))
        elif outcome.ending is Ending.FINISHED and judged == "rms":
            value = 1e3 * float(np.sqrt(np.mean(way[motion.time >= scenario.metrics.start] ** 2)))
        elif outcome.ending is Ending.FINISHED:
            outside = np.flatnonzero(way > BAND)
            last = int(outside[-1]) if len(outside) else 0
            value = float(motion.time[last]) if last < len(way) - 1 else None
        found.append(value)
    return found


def cells(plan: dict[str, Any], values: list[float | None]) -> list[Cell]:
    """What every law reached."""
    rows = []
    for each in np.array(values, dtype=object).reshape(len(plan["laws"]), -1).tolist():
        first, rigs = each[: plan["noises"]], each[plan["noises"] :]
        family = [value for value in rigs if value is not None]
        missing = len(rigs) - len(family)
        lost = None in first
        rows.append(
            Cell(
                None if lost else float(np.mean(first)),
                None if missing else max(family),
                missing,
                (np.nan, np.nan) if lost else (min(first), max(first)),
                rigs,
            )
        )
    return rows


def verdict(value: float | None, goal: float, span: tuple[float, float] = (np.nan, np.nan)) -> str:
    """Whether a goal was reached, and what noise did to it."""
    scatter = "" if np.isnan(span[0]) else f" ({span[0]:.2f} to {span[1]:.2f})"
    word = "reached" if value is not None and value <= goal else "missed"
    return f"{said(value, '.2f')}{scatter}, {word}"


def page(plan: dict[str, Any], table: dict[str, list[Cell]]) -> str:
    """The page as Markdown, of the tasks that are known."""
    names = [law["name"] for law in plan["laws"]]
    edge, rows = floors(plan, table[FLOOR][-1]) if FLOOR in table else (0.0, [])
    return filled(
        "cure", plan=plan, table=table, kinds=KINDS, verdict=verdict, said=said,
        best=lambda task, side: best_of(names, [cell[side] for cell in table[task]]),
        laws=list(zip(names, zip(*table.values(), strict=True), strict=True)),
        left=[task["name"] for task in plan["tasks"] if task["name"] not in table],
        floors=rows, edge=f"{edge:.1%}", floor_task=FLOOR,
    )  # fmt: skip


def floors(plan: dict[str, Any], cell: Cell) -> tuple[float, list[tuple[Any, float, float | None]]]:
    """What an uneven screen leaves to anybody, as shares of the way's radius, and rig by rig.

    At the edge of the family; then scenario, least and what the cure reached of every rig, in %.
    """
    from cure_floor import Screen, floor  # noqa: PLC0415

    task = next(task for task in plan["tasks"] if task["name"] == FLOOR)
    radius = 0.15
    rigs = scenarios(plan | {"laws": plan["laws"][-1:]}, task)[plan["noises"] :]
    rows = [
        (scenario, least(scenario, radius, task["omega"]), value)
        for scenario, value in zip(rigs, cell.rigs, strict=True)
    ]
    edge = floor(Screen(0.27, 0.2, 58.0, 0.042), radius * task["omega"]) / radius
    return edge, rows


def least(scenario: Any, radius: float, omega: float) -> float:
    """The floor of a circle of a radius in m at a rate in rad/s on a rig, in % of the radius."""
    from cure_floor import Screen, floor  # noqa: PLC0415

    touch, plant = scenario.sensors.touch, scenario.plant
    spread = plant.surface.spread_percent / 100
    screen = Screen(plant.friction.rolling_mm, spread, touch.frame_rate, touch.dead_time)
    return 100 * floor(screen, radius * omega) / radius


def best_of(names: list[str], values: list[float | None]) -> str:
    """Who has the least, and how much it is."""
    found = [(value, name) for value, name in zip(values, names, strict=True) if value is not None]
    return "none" if not found else f"{min(found)[1]}: {min(found)[0]:.2f}"


def drawing(plan: dict[str, Any], table: dict[str, list[Cell]], path: Path) -> None:
    """The picture."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    rows = (len(table) + 3) // 4
    figure = Figure(figsize=(12, 1 + 3.3 * rows), layout="constrained")
    tasks = [task for task in plan["tasks"] if task["name"] in table]
    axes = figure.subplots(rows, 4, sharey=True, squeeze=False)
    names = [law["name"] for law in plan["laws"][::-1]]
    for axis, task in zip(axes.flat, tasks, strict=False):
        found = table[task["name"]][::-1]
        word, unit = KINDS[task.get("judged", "tracking")]
        known = [v for cell in found for v in cell[:2] if v is not None and v > 0]
        low, high = min([*known, *task["goals"]]) / 1.6, max([*known, *task["goals"]]) * 3
        for at, whose in enumerate(("nominal rig", "worst rig")):
            values = [None if cell[at] is None else max(cell[at], low) for cell in found]
            words = (whose, f"{whose}: not reached")
            points(axis, values, high / 1.3, words, full=at == 0, large=at == 1)
            line: dict[str, Any] = {"color": "0.6", "lw": 1, "ls": "-" if at == 0 else "--"}
            axis.axvline(task["goals"][at], label=f"goal of the {whose}", **line)
        # no text wider than its panel: the layout does not see to that
        axis.set(xscale="log", xlim=(low, high))
        axis.set_title(fill(task["name"], 20), fontsize=10)
        axis.set_xlabel(fill(f"{word}, {unit}", 22), fontsize=9)
        axis.grid(axis="y", color="0.9")
        axis.set_yticks(range(len(names)), names)
    for axis in axes.flat[len(tasks) :]:
        axis.set_axis_off()
    entries = axes.flat[0].get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=6, frameon=False)
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


@click.command()
@click.option("--rigs", type=click.IntRange(min=1), help="Rigs of the family.")
@click.option("--task", "only", multiple=True, help="Simulate this task alone; write no page.")
@click.option("--finished", is_flag=True, help="Simulate nothing: a page of the finished tasks.")
def main(rigs: int | None, only: tuple[str, ...], *, finished: bool) -> None:
    """Simulate what is not finished, then write the page."""
    plan = planned("cure")
    plan["rigs"] = rigs or plan["rigs"]
    table = {}
    for task in plan["tasks"]:
        if not only or task["name"] in only:
            judged = task.get("judged", "tracking")
            values = known(scenarios(plan, task), judged, simulate=not finished)
            if values is None:
                continue
            table[task["name"]] = cells(plan, values)
            click.echo(f"{task['name']}: {table[task['name']]}")
    if only:
        return
    if not table:
        raise click.ClickException("no task is finished")
    drawing(plan, table, HERE / "figures" / "cure.svg")
    write_whole(HERE / "cure.md", page(plan, table))


if __name__ == "__main__":
    main()
