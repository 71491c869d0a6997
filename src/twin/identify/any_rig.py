"""From logs of any rig to the plain model of each axis, its intervals, and what it is worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.base.errors import LogError
from twin.identify import judged
from twin.identify.drives import PROFILED_EFFECTS
from twin.identify.logs import MAX_COMMAND_GAP_S, AnyLog, AxisLog
from twin.identify.parameters import PLAIN_PARAMETERS, IdentifiedParameter
from twin.identify.plain_model import (
    ACCEPTED_ERROR_SHARE,
    HEIGHT_STD_M,
    SMOOTH_PARAMETERS,
    AxisFit,
    axis_predicted,
    beginnings,
    cross_validate,
    fit_axis,
    predicting,
    profile_drives,
    with_drives,
)
from twin.identify.search import Estimate

WINDOW_LENGTH_S = 2.5
"""Length of the windows in s, as a rule."""
SHORTER_WINDOW_SHARES = (0.5, 0.32)
"""Shares of it of the windows of other fits: a model error shows as another value there."""
OPTIONAL_PARAMETERS = ("camber", "viscous")
"""Fitted where it pays, unless asked for."""
DRIVEN_PAY = 0.8
"""Share of an error that is left with dead band, play or slew that pay: a hand is like them."""
DRIVEN_WITHIN = 0.01
"""Error in m with them above which something else is at work: a hand, or a ball that sticks."""
AXIS_SIGNS = (("x", 1.0), ("y", -1.0))
"""The axes, and how a level along them is a tilt of the base."""
MOST_TURNED = 0.2
"""How much too far or too little a command may tilt the twin's plate."""
CONDITIONAL_SCATTER_SHARE = 0.5
"""Share of the scatter of a parameter from which on it is told with what is not fitted only."""
LEVER_HELD_MESSAGE = (
    "held: the height that was told and 2/3 of a hollow, 2/5 of a solid ball's radius"
)
"""What is said of a lever that is known."""
PAUSE_BETWEEN_LOGS_S = 10.0
"""Time in s between two logs that are fitted as one."""
EARLIER_COMMANDS_S = 0.5
"""How long commands from before a log or a pause may move the ball, s: so much is left out."""


@dataclass(frozen=True, kw_only=True)
class PlainIdentification(judged.Identification):
    """What logs of any rig show.

    Attributes:
        factor: Share of gravity that accelerates the ball.
        ball: That of the rig, in whose radius friction is told.
    """

    factor: float
    ball: BallPlate

    def settings(self, words: Collection[str]) -> dict[str, str]:
        """Scenario keys to values in TOML with remarks, of those with one of some verdicts.

        Friction, dead time and lag are the mean of the axes; a scenario has one of each. Dead time
        and lag of which only the sum has it are told as well: these two together are known.
        """
        known: dict[str, dict[str, float]] = {}
        told = {each.name: each.word in words for each in self.verdicts}
        for each in self.verdicts:
            name, _, axis = each.name.rpartition("_")
            summed = name in {"dead_time", "lag"} and told.get(f"delay_{axis}")
            if (told[each.name] or summed) and each.value is not None:
                known.setdefault(name, {})[axis] = each.value
        mean = {name: float(np.mean(list(values.values()))) for name, values in known.items()}
        ball = self.ball
        push = self.factor * ball.gravity
        inertia = ball.mass * ball.radius**2 * (1 / self.factor - 1)
        lines = {f"plant.ball.{name}": str(getattr(ball, name)) for name in ("mass", "radius")}
        lines |= self.over
        given = [each.value or 0.0 for each in self.verdicts if each.word == judged.GIVEN_VERDICT]
        height = float(np.mean(given)) - ball.radius / self.factor if given else -1.0
        if height >= 0:  # laws take no surface below the axes
            lines["plant.plate.height"] = f"{height:.6g}  # of the surface, as it was told"
        lines["plant.ball.inertia"] = f"{inertia:.6g}  # takes {self.factor:.3g} of gravity"
        gain = known.get("gain", {})
        turned = [gain.get(axis, sign * push) * sign / push for axis, sign in AXIS_SIGNS]
        if gain and not any(map(_another, turned)):
            errors = ", ".join(f"{100 * (each - 1):.6g}" for each in turned)
            lines["rig.cam_error_percent"] = f"[{errors}]  # how much too far a command tilts"
        if "friction" in mean:
            rolling = 1000 * mean["friction"] * ball.radius / push
            lines["plant.friction.rolling_mm"] = f"{rolling:.6g}  # for this ball's radius"
        if mean.get("dead_time", 0.0) > 0:
            dead_time = f"{mean['dead_time']:.6g}"
            lines["sensors.touch.dead_time"] = f"{dead_time}  # all of it, commands' too"
            lines["predictor.delay"] = dead_time
        if "lag" in mean:
            alone = any(told.get(f"lag_{axis}") for axis in "xy")
            remark = "" if alone else "  # its sum with the dead time is known, neither by itself"
            lines["rig.plate_lag"] = f"{mean['lag']:.6g}{remark}"
            lines["plant.servo.bandwidth_hz"] = f"{judged.corner_frequency(mean['lag']):.6g}"
        if camber := known.get("camber"):
            lines["plant.camber"] = "[{:.6g}, {:.6g}]".format(*(camber.get(e, 0.0) for e in "xy"))
        if level := known.get("level"):
            tilts = [math.degrees(sign * level.get(axis, 0.0) / push) for axis, sign in AXIS_SIGNS]
            lines["plant.level_deg"] = f"[{tilts[0]:.6g}, {tilts[1]:.6g}]"
        return lines


