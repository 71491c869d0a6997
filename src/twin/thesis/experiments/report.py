"""The experiments as a document: every cell side by side, the goals, the hypotheses, one figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from controllers.ballplate import BallPlate
from twin.markdown import table
from twin.thesis.experiments.figure import draw
from twin.thesis.experiments.fit import FrictionFit, identified
from twin.thesis.experiments.hypotheses import HypothesisResult
from twin.thesis.experiments.judge import UNITS
from twin.thesis.experiments.predict import Prediction, goals
from twin.thesis.experiments.single_runs import STEEL_ARM, approach, loses, steel
from twin.thesis.experiments.tables import tables
from twin.writing import write_whole

FIGURE = "experiments.png"
INTRODUCTION = """\
# The thesis's experiments, predicted

Written by `ballplate reproduce 9 --doc docs/experiments.md`. Chapter 9 of the thesis measured
tracking errors of 13 to 38 % on a rig whose simulations promise less than 1 %. Here the twin runs
the same experiments: the MuJoCo mechanism with rolling friction, dead time of 42 ms, noise and
quantisation of all sensors, under the thesis's laws, Luenberger observer (8.1) and Smith predictor
at 2 ms. **One number is identified, the rolling friction, from
the three tracking errors of Table 9.3; every other cell is a prediction.** *Frictionless* is the
same twin without that friction.
"""
READING = """\
## What is compared

A rig's computer knows the late measurement and the observer's estimate of the ball, never its
true position; the tracking errors are read as reference minus estimate. Of the readings below that
a rig can make, the one that contradicts Table 9.3 least is used, chosen and fitted by
`ballplate reproduce 9 --fit`; nothing else enters the choice. The interval is Student's t with the
two degrees of freedom that three cells and one parameter leave; it holds the misfit, not what a
rig's friction does from one day to the next.
"""


def write_doc(
    path: Path,
    rows: Sequence[Prediction],
    found: Sequence[FrictionFit],
    results: Sequence[HypothesisResult],
) -> None:
    """Write the document and its figure into ``figures`` beside it.

    Raises:
        RecordError: If a file cannot be written.
    """
    draw(path.parent / "figures" / FIGURE, rows)
    parts = [
        INTRODUCTION,
        f"![Measured, predicted and frictionless tracking errors](figures/{FIGURE})\n",
        *_goals(rows),
        *_fit(found),
        *_tracking(rows),
        *_own_arms(rows),
        *_hypotheses(results),
        *_single_runs(),
        *_all_cells(rows),
    ]
    text = "\n".join(parts).rstrip() + "\n"
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))


def shown(value: float | None) -> str:
    """A number in the digits worth reading."""
    return "lost" if value is None else f"{value:.3g}"


def _goals(rows: Sequence[Prediction]) -> list[str]:
    lines = [
        (goal.sentence, goal.found, "reached" if goal.reached else "**not reached**")
        for goal in goals(rows)
    ]
    return ["## Verdict\n", table(("goal", "found", ""), lines)]


def _fit(found: Sequence[FrictionFit]) -> list[str]:
    lines = [
        (
            f"{fit.reading}, from {fit.start:g} s on",
            f"{1000 * fit.rolling:.4f}",
            f"{1000 * fit.low:.3f} to {1000 * fit.high:.3f}",
            " ".join(f"{r:+.2f}" for r in fit.residual),
            f"{fit.spread:.2f}",
        )
        for fit in found
    ]
    head = ("reading", "rolling [mm]", "95 % interval", "residuals [points]", "spread")
    used = identified()
    arm = (
        f"Used: {1000 * used.rolling:.4f} mm, a slope of {np.degrees(used.rolling / 0.02):.2f} deg."
    )
    return [READING, table(head, lines), arm + "\n"]


def _tracking(rows: Sequence[Prediction]) -> list[str]:
    lines = []
    for row in rows:
        if row["column"] != "e_tt":
            continue
        value = row["predicted"]
        lines.append(
            (
                f"{row['table']} {tables()[row['table']].title}",
                row["row"].split()[-1],
                f"{row['thesis']:.1f}",
                shown(value),
                f"{shown(row['low'])} to {shown(row['high'])}",
                "-" if value is None else f"{value - row['thesis']:+.1f}",
                shown(row["frictionless"]),
                "fitted" if row["calibration"] else "",
            )
        )
    head = ("table", "ω", "measured", "predicted", "range", "off", "frictionless", "")
    return ["## Tracking errors in %\n", table(head, lines)]


def own_arm(rows: Sequence[Prediction], name: str) -> float:
    """The rolling friction in m that a table's tracking errors alone would ask for."""
    known = identified()
    cells = [r for r in rows if r["table"] == name and r["column"] == "e_tt" and r["predicted"]]
    slope = np.array([(r["high"] - r["low"]) / (known.high - known.low) for r in cells])
    off = np.array([r["thesis"] - r["predicted"] for r in cells])
    return known.rolling + float((slope * off).sum() / (slope**2).sum())


