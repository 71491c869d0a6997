"""What is written of an identification: the HTML report with its figures, and a parameter file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from controllers.ballplate import BallPlate
from twin.identify.judged import (
    BOUNDED,
    HORIZONS,
    IDENTIFIED,
    MOVES,
    NOT,
    PREDICTORS,
    REJECTED,
    ParameterVerdict,
    Score,
    corner_frequency,
)
from twin.identify.plain_model import AnyIdentification
from twin.identify.twin_model import BestFit, Identification, Whiteness
from twin.identify.windows import LOOKBACK
from twin.page import Block, Picture, Table, Text, Verdict, digits, html
from twin.run.picture import COLOURS, drawn
from twin.writing import write_whole

SHOWN = 6
"""This many windows of the fit are drawn."""


HEADS = ("parameter", "value", "95 % interval", "unit", "verdict")


WINDOWS = ("best", "median", "worst")
"""The windows held out that are drawn, by their error after 1 s."""


BASELINES = {"stays": "a ball that stays", "goes on": "one that goes on at its velocity"}


BAD = 0.02
"""Share by which a model may be worse than a baseline before it is said."""


Found = Identification | AnyIdentification
"""What a log shows, of a rig like the twin's or of any."""


def sentences(found: Found) -> list[str]:
    """The verdict in words."""
    words = []
    for said, among in (
        ("Identified", (IDENTIFIED,)),
        ("Fitted, but the log rejects the model, so that no error is known", (REJECTED,)),
        ("Not identified from this log", (BOUNDED, NOT)),
    ):
        names = dict.fromkeys(
            each.about.name if isinstance(found, Identification) else _name(each)
            for each in found.verdicts
            if each.word in among
        )
        if names:
            words.append(f"{said}: {', '.join(names)}.")
    words += _judged(found.scores)
    if isinstance(found, AnyIdentification):
        return [*words, *_shares(found)]
    words.append(found.whiteness.words[0].upper() + found.whiteness.words[1:] + ".")
    return words


def _judged(scores: tuple[Score, ...]) -> Iterator[str]:
    """What the model is worth, in sentences."""
    ahead = HORIZONS.index(1.0)
    for each in scores:
        name = "both axes together" if len(each.axes) > 1 else each.axes
        if not each.windows:
            yield f"Of what was held out, {name}: the ball moves nowhere: nothing can be judged."
            continue
        off = {who: 1000 * each.median[who][ahead] for who in each.median}
        followed = "level followed"
        level = f"{off[followed]:.1f} mm with a level that is followed, " if followed in off else ""
        yield (
            f"On what was held out, {name}: {off['model']:.1f} mm off after 1 s (median of "
            f"{each.windows} windows in which the ball moves; 90 % within "
            f"{1000 * each.ninety['model'][ahead]:.1f} mm), {level}"
            f"{off['without friction']:.1f} mm without friction; a ball that stays "
            f"{off['stays']:.1f} mm, one that goes on {off['goes on']:.1f} mm."
        )
        worse = list(_worse(each))
        if worse:
            yield (
                f"WORSE THAN NO MODEL, {name}: {'; '.join(worse)}. Do not predict this rig by it "
                "so far ahead."
            )
    if not scores:
        yield "Nothing was held out that could judge it: no stretch of 3 s with the ball seen."


def _shares(found: AnyIdentification) -> Iterator[str]:
    """How much of what a ball does each axis does, in sentences."""
    for axis, fit in found.fits.items():
        per = fit.value("gain") / fit.problem.tilt.scale
        if found.unit[axis] == "rad":
            share = per / (found.factor * BallPlate().gravity)
            yield (
                f"{axis}: {per:.3g} m/s^2 per rad of command is {share:.2f} times what a ball does "
                f"that takes {found.factor:.3g} of gravity: only this product of the plate's tilt "
                "per command and the ball's share of gravity is told."
            )