def identify_any(
    logs: list[AnyLog],
    held: list[AnyLog] | float,
    names: tuple[str, ...] = (),
    factor: float | None = None,
    progress: Callable[[float], None] = lambda _: None,
    ball: BallPlate | None = None,
    on: str | Path | None = None,
    heights: tuple[float, float] | None = None,
) -> PlainIdentification:
    """Fit the plain model to logs and try it on others, or on their last share.

    Args:
        logs: What is fitted.
        held: What is held out: other logs of the same rig, or a share of each log's time.
        names: Parameters that are fitted beside gain, dead time, lag and level; none for friction
            and what pays.
        factor: Share of gravity that accelerates the ball: 3/5 of a hollow one, 5/7 of a solid one;
            None for that of the ball.
        progress: Called with the share of the work done.
        ball: That of the rig; None for the thesis's.
        on: The rig, or file of parameters, that the parameters are to lie over.
        heights: Of the ball's centre above the plate's axis along x and y, m; None if unknown.

    Raises:
        LogError: If no axis can be identified: what each of them lacks.
    """
    ball = ball or BallPlate()
    factor = factor or ball.c1
    if heights and "lever" in names:
        raise LogError("ball_height: it tells the lever; leave that out of the parameters")
    more = ball.radius * (1 / factor - 1)  # J / (m r): c4 of (5.1) is the height and this
    levers = {axis: height + more for axis, height in zip("xy", heights or (), strict=False)}
    notes = [note for log in logs for note in log.notes]
    fits: dict[str, AxisFit] = {}
    found: list[judged.ParameterVerdict] = []
    reasons = []
    first = logs[0]
    parts = [_parts(log, held) if isinstance(held, float) else (log.axes, {}) for log in logs]
    known = [part[0] for part in parts]
    others = [part[1] for part in parts] if isinstance(held, float) else [e.axes for e in held]
    for k, (axis, unit) in enumerate(first.unit.items()):
        try:
            log = _join_logs([part[axis] for part in known], levers.get(axis))
            _check_excited(log)
            fit, about = _chosen(log, names, WINDOW_LENGTH_S)
            notes += [f"{axis}: {each}" for each in about]
        except LogError as error:
            reasons.append(f"{axis}: {error}")
            lost = [
                (_about(name, unit), f"{name}_{axis}") for name in (*SMOOTH_PARAMETERS, "friction")
            ]
            found += [judged.ParameterVerdict(about=a, name=n, why=str(error)) for a, n in lost]
            continue
        fits[axis] = fit
        found += _verdicts(fit, axis, unit)
        if fit.pushed:
            notes.append(f"{axis}: {fit.pushed:.1f} s left out: a hand, the rim or a false ball")
        progress((k + 1) / len(first.unit))
    if not fits:
        raise LogError(f"{first.source}: no axis can be identified: {'; '.join(reasons)}")
    notes += [f"not identified: {each}" for each in reasons]
    there = {axis: [other[axis] for other in others if axis in other] for axis in fits}
    unseen = {axis: _join_logs(own, levers.get(axis)) for axis, own in there.items() if own}
    # all axes from the same times on: the ball is seen along both or neither
    at = beginnings(next(iter(unseen.values()))) if unseen else np.zeros(0)
    tried = {axis: axis_predicted(log, fits[axis], at) for axis, log in unseen.items() if len(at)}
    scores = [judged.score({axis: each}) for axis, each in tried.items()]
    if len(tried) > 1:
        scores.append(judged.score(tried))
    seconds = sum(float(np.ptp(next(iter(part.values())).sampled)) for part in known)
    gains = {each.name.rpartition("_")[2]: each for each in found if each.name.startswith("gain_")}
    told = (_share(axis, gains[axis], factor) for axis in fits if first.unit[axis] == "rad")
    return PlainIdentification(
        source=first.source,
        seconds=seconds,
        extent=f"{first.source}: {seconds:.1f} s were fitted.",
        remarks=tuple(told),
        verdicts=tuple(found),
        scores=tuple(scores),
        predictions=tried,
        notes=tuple(notes),
        factor=factor,
        ball=ball,
        on=str(on or ""),
    )


