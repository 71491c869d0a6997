"""The page on chapter 9 of the thesis, experiments.md: its goals, and what is kept of its fit.

uv run python docs/chapter9.py                    # the page and its figure
uv run python docs/chapter9.py --keep FIT.json    # adds a fit of chapter_9 to those kept, first
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from matplotlib.figure import Figure

from controllers.arrays import Array
from docs.pages import HERE, filled, said
from twin.base.jobs import cores
from twin.base.writing import write_json, write_whole
from twin.thesis import chapter9
from twin.thesis.chapter9 import Row
from twin.thesis.columns import THESIS_COLUMNS, read_stored
from twin.tune.cells import cells as numbers_of
from twin.tune.cells import read

KEPT = HERE.parent / "src" / "twin" / "thesis" / "data" / "chapter_9.json"
FIGURE = "experiments.png"
LAWS = {
    "AFL": ("9.2", "9.3"),
    "AFL with integral": ("9.4", "9.5"),
    "backstepping": ("9.6", "9.7"),
    "sliding mode": ("9.8", "9.9"),
}
PREDICTED = "#1f6fb4"
FIFTEEN, SLIDING = ("9.2", "9.4", "9.5", "9.6", "9.7"), ("9.8", "9.9")
"""Tables of the 15 predicted tracking errors without sliding mode, and those with it."""
LATE, EARLY = ("9.2", "9.4", "9.6", "9.8"), ("9.3", "9.5", "9.7", "9.9")
"""Tables without and with predictor, pair by pair."""
MECHANISM = ("plant.kind=mujoco", "plant.step=0.001")
"""What the explanation is confirmed on."""


class ChapterGoal(NamedTuple):
    """A goal, what was found, and whether it is reached."""

    sentence: str
    found: str
    reached: bool


def errors(cells: Sequence[Row], names: Sequence[str], key: str) -> Array:
    """Tracking errors of tables in %, in the order of the rows; ``thesis`` for the measured."""
    return np.array(
        [
            math.nan if row[key] is None else row[key]
            for row in cells
            if row["column"] == "e_tt" and row["table"] in names
        ]
    )


def goals(cells: Sequence[Row]) -> list[ChapterGoal]:
    """The goals of the prediction, judged on the rows of all tables."""

    def off(names: Sequence[str]) -> Array:
        return np.abs(errors(cells, names, "predicted") - errors(cells, names, "thesis"))

    e = {name: errors(cells, [name], "predicted") for name in sorted((*LATE, *EARLY))}
    means = {name: float(values.mean()) for name, values in e.items()}
    others = {name: mean for name, mean in means.items() if name not in SLIDING}
    gain = {late: means[late] - means[early] for late, early in zip(LATE, EARLY, strict=True)}
    gains = ", ".join(f"{name}: {g:+.1f}" for name, g in gain.items()) + " points without it"
    grows = [float(e[name][2] - e[name][0]) for name in ("9.2", "9.3")]
    found = [
        ("15 predicted errors: mean absolute deviation", float(off(FIFTEEN).mean()), 2.0),
        ("none of the 15 beyond", float(off(FIFTEEN).max()), 5.0),
        ("sliding mode: mean absolute deviation", float(off(SLIDING).mean()), 6.0),
    ]
    return [
        *(
            ChapterGoal(f"{what}: at most {most:g} points", f"{value:.2f}", value <= most)
            for what, value, most in found
        ),
        ChapterGoal(
            "sliding mode improves with frequency",
            ", ".join(" > ".join(f"{v:.1f}" for v in e[name]) for name in SLIDING),
            all(e[name][0] > e[name][1] > e[name][2] for name in SLIDING),
        ),
        ChapterGoal(
            "sliding mode is worst",
            ", ".join(f"{means[name]:.1f}" for name in SLIDING) + " %",
            min(means[name] for name in SLIDING) > max(others.values()),
        ),
        ChapterGoal(
            "AFL with integral action and backstepping are best",
            ", ".join(f"{name}: {mean:.1f}" for name, mean in others.items()),
            all(
                max(means[integral], means[backstepping]) < means[afl]
                for afl, integral, backstepping in (("9.2", "9.4", "9.6"), ("9.3", "9.5", "9.7"))
            ),
        ),
        ChapterGoal(
            "the predictor changes little (less than a quarter)",
            gains,
            all(abs(g) < 0.25 * means[name] for name, g in gain.items()),
        ),
        ChapterGoal("the predictor lowers the error", gains, all(g > 0 for g in gain.values())),
        ChapterGoal(
            "AFL's error does not grow with frequency",
            ", ".join(f"{g:+.1f}" for g in grows) + " points from 0.5 to 1 rad/s",
            all(g <= 0 for g in grows),
        ),
    ]


NONE = -math.inf


class HeldOut(NamedTuple):
    """A goal of the explanation: a number that must lie between two bounds.

    Attributes:
        sentence: What it is.
        value: Of cells computed with numbers that were fitted without their tables.
        low: Least that is good; minus infinity for none.
        high: Largest.
    """

    sentence: str
    value: float
    low: float
    high: float

    def verdict(self, scatter: float) -> str:
        """Whether it is reached by more than searches with other random numbers differ."""
        slack = min(self.value - self.low, self.high - self.value)
        if slack < 0:
            return "not reached"
        return "reached" if slack > scatter else "within the scatter"


def held_out_goals(cells: Sequence[Row], key: str = "held_out") -> list[HeldOut]:
    """The goals of the explanation, judged on all cells of one kind."""
    every = (*LATE, *EARLY)
    off = np.abs(errors(cells, every, key) - errors(cells, every, "thesis"))
    six = np.abs(errors(cells, SLIDING, key) - errors(cells, SLIDING, "thesis"))
    found = [
        HeldOut(
            "24 tracking errors: mean absolute deviation, points", float(off.mean()), NONE, 1.6
        ),
        HeldOut("largest of the 24, points", float(off.max()), NONE, 4.0),
        HeldOut("sliding mode: mean absolute deviation, points", float(six.mean()), NONE, 2.1),
    ]
    for name, columns, most in (
        ("plate angles", ("phi_max", "theta_max"), 1.4),
        ("efforts", ("u1_max", "u2_max"), 1.5),
    ):
        logs = _logs(cells, columns, key)
        middle = math.exp(float(np.median(logs)))
        found += [
            HeldOut(f"{name}: scatter of a cell, factor", math.exp(logs.std()), NONE, most),
            HeldOut(f"{name}: median, factor", middle, 1 / 1.1, 1.1),
        ]
    for name, tables in (("all laws", 4), ("sliding mode aside", 3)):
        gap, measured = (
            float(
                np.subtract(*(errors(cells, side[:tables], which).mean() for side in (LATE, EARLY)))
            )
            for which in (key, "thesis")
        )
        sentence = f"errors without predictor less with, {name}, points (measured {measured:+.2f})"
        found.append(HeldOut(sentence, gap, 1.5, 2.5))
    return found


def _logs(cells: Sequence[Row], columns: Sequence[str], key: str) -> Array:
    """Logarithms of computed over measured maxima of Tables 9.2 to 9.9."""
    return np.array(
        [
            math.log(row[key] / row["thesis"]) if row[key] else math.nan
            for row in cells
            if row["column"] in columns and row["table"] != "9.1"
        ]
    )


def scatter() -> dict[str, float]:
    """By how much each of ``held_out_goals`` differs between the searches, largest less least."""
    goals = [search["goals"] for search in read_stored("chapter_9")["searches"]]
    return {each: float(np.ptp([known[each] for known in goals])) for each in goals[0]}


def page(cells: list[Row], confirmed: list[Row]) -> str:
    """The page: goals, numbers, and all cells; ``confirmed`` is explained on the mechanism."""
    about = read("chapter_9")
    # with all tables, then without each
    ends = zip(*(chapter9.best(group) for group in ("", *about.groups)), strict=True)
    return filled(
        "experiments",
        figure=FIGURE,
        goals=goals(cells),
        known=read_stored("chapter_9"),
        parameters=about.parameters,
        values=dict(zip(about.parameters, ends, strict=True)),
        number=len(numbers_of(about)),
        held_out=zip(held_out_goals(cells), held_out_goals(confirmed), strict=True),
        scatter=scatter(),
        cells=cells,
        confirmed=zip(cells, confirmed, strict=True),
        columns=THESIS_COLUMNS,
        said=said,
    )


SERIES = {
    "predicted": ("o-", PREDICTED, 5, "predicted"),
    "frictionless": ("s-", "#e08214", 4, "frictionless twin"),
    "held_out": ("^-", "#4d9221", 4, "explained, held out"),
    "thesis": ("D", "#222222", 6, "measured on the rig"),
}
"""What a panel shows over its interval: marks, colour, their size, words."""


def draw(path: Path, cells: list[Row]) -> None:
    """Tracking error over frequency, one panel per law, without predictor and with."""
    figure = Figure(figsize=(11, 6), layout="constrained")
    axes = figure.subplots(2, 4, sharex=True, sharey=True)
    omega = (0.5, 0.75, 1.0)
    for (line, column), ax in np.ndenumerate(axes):
        law, pair = list(LAWS.items())[column]
        number = pair[line]
        of = partial(errors, cells, [number])
        band: dict[str, Any] = {"color": PREDICTED, "alpha": 0.2, "lw": 0}
        band["label"] = "95 % interval of the friction"
        ax.fill_between(omega, of("low"), of("high"), **band)
        for key, (marks, colour, size, words) in SERIES.items():
            ax.plot(omega, of(key), marks, color=colour, ms=size, label=words)
        ax.set_xticks(omega)
        ax.grid(alpha=0.3)
        fitted = " (fitted)" if number == "9.3" else ""
        ax.set_title(f"{law}, {number}{fitted}", fontsize=10)
    for line, side in enumerate(("without predictor", "with Smith predictor")):
        axes[line, 0].set_ylabel(f"{side}\ntracking error [%]")
    for ax in axes[1]:
        ax.set_xlabel("ω [rad/s]")
    axes[0, 0].set_ylim(0)  # of all, and after all are drawn
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    write_whole(path, lambda target: figure.savefig(target, dpi=110, metadata={"Software": None}))


def keep(found: Path) -> None:
    """Add a fit to those that the program keeps, each with the goals it comes to."""
    new, about = json.loads(found.read_text(encoding="utf-8")), read("chapter_9")
    search: dict[str, Any] = {
        "by": "CMA-ES",
        "chi2": new["chi2"],
        "parameters": {each["name"]: each["value"] for each in new["parameters"]},
        "without": {
            group: {"chi2": new["chi2_without"][group], "parameters": numbers}
            for group, numbers in new["without"].items()
        },
    }
    searches = [*(read_stored("chapter_9")["searches"] if KEPT.exists() else []), search]
    ends = [
        [chapter9.search_end(each, e.own_group)[1] for e in about.experiments] for each in searches
    ]
    wanted = [(sample, k) for end in ends for k, sample in enumerate(end)]
    values = chapter9.run_samples(about, wanted, cores(), lambda _: None)
    for search, end in zip(searches, ends, strict=True):
        cells = [
            {
                "table": each.own_group,
                "column": column,
                "thesis": each.measured[kind.metric].value,
                "held_out": values[end[k], k][kind.metric],
            }
            for k, each in enumerate(about.experiments)
            for column, kind in THESIS_COLUMNS.items()
            if kind.metric in each.measured
        ]
        search["goals"] = {goal.sentence: round(goal.value, 4) for goal in held_out_goals(cells)}
    content = {key: new[key] for key in ("parameters", "correlation")} | {"searches": searches}
    write_json(KEPT, content)
    read_stored.cache_clear()


@click.command()
@click.option("--keep", "found", type=click.Path(path_type=Path, exists=True))
def main(found: Path | None) -> None:
    """Write the page; with --keep add a fit to those that the program keeps first."""
    if found is not None:
        keep(found)
    cells = chapter9.rows(processes=cores())
    confirmed = chapter9.rows(settings=MECHANISM, processes=cores())
    draw(HERE / "figures" / FIGURE, cells)
    write_whole(HERE / "experiments.md", page(cells, confirmed))


if __name__ == "__main__":
    main()