def _worse(score: Score) -> Iterator[str]:
    models = [who for who in PREDICTORS[:2] if who in score.median]
    for k, ahead in enumerate(HORIZONS):
        best = min(BASELINES, key=lambda who: score.median[who][k])
        least = score.median[best][k]
        if min(score.median[who][k] for who in models) > (1 + BAD) * least:
            yield f"after {ahead:g} s {BASELINES[best]} is {1000 * least:.1f} mm off"


def page(found: Found) -> str:
    """The report as one HTML file."""
    verdicts = [(*row, each.why) for row, each in zip(rows(found), found.verdicts, strict=True)]
    blocks: list[Block] = [
        Verdict(sentences(found), any(each.word == IDENTIFIED for each in found.verdicts)),
        Table(
            "Parameters",
            (*HEADS, "why, and what would show it"),
            verdicts,
            words=(0, 3, 4, 5),
            note="Intervals: wild bootstrap over the windows of the fitted part. Fitted jointly "
            "with the ball's start in every window.",
        ),
    ]
    blocks += _held_out(found)
    if isinstance(found, AnyIdentification):
        log = f"{found.source}: {found.seconds:.1f} s were fitted."
    else:
        log = (
            f"{found.source}: {found.log.length:.1f} usable seconds, of which "
            f"{found.seconds:.1f} were fitted, in {len(found.fit.problem.windows)} windows; "
            f"{found.fit.termination}."
        )
        note = "Windows of the fitted part, the ball as measured (points) and replayed (lines)."
        blocks += [
            Picture("Fit", _fit_figure(found.fit), note),
            Picture(
                "What is left over", _white_figure(found.whiteness), f"{found.whiteness.words}."
            ),
        ]
    blocks.append(Text([log, *found.notes], "The log"))
    return html(f"Identification from {found.source}", blocks)


def _held_out(found: Found) -> list[Block]:
    """What was held out, as a table and in pictures."""
    if not found.scores:
        return []
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
        for who in each.median
    ]
    note = (
        f"Where the ball moves by more than {1000 * MOVES:g} mm. Every prediction begins with what "
        "0.4 s before show of place and velocity."
    )
    if isinstance(found, AnyIdentification):
        note += (
            " The level is followed only while that has predicted better in what was seen by then."
        )
    out: list[Block] = [Table("Prediction of what was held out", heads, rows, (0, 1), note=note)]
    if found.predictions:
        out.append(Picture("Best, median and worst window after 1 s", _prediction_figure(found)))
    return out


def rows(found: Found) -> list[tuple[str, str, str, str, str]]:
    """The verdicts as a table under ``HEADS``."""
    return [
        (_name(each), digits(each.value), interval(each), each.about.unit, each.word)
        for each in found.verdicts
    ]


def parameters(found: Found, words: tuple[str, ...] = (IDENTIFIED,)) -> str:
    """Parameters as TOML that a scenario may name, those with one of these verdicts."""
    known = {
        each.name: each for each in found.verdicts if each.word in words and each.value is not None
    }
    if isinstance(found, AnyIdentification):
        values = _settings(found)
    else:
        pair = [known.pop(name, None) for name in ("level_phi", "level_theta")]
        values = {
            each.about.key: f"{each.value:.6g}  # {interval(each)}, 95 %" for each in known.values()
        }
        if any(pair):
            level = ", ".join("0.0" if each is None else f"{each.value:.6g}" for each in pair)
            ends = "; ".join("unknown" if each is None else interval(each) for each in pair)
            values["plant.level_deg"] = f"[{level}]  # {ends}, 95 %"
    tables: dict[str, list[str]] = {}
    for key, value in values.items():
        table, _, name = key.rpartition(".")
        tables.setdefault(table, []).append(f"{name} = {value}")
    lines = [
        f"# Identified from {found.source} by `ballplate identify`; a scenario takes it by",
        '# parameters = "this file", a run by --set parameters=FILE.',
    ]
    for table in sorted(tables):
        lines += ["", f"[{table}]", *tables[table]]
    return "\n".join(lines) + "\n"


def write(found: Found, folder: Path) -> None:
    """Write report.html and, if anything was identified, parameters.toml.

    Raises:
        RecordError: If a file cannot be written.
    """
    write_whole(folder / "report.html", page(found))
    if any(each.word == IDENTIFIED for each in found.verdicts):
        write_whole(folder / "parameters.toml", parameters(found))