def _share(axis: str, gain: judged.ParameterVerdict, factor: float) -> str:
    """How much of what a ball does an axis does, in a sentence.

    No factor is advised from a gain that is not identified.

    Args:
        axis: x or y.
        gain: Verdict of its gain, m/s^2 per rad.
        factor: Share of gravity that accelerates the ball.
    """
    sign, push = dict(AXIS_SIGNS)[axis], factor * BallPlate().gravity
    if gain.word != judged.IDENTIFIED_VERDICT or gain.value is None:
        known = "" if gain.low is None else f" (95 %: {gain.interval} m/s^2 per rad)"
        return (
            f"{axis}: how far a command tilts the plate is not known from this log{known}, so no "
            "factor on the command is advised and no rig of its own follows from it."
        )
    share = gain.value / push
    turned = sign * share
    told = (
        f"{axis}: {gain.value:.3g} m/s^2 per rad of command ({gain.interval}) is {share:.2f} times "
        f"what a ball does that takes {factor:.3g} of gravity: only this product of the plate's "
        "tilt per command and the ball's share of gravity is told, and commands are taken as "
        "angles of the plate, whatever linkage a rig has."
    )
    if not _another(turned):
        return told
    assert gain.low is not None
    assert gain.high is not None
    least, most = sorted(sign * end / push for end in (gain.low, gain.high))
    return (
        f"{told} For compare, shadow and whatif tell the command times {turned:.3g} ({least:.3g} "
        f"to {most:.3g}; a - before its name turns the sign, a factor stands before its unit)."
    )


def _another(turned: float) -> bool:
    """Whether a tilt per command is beyond what `rig.cam_error_percent` takes."""
    return abs(turned - 1) > MOST_TURNED


def _parts(log: AnyLog, share: float) -> tuple[dict[str, AxisLog], dict[str, AxisLog]]:
    """The axes of a log before and after a share of its time from the end."""
    border = min(each.sampled[0] + (1 - share) * np.ptp(each.sampled) for each in log.axes.values())
    return (
        {axis: each.between(-np.inf, border) for axis, each in log.axes.items()},
        {axis: each.between(border, np.inf) for axis, each in log.axes.items()},
    )


