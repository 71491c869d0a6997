"""What is written of an identification of any rig: sentences, page, and a parameter file."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from controllers.ballplate import BallPlate
from twin.identify.any_rig import AnyIdentification
from twin.identify.judged import HORIZONS, MOVES, PREDICTORS, Score
from twin.identify.verdict import IDENTIFIED, corner_frequency
from twin.page import Block, Picture, Table, digits
from twin.run.picture import COLOURS, drawn

SHOWN = ("best", "median", "worst")
"""The windows that are drawn, by their error after 1 s."""
BASELINES = {"stays": "a ball that stays", "goes on": "one that goes on at its velocity"}
BAD = 0.02
"""Share by which a model may be worse than a baseline before it is said."""


def judged(found: AnyIdentification) -> Iterator[str]:
    """What the model is worth, in sentences."""
    ahead = HORIZONS.index(1.0)
    for each in found.scores:
        name = "both axes together" if len(each.axes) > 1 else each.axes
        if not each.windows:
            yield f"Of what was held out, {name}: the ball moves nowhere: nothing can be judged."
            continue
        off = {who: 1000 * each.median[who][ahead] for who in PREDICTORS}
        yield (
            f"On what was held out, {name}: {off['model']:.1f} mm off after 1 s (median of "
            f"{each.windows} windows in which the ball moves; 90 % within "
            f"{1000 * each.ninety['model'][ahead]:.1f} mm), {off['level followed']:.1f} mm with a "
            f"level that is followed, {off['without friction']:.1f} mm without friction; a ball "
            f"that stays {off['stays']:.1f} mm, one that goes on {off['goes on']:.1f} mm."
        )
        worse = list(_worse(each))
        if worse:
            yield (
                f"WORSE THAN NO MODEL, {name}: {'; '.join(worse)}. Do not predict this rig by it "
                "so far ahead."
            )
    if not found.scores:
        yield "Nothing was held out that could judge it: no stretch of 3 s with the ball seen."
    for axis, fit in found.fits.items():
        per = fit.value("gain") / fit.problem.tilt.scale
        if found.log.unit[axis] == "rad":
            share = per / (found.factor * BallPlate().gravity)
            yield (
                f"{axis}: {per:.3g} m/s^2 per rad of command is {share:.2f} times what a ball does "
                f"that takes {found.factor:.3g} of gravity: only this product of the plate's tilt "
                "per command and the ball's share of gravity is told."
            )


def _worse(score: Score) -> Iterator[str]:
    for k, ahead in enumerate(HORIZONS):
        best = min(BASELINES, key=lambda who: score.median[who][k])
        least = score.median[best][k]
        if min(score.median["model"][k], score.median["level followed"][k]) > (1 + BAD) * least:
            yield f"after {ahead:g} s {BASELINES[best]} is {1000 * least:.1f} mm off"


def blocks(found: AnyIdentification) -> list[Block]:
    """What was held out, as a table and in pictures."""
    heads = ["axes", "by"]
    for ahead in HORIZONS:
        heads += [f"{ahead:g} s, median [mm]", f"{ahead:g} s, 90 % [mm]"]
    rows = [
        (
            " and ".join(each.axes),
            who,
            *(
                digits(1000 * table[who][k]) if math.isfinite(table[who][k]) else "-"
                for k in range(len(HORIZONS))
                for table in (each.median, each.ninety)
            ),
        )
        for each in found.scores
        for who in PREDICTORS
    ]
    note = (
        f"Where the ball moves by more than {1000 * MOVES:g} mm. Every prediction begins with what "
        "0.4 s before show of place and velocity. The level is followed only while that has "
        "predicted better in what was seen by then."
    )
    out: list[Block] = [Table("Prediction of what was held out", heads, rows, (0, 1), note=note)]
    if found.predictions:
        out.append(Picture("Best, median and worst window after 1 s", _figure(found)))
    return out


def _figure(found: AnyIdentification) -> Figure:
    axes = found.predictions
    with drawn(12, 3 * len(axes)) as figure:
        panels = figure.subplots(len(axes), len(SHOWN), squeeze=False)
        for row, (axis, each) in zip(panels, axes.items(), strict=True):
            errors = np.abs(each.errors("model", 1.0))
            errors[each.way <= MOVES] = np.nan
            order = np.argsort(errors)[: int(np.isfinite(errors).sum())]
            for panel, word, at in zip(row, SHOWN, (0, 0.5, 1), strict=True):
                if not len(order):
                    continue
                w = order[round(at * (len(order) - 1))]
                seen = np.isfinite(each.ball[w])
                ahead = each.ahead[w, seen]
                panel.plot(ahead, 1000 * each.ball[w, seen], ".", color="0.4", ms=4)
                for colour, who in zip(COLOURS, PREDICTORS[:3], strict=False):
                    panel.plot(ahead, 1000 * each.by[who][w, seen], color=colour, label=who)
                panel.axvline(0, color="0.5", lw=1, ls=":")
                off = 1000 * errors[w]
                panel.set_title(f"{axis}, {word}: {off:.1f} mm, at {each.begin[w]:.1f} s")
        panels[0, 0].legend(fontsize=8)
        figure.supxlabel("seconds ahead")
        figure.supylabel("position [mm]")
    return figure


def settings(found: AnyIdentification) -> dict[str, str]:
    """Scenario keys and the numbers that stand for what was identified, with a remark each.

    Friction, dead time and lag are the mean of the axes; a scenario has one of each.
    """
    known: dict[str, dict[str, float]] = {}
    for each in found.verdicts:
        if each.word == IDENTIFIED and each.value is not None:
            name, _, axis = each.name.rpartition("_")
            known.setdefault(name, {})[axis] = each.value
    ball = BallPlate()
    push = found.factor * ball.gravity
    inertia = ball.mass * ball.radius**2 * (1 / found.factor - 1)
    lines = {"plant.ball.inertia": f"{inertia:.6g}  # takes {found.factor:.3g} of gravity"}

    def mean(name: str) -> float:
        return float(np.mean(list(known[name].values())))

    if "friction" in known:
        rolling = 1000 * mean("friction") * ball.radius / push
        lines["plant.friction.rolling_mm"] = f"{rolling:.6g}  # for a ball of 20 mm radius"
    if "dead_time" in known and mean("dead_time") > 0:
        lines["sensors.touch.dead_time"] = f"{mean('dead_time'):.6g}  # all of it, commands' too"
    if "lag" in known:
        lines["plant.servo.bandwidth_hz"] = f"{corner_frequency(mean('lag')):.6g}"
    if level := known.get("level"):
        pair = [math.degrees(level.get("x", 0.0) / push), -math.degrees(level.get("y", 0.0) / push)]
        lines["plant.level_deg"] = f"[{pair[0]:.6g}, {pair[1]:.6g}]"
    return lines
