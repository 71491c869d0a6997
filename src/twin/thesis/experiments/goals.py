"""Which of the goals the predictions reach: each a sentence, a number and a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twin.thesis.experiments.hypotheses import FIFTEEN, SLIDING
from twin.thesis.experiments.predict import Row

PAIRS = (("9.2", "9.3"), ("9.4", "9.5"), ("9.6", "9.7"), ("9.8", "9.9"))
"""Tables without and with predictor."""


class Goal(NamedTuple):
    """A goal, what was found, and whether it is reached."""

    sentence: str
    found: str
    reached: bool


def goals(rows: Sequence[Row]) -> list[Goal]:
    """All goals, judged on the rows of Tables 9.2 to 9.9."""
    errors = {
        name: np.array([_value(r) for r in rows if r["table"] == name and r["column"] == "e_tt"])
        for name in sorted({r["table"] for r in rows} - {"9.1"})
    }
    return [*_numbers(rows), *_orderings(errors)]


def deviations(rows: Sequence[Row], tables: Sequence[str]) -> np.ndarray:
    """Predicted minus measured tracking errors of tables, in points."""
    return np.array(
        [_value(r) - r["thesis"] for r in rows if r["table"] in tables and r["column"] == "e_tt"]
    )


def _value(row: Row) -> float:
    return float("nan") if row["predicted"] is None else float(row["predicted"])


def _numbers(rows: Sequence[Row]) -> list[Goal]:
    fifteen, six = np.abs(deviations(rows, FIFTEEN)), np.abs(deviations(rows, SLIDING))
    return [
        Goal(
            "15 predicted errors: mean absolute deviation at most 2.0 points",
            f"{fifteen.mean():.2f}",
            bool(fifteen.mean() <= 2.0),
        ),
        Goal("none of the 15 beyond 5 points", f"{fifteen.max():.2f}", bool(fifteen.max() <= 5)),
        Goal(
            "sliding mode: mean absolute deviation at most 6 points",
            f"{six.mean():.2f}",
            bool(six.mean() <= 6),
        ),
    ]


def _orderings(e: dict[str, np.ndarray]) -> list[Goal]:
    means = {name: values.mean() for name, values in e.items()}
    falls = [values[0] > values[1] > values[2] for name, values in e.items() if name in SLIDING]
    worst = all(means[s] > max(means[n] for n in e if n not in SLIDING) for s in SLIDING)
    best = all(
        max(means[integral], means[backstepping]) < means[afl]
        for afl, integral, backstepping in (("9.2", "9.4", "9.6"), ("9.3", "9.5", "9.7"))
    )
    gain = {late: means[late] - means[early] for late, early in PAIRS}
    grows = [float(e[name][2] - e[name][0]) for name in ("9.2", "9.3")]
    little = all(abs(g) < 0.25 * means[name] for name, g in gain.items())
    return [
        Goal(
            "sliding mode improves with frequency",
            ", ".join(" > ".join(f"{v:.1f}" for v in e[name]) for name in SLIDING),
            all(falls),
        ),
        Goal(
            "sliding mode is worst",
            ", ".join(f"{means[name]:.1f}" for name in SLIDING) + " %",
            bool(worst),
        ),
        Goal(
            "AFL with integral action and backstepping are best",
            ", ".join(f"{name}: {means[name]:.1f}" for name in e if name not in SLIDING),
            bool(best),
        ),
        Goal(
            "the predictor changes little (less than a quarter)",
            ", ".join(f"{name}: {g:+.1f}" for name, g in gain.items()) + " points without it",
            bool(little),
        ),
        Goal(
            "the predictor lowers the error",
            ", ".join(f"{name}: {g:+.1f}" for name, g in gain.items()) + " points without it",
            all(g > 0 for g in gain.values()),
        ),
        Goal(
            "AFL's error does not grow with frequency",
            ", ".join(f"{g:+.1f}" for g in grows) + " points from 0.5 to 1 rad/s",
            all(g <= 0 for g in grows),
        ),
    ]