def _join_logs(logs: list[AxisLog], lever: float | None = None) -> AxisLog:
    """Logs of an axis one after another, with a pause between, and its lever in m if known."""
    start, shifted = 0.0, []
    for log in logs:
        pauses = np.flatnonzero(np.diff(log.time, prepend=-np.inf) > MAX_COMMAND_GAP_S)
        each = log.without(log.time[pauses], EARLIER_COMMANDS_S)
        shift = start - float(each.sampled[0] if len(each.sampled) else each.time[0])
        across = each.across + np.array([[shift], [0.0]])
        shifted.append((each.time + shift, each.tilt, each.sampled + shift, each.ball, across))
        start = float(each.time[-1]) + shift + PAUSE_BETWEEN_LOGS_S
    parts = zip(*shifted, strict=True)
    time, tilt, sampled, ball, across = (np.concatenate(part, axis=-1) for part in parts)
    return AxisLog(time, tilt, logs[0].held, sampled, ball, across, lever=lever)


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
    asked = tuple(
        name for name in PLAIN_PARAMETERS if name in names and name not in SMOOTH_PARAMETERS
    )
    chosen = (
        *(each for each in SMOOTH_PARAMETERS if log.held or each != "lag"),
        *(asked or ("friction",)),
    )
    delays = (0.0, 0.5) if log.held else (-0.1, 0.5)
    ways = (log, replace(log, across=0 * log.across)) if log.across[1].any() else (log,)
    fits = [fit_axis(each, chosen, longest, delays) for each in ways]
    # of all windows, not the usual one, in which the ball may rest; 10 um are as good as none
    squares = [f.sigma**2 * f.problem.misfit(f.found.linearisation.r) for f in fits]
    at = int(np.argmin([np.log(1e-10 + each).mean() for each in squares]))
    log, fit = ways[at], fits[at]
    if log.across[1].any():
        notes.append("friction acts against the way of the ball along both axes")
    dead_time, lag = fit.value("dead_time"), fit.value("lag")
    least, most = delays
    # an ideal drive beside a camera whose clock is behind: where dead time and lag end at none
    behind = dead_time < least + 0.01 and lag < 0.02
    if behind or dead_time > most - 0.01:
        fit = fit_axis(log, chosen, longest, (-0.5 if behind or not log.held else 0.0, 1.0))
        notes.append(
            "dead time at a bound, which was widened: it holds what the clocks of camera and "
            "command differ by, and is negative where that is more"
        )
    if not names:
        fit = _richer(_driven(fit, longest, notes), longest, notes)
    fit = profile_drives(fit)
    try:
        brief = tuple(
            fit.again(fit.log, fit.problem.names, part * longest) for part in SHORTER_WINDOW_SHARES
        )
    except LogError:
        return fit, notes
    fit = predicting(replace(fit, briefer=brief), longest)
    if fit.problem.drift and not names:
        known, fit = fit, _richer(fit, longest, notes)
        names = fit.problem.names
        one = known.windowed and known.windowed.again(known.log, names, longest)
        brief = tuple(fit.again(known.log, names, part * longest) for part in SHORTER_WINDOW_SHARES)
        fit = replace(fit, windowed=one, briefer=brief)
    if fit.windowed:
        drifts = fit.problem.drift > 0
        why = "the level drifts: follow it" if drifts else "dead band, play or another force"
        notes.append(f"the model is in error ({why}); its values are those that predict best")
    return fit, notes


