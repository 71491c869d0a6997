"""From logs of any rig to the plain model of each axis, its intervals, and what it is worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from controllers.arrays import Array
from twin.errors import LogError
from twin.identify.any_log import BALLS, AnyLog, AxisLog
from twin.identify.bootstrap import Estimate
from twin.identify.judged import Identified, Predicted, beginnings, crossed, predicted, score
from twin.identify.parameters import PLAIN, IdentifiedParameter
from twin.identify.plain import SMOOTH, AxisFit, fit_axis
from twin.identify.verdict import BOUNDED, CORRELATED, IDENTIFIED, NOT, ParameterVerdict

LONGEST = 2.5
"""Length of the windows in s, as a rule."""
BRIEFER = 0.5
"""Share of it of the windows of a second fit: a model error shows as another value there."""
OPTIONAL = ("camber", "viscous")
"""Fitted where it pays, unless asked for."""
PAYS = 0.9
"""Share of the error across the halves of the log that is left with a parameter that pays."""
NO_BOUNDS = np.array([-np.inf, np.inf])
PAUSE = 10.0
"""Time in s between two logs that are fitted as one."""


@dataclass(frozen=True, kw_only=True)
class AnyIdentification(Identified):
    """What logs of any rig show.

    Attributes:
        fits: Axis to its fit.
        unit: Axis to the unit of its command: rad or count.
        factor: Share of gravity that accelerates the ball.
    """

    fits: Mapping[str, AxisFit]
    unit: Mapping[str, str]
    factor: float


def identify_any(
    logs: list[AnyLog],
    held: list[AnyLog] | float,
    names: tuple[str, ...] = (),
    factor: float = BALLS["hollow"],
    longest: float = LONGEST,
    progress: Callable[[float], None] = lambda _: None,
) -> AnyIdentification:
    """Fit the plain model to logs and try it on others, or on their last share.

    Args:
        logs: What is fitted.
        held: What is held out: other logs of the same rig, or a share of each log's time.
        names: Parameters that are fitted beside gain, dead time, lag and level; none for friction
            and what pays.
        factor: Share of gravity that accelerates the ball: 3/5 of a hollow one, 5/7 of a solid one.
        longest: Length of the windows in s.
        progress: Called with the share of the work done.

    Raises:
        LogError: If no axis can be identified: what each of them lacks.
    """
    notes = [note for log in logs for note in log.notes]
    fits: dict[str, AxisFit] = {}
    found: list[ParameterVerdict] = []
    reasons, predictions = [], {}
    axes = list(logs[0].axes)
    parts = [_parts(log, held) if isinstance(held, float) else (log.axes, {}) for log in logs]
    others = [p[1] for p in parts] if isinstance(held, float) else [log.axes for log in held]
    for k, axis in enumerate(axes):
        unit = logs[0].unit[axis]
        try:
            log = _joined([part[0][axis] for part in parts])
            _check_excited(log)
            fit, about = _chosen(log, names, longest)
            notes += [f"{axis}: {each}" for each in about]
        except LogError as error:
            reasons.append(f"{axis}: {error}")
            found += [
                ParameterVerdict(about=_about(name, unit), name=f"{name}_{axis}", why=str(error))
                for name in (*SMOOTH, "friction")
            ]
            continue
        fits[axis] = fit
        found += _verdicts(fit, axis, unit, longest)
        if fit.pushed:
            notes.append(f"{axis}: {fit.pushed:.1f} s left out: a hand, the rim or a false ball")
        if there := [other[axis] for other in others if axis in other]:
            predictions[axis] = _joined(there)
        progress((k + 1) / len(axes))
    if not fits:
        raise LogError(f"{logs[0].source}: no axis can be identified: {'; '.join(reasons)}")
    notes += [f"not identified: {each}" for each in reasons]
    tried = _predictions(predictions, fits)
    scores = [score({axis: each}) for axis, each in tried.items()]
    if len(tried) > 1:
        scores.append(score(tried))
    return AnyIdentification(
        source=logs[0].source,
        seconds=sum(float(np.ptp(part[0][axes[0]].sampled)) for part in parts),
        verdicts=tuple(found),
        scores=tuple(scores),
        predictions=tried,
        notes=tuple(notes),
        fits=fits,
        unit=logs[0].unit,
        factor=factor,
    )


def _parts(log: AnyLog, share: float) -> tuple[dict[str, AxisLog], dict[str, AxisLog]]:
    """The axes of a log before and after a share of its time from the end."""
    border = min(each.sampled[0] + (1 - share) * np.ptp(each.sampled) for each in log.axes.values())
    return (
        {axis: each.between(-np.inf, border) for axis, each in log.axes.items()},
        {axis: each.between(border, np.inf) for axis, each in log.axes.items()},
    )


def _joined(logs: list[AxisLog]) -> AxisLog:
    """Logs of an axis one after another, with a pause between."""
    start, shifted = 0.0, []
    for each in logs:
        shift = start - float(each.sampled[0] if len(each.sampled) else each.time[0])
        shifted.append((each.time + shift, each.tilt, each.sampled + shift, each.ball))
        start = float(each.time[-1]) + shift + PAUSE
    time, tilt, sampled, ball = (np.concatenate(part) for part in zip(*shifted, strict=True))
    return AxisLog(time, tilt, logs[0].held, sampled, ball)


def _check_excited(log: AxisLog) -> None:
    if float(np.ptp(log.tilt)) == 0.0:
        raise LogError("nobody moved this axis in the log; tilt it to and fro to identify it")
    if len(log.sampled) < 30 or float(np.ptp(log.ball)) < 0.005:
        way = 1000 * float(np.ptp(log.ball)) if len(log.ball) else 0.0
        raise LogError(
            f"{len(log.sampled)} ball positions within {way:.1f} mm; let it roll some centimetres"
        )


def _chosen(log: AxisLog, names: tuple[str, ...], longest: float) -> tuple[AxisFit, list[str]]:
    """The fit with the parameters that pay, and what is to be said of it."""
    notes: list[str] = []
    asked = tuple(name for name in PLAIN if name in names and name not in SMOOTH)
    chosen = (*(each for each in SMOOTH if log.held or each != "lag"), *(asked or ("friction",)))
    delays = (0.0, 0.5) if log.held else (-0.1, 0.5)
    fit = fit_axis(log, chosen, longest, delays)
    least, most = delays
    if not least + 0.01 < fit.value("dead_time") < most - 0.01 and (
        not log.held or fit.value("dead_time") > 0.25
    ):
        fit = fit_axis(log, chosen, longest, (0.0 if log.held else -0.5, 1.0))
        notes.append("dead time at a bound, which was widened to 1 s")
    if not names:
        best = crossed(fit, chosen, longest)
        for name in OPTIONAL:
            richer = (*chosen, name)
            left = crossed(fit, richer, longest)
            if left < PAYS * best:
                notes.append(
                    f"{name} fitted along: with it one half of the log predicts the other to "
                    f"{1000 * left:.1f} mm, without it to {1000 * best:.1f} mm"
                )
                chosen, best = richer, left
        if len(chosen) > len(fit.problem.names):
            fit = fit.again(fit.log, chosen, longest)
    return fit, notes


def _predictions(logs: Mapping[str, AxisLog], fits: Mapping[str, AxisFit]) -> dict[str, Predicted]:
    """Predictions of all axes from the same times on: the ball is seen in both or in neither."""
    at = beginnings(next(iter(logs.values()))) if logs else np.zeros(0)
    return {axis: predicted(log, fits[axis], at) for axis, log in logs.items() if len(at)}


def _about(name: str, unit: str) -> IdentifiedParameter:
    about = PLAIN[name]
    return replace(about, unit=f"m/s^2 by {unit}") if name == "gain" else about


def _verdicts(fit: AxisFit, axis: str, unit: str, longest: float) -> list[ParameterVerdict]:
    """Value, interval and verdict of each parameter of an axis."""
    names = fit.problem.names
    own = fit.estimate()
    low, high = own.value - own.half_width, own.value + own.half_width
    unlike = np.zeros(len(names), bool)
    try:
        other = fit.again(fit.log, names, BRIEFER * longest).estimate()
        apart = np.abs(own.value - other.value)
        unlike = apart > np.hypot(own.half_width, other.half_width)
        low = np.where(unlike, np.minimum(low, other.value - other.half_width), low)
        high = np.where(unlike, np.maximum(high, other.value + other.half_width), high)
    except LogError:
        pass
    alike = np.abs(own.correlation) > CORRELATED
    ends = np.transpose(fit.problem.bounds)
    found = []
    for k, name in enumerate(names):
        scale = 1 / fit.problem.tilt.scale if name == "gain" else 1.0
        others = [PLAIN[each].key for j, each in enumerate(names) if alike[k, j] and j != k]
        reasons = (
            ["shorter windows give another value, which the interval holds: a model error"]
            if unlike[k]
            else []
        )
        values = (own.value[k], low[k], high[k])
        found.append(
            _verdict(_about(name, unit), f"{name}_{axis}", values, ends[k], reasons, others, scale)
        )
    if "lag" in names:  # the two together are told where neither is
        pair = [names.index("dead_time"), names.index("lag")]
        both = Estimate(
            own.value[pair].sum(),
            own.draws[:, pair].sum(axis=1),
            np.asarray(own.identifiable[pair].all()),
            own.degrees_of_freedom[pair].min(),
        )
        about = replace(PLAIN["dead_time"], key="dead time + lag")
        values = (both.value, both.value - both.half_width, both.value + both.half_width)
        found.insert(3, _verdict(about, f"delay_{axis}", values, NO_BOUNDS, [], []))
    return found


def _verdict(
    about: IdentifiedParameter,
    name: str,
    values: tuple[Array, Array, Array],
    ends: Array,
    reasons: list[str],
    alike: list[str],
    scale: float = 1.0,
) -> ParameterVerdict:
    """The verdict of one parameter.

    Args:
        about: Which.
        name: With its axis.
        values: The fit and both ends of its interval.
        ends: Least and largest value of a fit.
        reasons: What has been found wrong so far.
        alike: Keys of what it cannot be told from.
        scale: From these values to those that are told.
    """
    (value, low, high), (least, most) = map(float, values), map(float, ends)
    if not math.isfinite(high - low):
        why = f"the log does not show it; {about.experiment}"
        return ParameterVerdict(about=about, name=name, why=why)
    low, high = min(low, value - about.floor), max(high, value + about.floor)
    low, high = max(low, least), min(high, most)
    half = (high - low) / 2
    found = ParameterVerdict(
        about=about, name=name, value=scale * value, low=scale * low, high=scale * high
    )
    slack = 1e-3 * (most - least)
    at_bound = value < least + slack or value > most - slack
    if value < least + slack and least == 0:
        reasons.append(f"not told from none; {about.experiment}")
    elif at_bound:
        reasons.append(f"at its bound of {value:.3g}; {about.experiment}")
    if name.startswith("gain") and low <= 0 <= high:
        reasons.append(f"not told from none: another column, exchanged axes, or {about.experiment}")
        return replace(found, word=NOT, why="; ".join(reasons))
    if half <= max(about.tolerance, about.relative * abs(value)) and not at_bound:
        return replace(found, word=IDENTIFIED, why="; ".join(reasons))
    if alike:
        reasons.append(f"told together with {' and '.join(alike)} only")
    elif not at_bound:
        reasons.append(f"its interval is wide; {about.experiment}")
    bounded = at_bound or low <= least or high >= most
    return replace(found, word=BOUNDED if bounded else NOT, why="; ".join(reasons))