def _own_arms(rows: Sequence[Prediction]) -> list[str]:
    names = [name for name in tables() if name != "9.1"]
    lines = [
        (f"{name} {tables()[name].title}", f"{1000 * own_arm(rows, name):.3f}") for name in names
    ]
    text = """\
## What each table alone would ask for

Were the friction free to differ from one series of experiments to the next, these values (in mm)
would fit each table best. They are not used.
"""
    return [text, table(("table", "rolling [mm]"), lines)]


def _hypotheses(results: Sequence[HypothesisResult]) -> list[str]:
    text = """\
## Hypotheses

Each effect alone beside rolling friction, which is refitted to Table 9.3 (exact model, 25 s,
without noise unless the hypothesis is the noise). *fit*: rms deviation in 9.3; *mean*, *worst*: of
the 15 predicted errors; *sliding*: mean of the six of the sliding mode; *gap*: errors without
predictor less those with (measured: +2.4); *fall*: error at 1 over that at 0.5 rad/s in Table 9.9
(measured: 0.61). Points, but for *fall*.
"""
    lines = [
        (
            result.hypothesis.name,
            result.hypothesis.why,
            f"{1000 * result.rolling:.3f}",
            *(
                _points(v)
                for v in (result.calibration, result.mean, result.worst, result.sliding, result.gap)
            ),
            f"{result.fall:.2f}",
        )
        for result in results
    ]
    head = ("hypothesis", "size", "rolling [mm]", "fit", "mean", "worst", "sliding", "gap", "fall")
    return [text, table(head, lines)]


def _points(value: float) -> str:
    return "lost" if np.isnan(value) else f"{value:.2f}"


def _single_runs() -> list[str]:
    balls = {
        "hollow": approach(BallPlate(), identified().rolling),
        "steel": approach(steel(), STEEL_ARM),
    }
    lines = [(n, f"{a.overshoot:.1f}", f"{1000 * a.error:.1f}") for n, a in balls.items()]
    return [
        "## In words only\n",
        "**Steel ball (Appendix E).** Step to 0.15 m with the same closed-loop poles; the steel "
        f"ball's rolling friction of {1000 * STEEL_ARM:g} mm is assumed (the thesis: less).\n",
        table(("ball", "overshoot [%]", "error at rest [mm]"), lines),
        *_saturated(),
    ]


def _saturated() -> list[str]:
    starts, limits = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3), (0.5, 1.0, 1.5, 3.0, 7.0)
    lines = [
        (f"{limit:g}", *("lost" if loses(start, limit) else "held" for start in starts))
        for limit in limits
    ]
    return [
        "**Backstepping with saturation (chapter 10).** The ball begins off the centre, its goal; "
        "rows: limit of the plate's acceleration in rad/s^2.\n",
        table(("limit", *(f"{start:g} m" for start in starts)), lines),
    ]


def _all_cells(rows: Sequence[Prediction]) -> list[str]:
    lines, notes = [], []
    for row in rows:
        if row["column"] == "e_tt":
            continue
        if row["note"]:
            notes.append(f"- {row['table']}, {row['row']}, {row['column']}: {row['note']}")
        lines.append(
            (
                f"{row['table']}, {row['row']}",
                f"{row['column']} [{UNITS[row['column']]}]",
                f"{row['thesis']:.4g}",
                shown(row["predicted"]),
                shown(row["frictionless"]),
            )
        )
    head = ("experiment", "quantity", "measured", "predicted", "frictionless")
    return ["## Stabilisation, angles and efforts\n", table(head, lines), *notes]