def _driven(fit: AxisFit, longest: float, notes: list[str]) -> AxisFit:
    """The fit with what shows of its drives, beside anything else that may act, where it pays."""
    own = fit.problem.names
    rich = fit.again(fit.log, tuple(dict.fromkeys((*own, *OPTIONAL_PARAMETERS))), longest)
    found = with_drives(rich, longest)
    new = tuple(name for name in PROFILED_EFFECTS if name in found.problem.names)
    if not new:
        return fit
    left, least = (cross_validate(each, each.problem.names, longest) for each in (found, rich))
    what = " and ".join(PLAIN_PARAMETERS[name].key for name in new)
    pays = left < DRIVEN_WITHIN and _pays(left, DRIVEN_PAY, least, what, notes)
    return found.again(fit.log, (*own, *new), longest) if pays else fit


def _richer(fit: AxisFit, longest: float, notes: list[str]) -> AxisFit:
    """The fit with the parameters that pay beside its own, which are said."""
    own = chosen = fit.problem.names
    best, share = (
        cross_validate(fit, chosen, longest),
        1.0 if fit.problem.drift else ACCEPTED_ERROR_SHARE,
    )
    for name in OPTIONAL_PARAMETERS:
        if name not in chosen:
            left = cross_validate(fit, (*chosen, name), longest)
            if _pays(left, share, best, name, notes):
                chosen, best = (*chosen, name), left
    return fit.again(fit.log, chosen, longest) if chosen != own else fit


def _pays(left: float, share: float, of: float, what: str, notes: list[str]) -> bool:
    """Whether what is left of an error with something is less than a share of it; it is said."""
    if pays := left < share * of:
        notes.append(
            f"{what} fitted along: with it one half of the log predicts the other to "
            f"{1000 * left:.1f} mm, without it to {1000 * of:.1f} mm"
        )
    return pays


def _about(name: str, unit: str) -> IdentifiedParameter:
    if name == "delay":
        return replace(PLAIN_PARAMETERS["dead_time"], key="dead time + lag")
    about = PLAIN_PARAMETERS[name]
    return replace(about, unit=f"m/s^2 by {unit}") if name == "gain" else about


def _verdicts(fit: AxisFit, axis: str, unit: str) -> list[judged.ParameterVerdict]:
    """Value, interval and verdict of each parameter of an axis."""
    names = fit.problem.names
    rows = (*names, *(("delay",) if "lag" in names else ()))
    own = _told_together(fit)
    low, high = own.value - own.half_width, own.value + own.half_width
    unlike = np.zeros(len(rows), bool)
    reasons: list[list[str]] = [[] for _ in rows]
    beside = [(each, f"windows of {each.problem.longest:.1f} s") for each in fit.briefer]
    if fit.windowed:
        beside.insert(0, (fit.windowed, "windows of one level"))
    for other, why in beside:
        another = _told_together(other)
        apart = np.abs(own.value - another.value)
        unlike = apart > np.hypot(own.half_width, another.half_width)
        low = np.where(unlike, np.minimum(low, another.value - another.half_width), low)
        high = np.where(unlike, np.maximum(high, another.value + another.half_width), high)
        word = f"{why} give another value, which the interval holds: a model error"
        reasons = [each + [word] * bool(at) for each, at in zip(reasons, unlike, strict=True)]
    alike = np.abs(own.correlation) > judged.MAX_CORRELATION
    drawn = own.draws - own.value
    hidden = {each.name: each.moved[each.name] for each in fit.profiles if each.name not in names}
    shares = {  # of the scatter of each that is of what is not fitted
        name: (moved @ drawn) ** 2 / np.maximum((moved @ moved) * (drawn**2).sum(axis=0), 1e-300)
        for name, moved in hidden.items()
    }
    ends = [*np.transpose(fit.problem.bounds), (-np.inf, np.inf)]
    swing = fit.problem.tilt.scale
    scales = {"gain": 1 / swing, "dead_band": swing, "play": swing}
    found: list[judged.ParameterVerdict] = []
    for k, name in enumerate(rows):
        others = [
            PLAIN_PARAMETERS[each].key for j, each in enumerate(names) if alike[k, j] and j != k
        ]
        others += [
            PLAIN_PARAMETERS[each].key
            for each, share in shares.items()
            if share[k] > CONDITIONAL_SCATTER_SHARE
        ]
        values = (own.value[k], low[k], high[k])
        told = values, ends[k], reasons[k], others * (name != "delay"), scales.get(name, 1.0)
        verdict = _verdict(_about(name, unit), f"{name}_{axis}", *told)
        verdict = _as_slew(verdict, swing) if name == "slew" else verdict
        found.insert(3 if name == "delay" else k, verdict)
    for name, moved in hidden.items():  # how much of it there may be
        least, most = np.quantile(
            moved, (1 - judged.BOUND_PROBABILITY, judged.BOUND_PROBABILITY)
        ).tolist()
        by, about = scales.get(name, 1.0), PLAIN_PARAMETERS[name]
        none = judged.ParameterVerdict.unknown(about, f"{name}_{axis}", "not told from none")
        none = replace(none, low=by * min(least, 0.0), high=by * (most or abs(about.tried[1])))
        found.append(_as_slew(none, swing) if name == "slew" else none)
    if (lever := fit.log.lever) is not None:
        given = replace(found.pop(), value=lever, word=judged.GIVEN_VERDICT, why=LEVER_HELD_MESSAGE)
        found.append(replace(given, low=lever - 2 * HEIGHT_STD_M, high=lever + 2 * HEIGHT_STD_M))
    return found


