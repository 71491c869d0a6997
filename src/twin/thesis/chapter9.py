"""Tables 9.1 to 9.9, measured on the rig: predicted from one number, explained by four, held out.

What was measured is the shipped table ``chapter_9`` of ``ballplate fit``; every column is judged
alike, as the rig's computer sees its runs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from controllers.analysis import number
from controllers.arrays import Array
from twin.errors import ScenarioError
from twin.fit.runs import Runs, Sample
from twin.fit.schema import FitTable, read
from twin.run.finished import run
from twin.study.experiments import Store

COLUMNS = {
    "e_ss": ("steady_error", "m"),
    "overshoot": ("overshoot_percent", "%"),
    "t_ss": ("settling_time", "s"),
    "e_tt": ("tracking_error_percent", "%"),
    "phi_max": ("phi_max_deg", "deg"),
    "u1_max": ("u1_max", "rad/s^2"),
    "theta_max": ("theta_max_deg", "deg"),
    "u2_max": ("u2_max", "rad/s^2"),
}
"""Columns of the tables: indicator and unit."""
SETTLING = 3.0
READ = (
    "Read by eye by the thesis; here the time from which x stays within 5 % of the step of where "
    "it comes to rest."
)
"""Settling time of Table 9.1 in s, and how it is read."""
ROLLING, LOW, HIGH = 0.17649, 0.16693, 0.18605
"""Rolling friction in mm from the three tracking errors of Table 9.3, as
``ballplate fit friction_of_table_9_3`` finds it, and its 95 % interval by Student's t. The
scenarios ``thesis/9_*`` have it."""
CALIBRATION = "9.3"
"""The table whose three tracking errors the prediction knows."""
FIFTEEN, SLIDING = ("9.2", "9.4", "9.5", "9.6", "9.7"), ("9.8", "9.9")
"""Tables of the 15 predicted tracking errors without sliding mode, and those with it."""
LATE, EARLY = ("9.2", "9.4", "9.6", "9.8"), ("9.3", "9.5", "9.7", "9.9")
"""Tables without and with predictor, pair by pair."""
MECHANISM = ("plant.kind=mujoco", "plant.step=0.001")
"""What the explanation is confirmed on."""

Row = dict[str, Any]
"""A cell: table, row, column, thesis; predicted, frictionless, low, high by one number, low and
high with the ends of its interval; explained, held_out by the four numbers fitted to all tables and
to all but its own; calibration, note. None where the ball was lost."""


def tables() -> tuple[str, ...]:
    """The numbers of the tables."""
    return read("chapter_9").groups


@cache
def stored() -> dict[str, Any]:
    """What ``ballplate fit chapter_9`` found.

    Parameters, correlation, and of every search its end with all tables and without each, and the
    goals that this comes to.
    """
    text = files("twin.thesis").joinpath("data", "chapter_9.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def best(group: str = "") -> Sample:
    """The four numbers without a table, by default with all, of the search that ended lowest."""
    return min((ended(search, group) for search in stored()["searches"]), key=lambda end: end[0])[1]


def ended(search: Mapping[str, Any], group: str) -> tuple[float, Sample]:
    """Chi-squared and numbers at the end of a search without a table, or with all."""
    end = search["without"][group] if group else search
    numbers = end["parameters"]
    return float(end["chi2"]), tuple(float(numbers[name]) for name in read("chapter_9").parameters)


def chosen(ids: Iterable[str]) -> FitTable:
    """The experiments of the tables of these numbers, all for none.

    Raises:
        ScenarioError: If there is no such table.
    """
    about, wanted = read("chapter_9"), list(ids)
    for name in wanted:
        if name not in about.groups:
            raise ScenarioError(
                f"no table '{name}' of experiments; there are {', '.join(about.groups)}"
            )
    some = tuple(each for each in about.experiments if not wanted or each.group in wanted)
    return about.model_copy(update={"experiments": some})


def predicting(about: FitTable) -> FitTable:
    """The same experiments with the numbers that the prediction knows: friction alone."""
    known = read("friction_of_table_9_3")
    # a seed of its own each, and nothing that was found out later
    experiments = tuple(each.model_copy(update={"set": each.set[:1]}) for each in about.experiments)
    return known.model_copy(update={"experiments": experiments})


def rows(
    ids: Iterable[str] = (),
    advance: Callable[[float], None] = lambda _: None,
    *,
    settings: Sequence[str] = (),
    processes: int = 1,
) -> list[Row]:
    """One dictionary per cell, in the thesis's order; see ``Row``.

    Args:
        ids: Numbers of tables; none for all.
        advance: Called with the share done, 0 to 1.
        settings: Further settings of the explanation, which is on the exact equations.
        processes: On how many processors.

    Raises:
        ScenarioError: If there is no such table, or a setting is wrong.
    """
    about = chosen(ids)
    explaining = about.model_copy(update={"set": (*about.set, *settings)})
    arms = [(arm,) for arm in (ROLLING, 0.0, LOW, HIGH)]
    places = range(len(about.experiments))
    first = carried(
        predicting(about),
        [(arm, k) for k in places for arm in arms],
        processes,
        lambda share: advance(0.7 * share),
    )
    second = carried(
        explaining,
        [(one, k) for k in places for one in (best(), best(about.experiments[k].own_group))],
        processes,
        lambda share: advance(0.7 + 0.3 * share),
    )
    found = []
    for k, each in enumerate(about.experiments):
        fitted = (best(), best(each.own_group))
        for column, (indicator, _) in COLUMNS.items():
            if column == "t_ss" and each.own_group == "9.1":
                settled = [_settled(predicting(about), arm, k) for arm in arms]
                found.append(_row(each.label, column, SETTLING, settled, (None, None), READ))
            elif indicator in each.measured:
                cell = each.measured[indicator]
                values = [number(first[arm, k][indicator]) for arm in arms]
                explained = [number(second[one, k][indicator]) for one in fitted]
                found.append(_row(each.label, column, cell.value, values, explained, cell.note))
    return found


def carried(
    about: FitTable,
    wanted: Sequence[tuple[Sample, int]],
    processes: int,
    advance: Callable[[float], None],
) -> Mapping[tuple[Sample, int], Mapping[str, float]]:
    """The indicators of runs that are kept nowhere."""
    runs = Runs(
        about,
        Store(None),
        processes=processes,
        progress=lambda done, _: advance(done / len(wanted)),
    )
    return runs.indicators(wanted)


def _row(
    label: str,
    column: str,
    thesis: float,
    values: Sequence[float | None],
    explained: Sequence[float | None],
    note: str,
) -> Row:
    table, _, name = label.partition(", ")
    predicted, frictionless, *ends = values
    known = [value for value in (*ends, predicted) if value is not None]
    return {
        "table": table,
        "row": name,
        "column": column,
        "thesis": thesis,
        "predicted": predicted,
        "frictionless": frictionless,
        "explained": explained[0],
        "held_out": explained[1],
        "calibration": table == CALIBRATION and column == "e_tt",
        "low": min(known, default=None),
        "high": max(known, default=None),
        "note": note,
    }


def _settled(about: FitTable, arm: Sample, place: int) -> float:
    """When the ball of Table 9.1 comes within 5 % of the step of its place at rest for good, s."""
    scenario = Runs(about, Store(None)).scenario(arm, about.experiments[place])
    rows = run(scenario.model_copy(update={"baseline": False})).rows
    time, x = rows["time"], rows["estimated_x"]
    end = x[time > time[-1] - 1].mean()
    outside = np.flatnonzero(np.abs(x - end) > 0.05 * 0.15)
    return float(time[outside[-1]]) if len(outside) else 0.0


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

    e = {name: errors(cells, [name], "predicted") for name in (*LATE, *EARLY)}
    e = dict(sorted(e.items()))
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
        found.append(
            HeldOut(f"{name}: scatter of a cell, factor", math.exp(logs.std()), NONE, most)
        )
        middle = math.exp(float(np.median(logs)))
        found.append(HeldOut(f"{name}: median, factor", middle, 1 / 1.1, 1.1))
    for name, late, early in (
        ("all laws", LATE, EARLY),
        ("sliding mode aside", LATE[:-1], EARLY[:-1]),
    ):
        gap, measured = (
            float(errors(cells, late, which).mean() - errors(cells, early, which).mean())
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
    known: dict[str, list[float]] = {}
    for search in stored()["searches"]:
        for sentence, value in search["goals"].items():
            known.setdefault(sentence, []).append(value)
    return {sentence: max(values) - min(values) for sentence, values in known.items()}
