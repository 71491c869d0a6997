"""Makes cure.md and its picture: who wins against friction, dead time and noise, and by how much.

uv run python docs/cure.py                  # what cure.toml says
Finished tasks are kept in runs/cure and used again while scenarios and code stay the same.
"""

from __future__ import annotations

import inspect
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import click
import numpy as np
from matplotlib.figure import Figure

from docs.cure_floor import Screen, floor, least
from docs.pages import HERE, driven, filled, kept, planned, points, said, write
from twin.base.page import percent
from twin.run.assemble import assemble
from twin.run.metrics import Motion, tracking_error
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder, code, digest

EVERY = 5
BAND = 0.005
FLOOR, RADIUS = "circle 0.75 rad/s", 0.15
"""Task for which the cure is compared with the least that is possible, and its radius in m."""
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
    build = Builder(plan["scenario"])
    rigs = draw_rigs(read_family(plan["family"]), plan["draw"], plan["rigs"])
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
    functions: tuple[Any, ...] = (simulated, driven, judge)
    how = " ".join(map(inspect.getsource, functions))
    runs_as_text = (each.model_dump_json() for each in runs)
    return digest(" ".join((code(), judged, how, f"{BAND} {EVERY}", *runs_as_text)))


def known(runs: list[Any], judged: str = "tracking") -> list[float | None]:
    """What is judged of scenarios that run as one batch, on the true ball: as kept or simulated."""
    return kept("cure", key(runs, judged), lambda: simulated(runs, judged))


def simulated(runs: list[Any], judged: str) -> list[float | None]:
    """The same, by one batch; None for a ball that was lost or never settled."""
    rig, controller = assemble(runs, threads=1)
    channels = ("state", "applied")
    made = driven(rig, controller, runs[0].duration, channels=channels, every=EVERY)
    record, desired, finished = made
    motions = [Motion.of(record, desired[:, number], number) for number in range(len(runs))]
    rows = zip(runs, motions, finished, strict=True)
    return [judge(each, run.metrics.start, judged) if good else None for run, each, good in rows]


def judge(motion: Motion, start: float, judged: str) -> float | None:
    """What is judged of a run that finished: one of ``KINDS``, from a time in s on."""
    steady = motion.time >= start - 1e-9
    if judged == "tracking":
        return tracking_error(motion.error[steady], motion.reference[steady])
    way = np.hypot(*motion.error.T)
    if judged == "settled":
        outside = np.flatnonzero(way > BAND)
        last = int(outside[-1]) if len(outside) else 0
        return float(motion.time[last]) if last < len(way) - 1 else None
    late = way[motion.time >= start]
    return 1e3 * float(np.median(late) if judged == "median" else np.sqrt(np.mean(late**2)))


def cells(plan: dict[str, Any], values: list[float | None]) -> list[Cell]:
    """What every law reached."""
    rows = []
    for each in np.array(values, dtype=object).reshape(len(plan["laws"]), -1).tolist():
        first, rigs = each[: plan["noises"]], each[plan["noises"] :]
        missing, lost = rigs.count(None), None in first
        rows.append(
            Cell(
                None if lost else float(np.mean(first)),
                None if missing else max(rigs),
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
    """The page as Markdown."""
    names = [law["name"] for law in plan["laws"]]
    edge, rows = floors(plan, table[FLOOR][-1])
    return filled(
        "cure", plan=plan, table=table, kinds=KINDS, verdict=verdict, said=said,
        best=lambda task, side: best_of(names, [cell[:2][side] for cell in table[task]]),
        laws=list(zip(names, zip(*table.values(), strict=True), strict=True)),
        floors=rows, edge=percent(edge), floor_task=FLOOR,
    )  # fmt: skip


def floors(plan: dict[str, Any], cell: Cell) -> tuple[float, list[tuple[Any, float, float | None]]]:
    """What an uneven screen leaves to anybody, as shares of the way's radius, and rig by rig.

    At the edge of the family; then scenario, least and what the cure reached of every rig, in %.
    """
    task = next(task for task in plan["tasks"] if task["name"] == FLOOR)
    rigs = scenarios(plan | {"laws": plan["laws"][-1:]}, task)[plan["noises"] :]
    lowest = [least(scenario, RADIUS, task["omega"]) for scenario in rigs]
    edge = floor(Screen(0.27, 0.2, 58.0, 0.042), RADIUS * task["omega"]) / RADIUS
    return edge, list(zip(rigs, lowest, cell.rigs, strict=True))


def best_of(names: list[str], values: list[float | None]) -> str:
    """Who has the least, and how much it is."""
    found = [(value, name) for value, name in zip(values, names, strict=True) if value is not None]
    return "none" if not found else f"{min(found)[1]}: {min(found)[0]:.2f}"


def drawing(plan: dict[str, Any], table: dict[str, list[Cell]], path: Path) -> None:
    """The picture."""
    rows = (len(table) + 3) // 4
    figure = Figure(figsize=(12, 1 + 3.3 * rows), layout="constrained")
    axes = figure.subplots(rows, 4, sharey=True, squeeze=False)
    names = [law["name"] for law in plan["laws"][::-1]]
    for axis, task in zip(axes.flat, plan["tasks"], strict=False):
        found = table[task["name"]][::-1]
        word, unit = KINDS[task.get("judged", "tracking")]
        reached = [v for cell in found for v in cell[:2] if v is not None and v > 0]
        low, high = min([*reached, *task["goals"]]) / 1.6, max([*reached, *task["goals"]]) * 3
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
    for axis in axes.flat[len(table) :]:
        axis.set_axis_off()
    entries = axes.flat[0].get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=6, frameon=False)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan, table = planned("cure"), {}
    for task in plan["tasks"]:
        values = known(scenarios(plan, task), task.get("judged", "tracking"))
        table[task["name"]] = cells(plan, values)
        click.echo(f"{task['name']}: {table[task['name']]}")
    drawing(plan, table, HERE / "figures" / "cure.svg")
    write(HERE / "cure.md", page(plan, table))


if __name__ == "__main__":
    main()