def _as_slew(found: judged.ParameterVerdict, swing: float) -> judged.ParameterVerdict:
    """A verdict of seconds by swing, as it is fitted, as one of a rate."""
    low, value, high = (
        swing / end if end else None for end in (found.high, found.value, found.low)
    )
    return replace(found, low=low, value=value, high=high)


def _told_together(fit: AxisFit) -> Estimate:
    """The parameters and, last, dead time and lag together, told where neither of them is."""
    own = fit.estimate()
    if "lag" not in fit.problem.names:
        return own
    pair = [fit.problem.names.index(name) for name in ("dead_time", "lag")]
    return Estimate(
        np.append(own.value, own.value[pair].sum()),
        np.column_stack((own.draws, own.draws[:, pair].sum(axis=1))),
        np.append(own.identifiable, own.identifiable[pair].all()),
        np.append(own.degrees_of_freedom, own.degrees_of_freedom[pair].min()),
        np.append(own.noise, 0.0),
    )


def _verdict(
    about: IdentifiedParameter,
    name: str,
    values: tuple[Array, Array, Array],
    ends: Array | tuple[float, float],
    reasons: list[str],
    alike: list[str],
    scale: float = 1.0,
) -> judged.ParameterVerdict:
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
        return judged.ParameterVerdict.unknown(about, name, "the log does not show it")
    low = max(min(low, value - about.floor), least)
    high = min(max(high, value + about.floor), most)
    slack = 1e-3 * (most - least)
    at_bound = value < least + slack or value > most - slack
    narrow = (high - low) / 2 <= max(about.tolerance, about.relative * abs(value)) and not at_bound
    nothing = name.startswith("gain") and low <= 0 <= high
    if value < least + slack and least == 0:
        reasons.append(f"not told from none; {about.experiment}")
    elif at_bound:
        reasons.append(f"at its bound of {value:.3g}; {about.experiment}")
    if nothing:
        reasons.append(f"not told from none: another column, exchanged axes, or {about.experiment}")
    elif alike and not narrow:
        reasons.append(f"told together with {' and '.join(alike)} only")
    elif not at_bound and not narrow:
        reasons.append(f"its interval is wide; {about.experiment}")
    bounded = at_bound or low <= least or high >= most
    word = (
        judged.IDENTIFIED_VERDICT
        if narrow
        else judged.BOUNDED_VERDICT
        if bounded
        else judged.NOT_IDENTIFIABLE
    )
    return judged.ParameterVerdict(
        about=about,
        name=name,
        value=scale * value,
        low=scale * low,
        high=scale * high,
        word=judged.NOT_IDENTIFIABLE if nothing else word,
        why="; ".join(reasons),
    )