def interval(each: ParameterVerdict) -> str:
    """Its interval in words."""
    if each.low is None and each.high is None:
        return "-"
    if each.high is None:
        return f"above {digits(each.low)}"
    return f"{digits(each.low)} to {digits(each.high)}"


def _name(each: ParameterVerdict) -> str:
    axis = each.name.rpartition("_")[2]
    axis = f" ({axis})" if axis in ("phi", "theta", "x", "y") else ""
    return each.about.key + axis


def _prediction_figure(found: Found) -> Figure:
    axes = found.predictions
    with drawn(12, 3 * len(axes)) as figure:
        panels = figure.subplots(len(axes), len(WINDOWS), squeeze=False)
        for row, (axis, each) in zip(panels, axes.items(), strict=True):
            errors = np.abs(each.errors("model", 1.0))
            errors[each.way <= MOVES] = np.nan
            order = np.argsort(errors)[: int(np.isfinite(errors).sum())]
            for panel, word, at in zip(row, WINDOWS, (0, 0.5, 1), strict=True):
                if not len(order):
                    continue
                w = order[round(at * (len(order) - 1))]
                seen = np.isfinite(each.ball[w])
                ahead = each.ahead[w, seen]
                panel.plot(ahead, 1000 * each.ball[w, seen], ".", color="0.4", ms=4)
                models = [who for who in PREDICTORS[:3] if who in each.by]
                for colour, who in zip(COLOURS, models, strict=False):
                    panel.plot(ahead, 1000 * each.by[who][w, seen], color=colour, label=who)
                panel.axvline(0, color="0.5", lw=1, ls=":")
                off = 1000 * errors[w]
                panel.set_title(f"{axis}, {word}: {off:.1f} mm, at {each.begin[w]:.1f} s")
        panels[0, 0].legend(fontsize=8)
        figure.supxlabel("seconds ahead")
        figure.supylabel("position [mm]")
    return figure


def _fit_figure(fit: BestFit) -> Figure:
    """Some windows of the fit, evenly chosen."""
    windows = fit.problem.windows
    replayed = fit.problem.reported(fit.theta[None], fit.starts)[0][0]
    chosen = np.unique(np.linspace(0, len(windows) - 1, SHOWN).round().astype(int))
    with drawn(12, 5) as figure:
        panels = figure.subplots(2, 3).ravel()
        for panel, which in zip(panels, chosen, strict=False):
            there = windows.weight[which, :, 0] > 0
            time = windows.begin[which] + windows.time[which, there]
            for axis, name in enumerate("xy"):
                ball = 1000 * windows.ball[which, there, axis]
                panel.plot(time, ball - ball[0], ".", color=COLOURS[axis], ms=3, alpha=0.6)
                way = 1000 * replayed[which, there, axis] - ball[0]
                panel.plot(time, way, color=COLOURS[axis], lw=1.2, label=name)
            rest = "begun at rest" if windows.resting[which] else "begun in roll"
            panel.set_title(f"{time[0] - LOOKBACK:.1f} s, {rest}", fontsize=9)
        for panel in panels[len(chosen) :]:
            panel.set_axis_off()
        panels[0].legend(fontsize=8)
        figure.supxlabel("time [s]", fontsize=10)
        figure.supylabel("position [mm]", fontsize=10)
    return figure


def _white_figure(whiteness: Whiteness) -> Figure:
    """Autocorrelation of the residuals with its band."""
    with drawn(12, 2.6) as figure:
        panel = figure.subplots()
        lags = 1 + np.arange(len(whiteness.correlation))
        panel.bar(lags, whiteness.correlation, width=0.5, color=COLOURS[0])
        panel.axhspan(-whiteness.band, whiteness.band, color="0.85", zorder=0)
        panel.set(
            xlabel="lag [samples of 16 ms]",
            ylabel="correlation",
            title="Autocorrelation of the residuals; 95 % of white ones within the band",
        )
    return figure


def _settings(found: AnyIdentification) -> dict[str, str]:
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
