"""Fits the plain model of each axis to logs of any rig, with intervals and held-out errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate, corner_frequency
from twin.base.errors import LogError
from twin.base.page import digits
from twin.identify.axis_fitting import AXIS_FITTING, AxisFitting
from twin.identify.axis_logs import MAX_COMMAND_GAP_S, AnyLog, AxisLog
from twin.identify.axis_prediction import cross_validate, prediction_times, refit_for_prediction
from twin.identify.command_model import DRIVE_EFFECTS, PROFILED_EFFECTS, TiltHistory
from twin.identify.corrections import find_correction
from twin.identify.drive_effects import add_drive_effects, profile_drives
from twin.identify.end_stops import describe_stops, find_end_stops
from twin.identify.fallback import assess_plainly
from twin.identify.first_look import FirstLook, look_first
from twin.identify.further_terms import find_hidden_changes, find_significance, find_term
from twin.identify.least_squares import Estimate
from twin.identify.offsets import take_out_offsets, tell_level_at_zero
from twin.identify.parameters import PLAIN_PARAMETERS, IdentifiedParameter, plain_parameter
from twin.identify.plain_model import SMOOTH_PARAMETERS, AxisFit, fit_axis
from twin.identify.predictor import (
    AxisPredictor,
    choose_lead,
    choose_predictor,
    describe_five_numbers,
    fit_five_numbers,
)
from twin.identify.suspicions import AXIS_SIGNS, describe_suspicions
from twin.identify.verdicts import (
    BOUNDED_VERDICT,
    GIVEN_VERDICT,
    IDENTIFIED_VERDICT,
    MAX_CORRELATION,
    NOT_IDENTIFIABLE,
    Identification,
    ParameterVerdict,
    Predicted,
    score,
)
from twin.identify.windows import spans, usual_free_time

LEVER_HELD_MESSAGE = "held: the given height and 2/3 of a hollow, 2/5 of a solid ball's radius"
"""Message for a lever that is computed from the given height."""


@dataclass(frozen=True, kw_only=True)
class AxisSelection:
    """Constants of the choice of windows and model of a fit of an axis.

    Attributes:
        window_s: Length of the windows.
        min_windows: Smallest number of windows of this length; with fewer they are shorter.
        least_window_s: Smallest length of the windows where they are shortened: between end stops,
            or where too few windows of ``window_s`` are without a gap.
        shorter_window_shares: Lengths of the windows of further fits, as shares of it: a model
            error shows as a different value there.
        optional_parameters: Fitted if they reduce the prediction error, unless requested.
        accepted_error_share: A parameter is accepted if it reduces the error of cross-validation to
            this share.
        max_compared_s: Longest part of a log by which models are compared.
        min_term_stds: Standard deviations of a parameter from zero below which it is not tried.
        accepted_drive_error_share: The same for dead band, play or slew: a hand resembles them.
        max_drive_error_m: Accept dead band, play or slew only below this error: a touched plate, or
            a ball that sticks, resembles them.
        conditional_scatter_share: Share of the scatter of a parameter above which it is known only
            together with a parameter that is not fitted.
        bound_probability: Share of the bootstrap draws that a bound contains.
        pause_between_logs_s: Pause put between two logs that are fitted as one.
        earlier_commands_s: Time for which commands before a log or a pause may move the ball: its
            samples are left out.
        fitting: Constants of the fits.
    """

    window_s: float = 2.5
    min_windows: int = 3
    least_window_s: float = 0.3
    shorter_window_shares: tuple[float, ...] = (0.5, 0.32)
    optional_parameters: tuple[str, ...] = ("camber", "viscous")
    accepted_error_share: float = 0.9
    max_compared_s: float = 75.0
    min_term_stds: float = 3.0
    accepted_drive_error_share: float = 0.8
    max_drive_error_m: float = 0.01
    conditional_scatter_share: float = 0.5
    bound_probability: float = 0.95
    pause_between_logs_s: float = 10.0
    earlier_commands_s: float = 0.5
    fitting: AxisFitting = AXIS_FITTING


AXIS_SELECTION = AxisSelection()
DOUBTED_WHERE_NOT_WHITE = {
    "gain": "steps of a servo, or a ball that sticks, resemble another gain",
    "friction": "a friction that builds up over a way, or sticks, is another",
}
"""Parameters that an error of the model moves in all windows alike, and what may do so."""
RESEMBLED = ("gain", "friction", "viscous")
"""Parameters that a filter of the positions, or a friction that sticks, changes most."""
AKAIKE_PENALTY = 2.0
"""What a term has to reduce twice the negative log-likelihood by, in Akaike's criterion."""
DELAYS_S = {True: (0.0, 0.5), False: (-0.1, 0.5)}
"""Smallest and largest dead time of commands, and of angles that are measured."""
PROCESSOR_S, PROCESSOR_S_PER_S = 5.0, 0.04
"""Processor time of the fit of an axis in s, and the same for each second of its log."""
SLOWEST_RATIO = 3
"""Factor on it for a log that the model does not explain."""
MAX_SCALE_ERROR = 0.2
"""Largest error of the tilt per command that `rig.cam_error_percent` takes, as a share."""


@dataclass(frozen=True, kw_only=True)
class AxisIdentification(Identification):
    """Parameters and predictions that logs of any rig give.

    Attributes:
        factor: Share of gravity that accelerates the ball.
        ball: The ball of the rig; its radius scales the friction.
        height: Of the plate's surface above its axes, m, where it is taken from the levers that the
            log shows; None for that of the rig, or the one that was given.
    """

    factor: float
    ball: BallPlate
    height: float | None = None

    def settings(self, words: Collection[str]) -> dict[str, str]:
        """Scenario keys and their values in TOML, of the parameters with one of these verdicts.

        Friction, dead time and lag are the mean of the axes; a scenario has one of each. Dead time
        and lag are included as well where only their sum has such a verdict.
        """
        known: dict[str, dict[str, float]] = {}
        accepted = {each.name: each.word in words for each in self.verdicts}
        for each in self.verdicts:
            name, _, axis = each.name.rpartition("_")
            summed = name in {"dead_time", "lag"} and accepted.get(f"delay_{axis}")
            if (accepted[each.name] or summed) and each.value is not None:
                known.setdefault(name, {})[axis] = each.value
        mean = {name: float(np.mean(list(values.values()))) for name, values in known.items()}
        ball = self.ball
        push = self.factor * ball.gravity
        inertia = ball.mass * ball.radius**2 * (1 / self.factor - 1)
        lines = {f"plant.ball.{name}": str(getattr(ball, name)) for name in ("mass", "radius")}
        lines |= self.over
        given = [each.value or 0.0 for each in self.verdicts if each.word == GIVEN_VERDICT]
        height, how = self.height, "as the log shows it"
        if given:
            height, how = float(np.mean(given)) - ball.radius / self.factor, "as given"
        if height is not None and height >= 0:  # laws take no surface below the axes
            lines["plant.plate.height"] = f"{height:.6g}  # of the surface, {how}"
        lines["plant.ball.inertia"] = f"{inertia:.6g}  # takes {self.factor:.3g} of gravity"
        gain = known.get("gain", {})
        turned = [gain.get(axis, sign * push) * sign / push for axis, sign in AXIS_SIGNS.items()]
        if gain and not any(map(_is_other_scale, turned)):
            errors = ", ".join(f"{100 * (each - 1):z.6g}" for each in turned)
            lines["rig.cam_error_percent"] = f"[{errors}]  # how much too far a command tilts"
        if "friction" in mean:
            rolling = 1000 * mean["friction"] * ball.radius / push
            lines["plant.friction.rolling_mm"] = f"{rolling:.6g}  # for this ball's radius"
        if mean.get("dead_time", 0.0) > 0:
            dead_time = f"{mean['dead_time']:.6g}"
            lines["sensors.touch.dead_time"] = f"{dead_time}  # all of it, commands' too"
            lines["predictor.delay"] = dead_time
        if "lag" in mean:
            alone = any(accepted.get(f"lag_{axis}") for axis in "xy")
            remark = (
                "of the drives or of a filter of the positions"
                if alone
                else "its sum with the dead time is known, neither by itself"
            )
            lines["rig.plate_lag"] = f"{mean['lag']:.6g}  # {remark}"
            lines["plant.servo.bandwidth_hz"] = f"{corner_frequency(mean['lag']):.6g}"
        if camber := known.get("camber"):
            bends = ", ".join(f"{camber.get(axis, 0.0):z.6g}" for axis in "xy")
            lines["plant.camber"] = f"[{bends}]"
        if level := known.get("level"):
            tilts = [
                math.degrees(sign * level.get(axis, 0.0) / push)
                for axis, sign in AXIS_SIGNS.items()
            ]
            lines["plant.level_deg"] = f"[{tilts[0]:z.6g}, {tilts[1]:z.6g}]"
        return lines


def identify_axes(
    logs: list[AnyLog],
    held: list[AnyLog] | float,
    names: tuple[str, ...] = (),
    factor: float | None = None,
    progress: Callable[[float, str], None] = lambda *_: None,
    ball: BallPlate | None = None,
    on: str | Path | None = None,
    heights: tuple[float, float] | None = None,
    selection: AxisSelection = AXIS_SELECTION,
    say: Callable[[str], object] = lambda _: None,
) -> AxisIdentification:
    """Fit the plain model to logs and predict others, or their last share.

    Args:
        logs: What is fitted.
        held: What is held out: other logs of the same rig, or a share of each log's time.
        names: Parameters that are fitted in addition to gain, dead time, lag and level; none for
            friction and each drive effect that reduces the error enough.
        factor: Share of gravity that accelerates the ball: 3/5 of a hollow one, 5/7 of a solid one;
            None for the share of ``ball``.
        progress: Called with the share of the work done and the name of the next step.
        ball: The ball of the rig; None for the thesis's ball.
        on: The rig, or file of parameters, that the parameters are to lie over.
        heights: Of the ball's centre above the plate's axis along x and y, m; None if unknown.
        selection: Constants of the fit.
        say: Called with lines on the work: what is fitted, how long that takes, and a first look.

    Raises:
        LogError: If no axis can be identified: what each of them lacks.
    """
    ball = ball or BallPlate()
    factor = factor or ball.c1
    if heights and "lever" in names:
        raise LogError("ball_height: it determines the lever; remove lever from the parameters")
    more = ball.radius * (1 / factor - 1)  # J / (m r): c4 of (5.1) is the height and this
    levers = {axis: height + more for axis, height in zip("xy", heights or (), strict=False)}
    notes = [note for log in logs for note in log.notes]
    logs, held, offsets = take_out_offsets(logs, held)
    first = logs[0]

    def part_and_join() -> tuple[list[dict[str, AxisLog]], dict[str, AxisLog]]:
        parts = [
            split_axes(log, held)[0] if isinstance(held, float) else dict(log.axes) for log in logs
        ]
        return parts, {
            axis: join_logs([part[axis] for part in parts], levers.get(axis), selection)
            for axis in first.unit
        }

    known, joined = part_and_join()
    say(_describe_work(joined, first.source))
    looks = {axis: look_first(log) for axis, log in joined.items()}
    for axis, look in looks.items():
        if look:
            say(look.describe(axis, first.unit[axis]))
    warned = list(describe_suspicions(joined, first.unit, looks, factor))
    for suspicion in warned:
        say(f"warning: {suspicion}")
    joined = _find_stops(joined, looks)
    usual = _fit_usual_parameters(joined, looks, selection, progress)
    correction = find_correction(usual, first.unit)
    if correction.notes:
        usual = {}
        warned += correction.notes
        for note in correction.notes:
            say(f"warning: {note}")
        logs = [correction.apply(log) for log in logs]
        held = held if isinstance(held, float) else [correction.apply(log) for log in held]
        known, joined = part_and_join()
        looks = {axis: look_first(log) for axis, log in joined.items()}
        joined = _find_stops(joined, looks)
    notes += warned
    for axis, log in joined.items():
        notes += describe_stops(axis, log)
    others = (
        [split_axes(log, held)[1] for log in logs]
        if isinstance(held, float)
        else [log.axes for log in held]
    )
    fits, found, reasons, remarks_on_fits = _fit_axes(
        joined, first.unit, looks, usual, names, selection, progress
    )
    found, about_offsets = tell_level_at_zero(found, offsets, first.unit)
    notes += remarks_on_fits + about_offsets
    if not fits and not any(each.value is not None for each in found):
        raise LogError(f"{first.source}: no axis can be identified: {'; '.join(reasons)}")
    notes += [f"not identified: {each}" for each in reasons]
    tried = _predict_held_out(fits, others, levers, selection)
    scores = [score({axis: each}) for axis, each in tried.items()]
    if len(tried) > 1:
        scores.append(score(tried))
    seconds = sum(float(np.ptp(next(iter(part.values())).sampled)) for part in known)
    gains = {each.name.rpartition("_")[2]: each for each in found if each.name.startswith("gain_")}
    remarks = [
        _describe_gain(axis, gains[axis], factor, held=first.axes[axis].held)
        for axis in fits
        if first.unit[axis] == "rad"
    ]
    notes += describe_lags([each for each in found if first.axes[each.name[-1]].held])
    progress(1.0, "")
    return AxisIdentification(
        source=first.source,
        seconds=seconds,
        extent=f"{first.source}: {seconds:.1f} s were fitted.",
        remarks=tuple(remarks),
        verdicts=tuple(found),
        scores=tuple(scores),
        predictions=tried,
        notes=tuple(notes),
        factor=factor,
        ball=ball,
        on=str(on or ""),
        how=selection.fitting.hold_out,
        warned=tuple(warned),
    )


def _find_stops(
    logs: Mapping[str, AxisLog], looks: Mapping[str, FirstLook | None]
) -> dict[str, AxisLog]:
    """The logs of the axes with their end stops, by first looks at them."""
    found = {}
    for axis, log in logs.items():
        look = looks[axis]
        found[axis] = replace(log, stops=find_end_stops(log, look)) if look else log
    return found


def _fit_usual_parameters(
    logs: Mapping[str, AxisLog],
    looks: Mapping[str, FirstLook | None],
    selection: AxisSelection,
    progress: Callable[[float, str], None],
) -> dict[str, AxisFit]:
    """Fits of the usual parameters, which show corrections; without an axis that cannot be fitted.

    Args:
        logs: The joined logs by axis, x or y.
        looks: First looks at them.
        selection: Constants of the fit.
        progress: Called with the share of the work done and the name of the next step.
    """
    fits = {}
    for axis, log in logs.items():
        progress(0.0, f"{axis}: clock, other axis and a gain that bends")
        with suppress(LogError):
            _check_excited(log)
            each, names = _fit_between_stops(log, selection), _choose_parameters(log)
            delays = DELAYS_S[log.held]
            fits[axis] = fit_axis(log, names, each.window_s, delays, each.fitting, looks[axis])
    return fits


def _choose_parameters(log: AxisLog, others: tuple[str, ...] = ("friction",)) -> tuple[str, ...]:
    """The parameters of a first fit: the smooth ones that the log may show, and others."""
    return (*(each for each in SMOOTH_PARAMETERS if log.held or each != "lag"), *others)


def _fit_axes(
    logs: Mapping[str, AxisLog],
    units: Mapping[str, str],
    looks: Mapping[str, FirstLook | None],
    usual: Mapping[str, AxisFit],
    names: tuple[str, ...],
    selection: AxisSelection,
    progress: Callable[[float, str], None],
) -> tuple[dict[str, AxisPredictor], list[ParameterVerdict], list[str], list[str]]:
    """Fit the plain model to each axis by itself.

    Args:
        logs: The joined logs by axis, x or y.
        units: Unit of the command by axis.
        looks: First looks at them.
        usual: Fits of their usual parameters, as far as there are any.
        names: Parameters that are fitted in addition to the smooth ones.
        selection: Constants of the fit.
        progress: Called with the share of the work done and the name of the next step.

    Returns:
        What predicts best by axis, without an axis that cannot be fitted; the verdicts of the
        parameters of all axes; a reason for each axis without a full fit; notes for the report.
    """
    fits: dict[str, AxisPredictor] = {}
    found: list[ParameterVerdict] = []
    reasons, notes = list[str](), list[str]()
    for k, (axis, log) in enumerate(logs.items()):

        def advance(share: float, stage: str, k: int = k, axis: str = axis) -> None:
            progress((k + share) / len(logs), f"{axis}: {stage}")

        try:
            _check_excited(log)
            between = _fit_between_stops(log, selection)
            fit, about = _select_model(log, names, between, advance, looks[axis], usual.get(axis))
        except LogError as error:
            reasons.append(f"{axis}: {error}")
            unknown = [
                ParameterVerdict(
                    about=plain_parameter(name, units[axis], held=log.held),
                    name=f"{name}_{axis}",
                    why=str(error),
                )
                for name in (*SMOOTH_PARAMETERS, "friction")
            ]
            verdicts, plain_notes = assess_plainly(log, axis, units[axis], unknown)
            found += verdicts
            notes += plain_notes
            with suppress(LogError):
                _check_excited(log)
                plain = fit_five_numbers(log, DELAYS_S[log.held], looks[axis])
                fits[axis] = choose_lead(AxisPredictor((plain,)))
                five = describe_five_numbers(plain)
                notes.append(f"{axis}: predictions are those of {five}")
            continue
        notes += [f"{axis}: {each}" for each in about]
        verdicts = _assess_axis(fit, axis, units[axis], selection)
        (gain,) = (each for each in verdicts if each.name == f"gain_{axis}")
        predictor, note = choose_predictor(fit, alone=_excludes_zero(gain), look=looks[axis])
        fits[axis] = choose_lead(predictor)
        notes += [f"{axis}: {note}"] if note else []
        if not fit.problem.drift:  # the plain model has one level for the whole log
            verdicts, plain_notes = assess_plainly(log, axis, units[axis], verdicts)
            notes += plain_notes
        found += verdicts
        if fit.pushed:
            notes.append(f"{axis}: {fit.pushed:.1f} s left out: a hand, the rim or a false ball")
    notes += [
        f"{axis}: a prediction starts from {1000 * fit.lead_s:.0f} ms of positions"
        for axis, fit in fits.items()
    ]
    return fits, found, reasons, notes


def _excludes_zero(found: ParameterVerdict) -> bool:
    """Whether the interval of a parameter is known and does not hold zero."""
    return found.low is not None and found.high is not None and found.low * found.high > 0


def _predict_held_out(
    fits: Mapping[str, AxisPredictor],
    others: Sequence[Mapping[str, AxisLog]],
    levers: Mapping[str, float],
    selection: AxisSelection,
) -> dict[str, Predicted]:
    """Axis to predictions of what was held out, from the same times of all axes."""
    there = {axis: [other[axis] for other in others if axis in other] for axis in fits}
    unseen = {
        axis: join_logs(own, levers.get(axis), selection) for axis, own in there.items() if own
    }
    if not unseen:
        return {}
    # the ball is seen along both axes or neither
    at = prediction_times(next(iter(unseen.values())), selection.fitting)
    if not len(at):
        return {}
    return {axis: fits[axis].predict(log, at) for axis, log in unseen.items()}


def _describe_work(logs: Mapping[str, AxisLog], source: str) -> str:
    """Describe what will be fitted, and roughly how long it takes on one processor."""
    seconds = {
        axis: float(np.ptp(log.sampled)) if len(log.sampled) else 0.0 for axis, log in logs.items()
    }
    least = sum(PROCESSOR_S + PROCESSOR_S_PER_S * each for each in seconds.values())
    longest, axes = max(seconds.values(), default=0.0), " and ".join(logs)
    return (
        f"{source}: fitting {longest:.0f} s along {axes}: about "
        f"{least:.0f} s of processor time, up to {SLOWEST_RATIO * least:.0f} s if the model does "
        "not explain the log"
    )


def _describe_gain(axis: str, gain: ParameterVerdict, factor: float, *, held: bool) -> str:
    """How much of what a ball does an axis does, in a sentence.

    No factor is advised from a gain that is not identified.

    Args:
        axis: x or y.
        gain: Verdict of its gain, m/s^2 per rad.
        factor: Share of gravity that accelerates the ball.
        held: Whether the gain is that of a command, not of a measured angle.
    """
    sign, push = AXIS_SIGNS[axis], factor * BallPlate().gravity
    what = "command" if held else "measured angle"
    if gain.word != IDENTIFIED_VERDICT or gain.value is None:
        known = "" if gain.low is None else f" (95 %: {gain.interval} m/s^2 per rad)"
        return (
            f"{axis}: how far {'a command tilts the plate' if held else 'an angle moves the ball'} "
            f"is not known from this log{known}, so no factor on the {what} is advised and no rig "
            "of its own follows from it."
        )
    share = gain.value / push
    turned = sign * share
    known = (
        "the plate's tilt per command and the ball's share of gravity, and commands are taken as "
        "angles of the plate, whatever linkage a rig has."
        if held
        else "the scale of the angle and the ball's share of gravity."
    )
    sentence = (
        f"{axis}: {gain.value:.3g} m/s^2 per rad of {'' if held else 'the '}{what} "
        f"({gain.interval}) is {share:.2f} times the acceleration of a ball that takes "
        f"{factor:.3g} of gravity: the log shows only this product of {known}"
    )
    if not _is_other_scale(turned):
        return sentence
    assert gain.low is not None
    assert gain.high is not None
    least, most = sorted(sign * end / push for end in (gain.low, gain.high))
    return (
        f"{sentence} For compare, shadow and whatif, give the {what} times {turned:.3g} "
        f"({least:.3g} to {most:.3g}; a - before its name turns the sign, a factor stands before "
        "its unit)."
    )


def _is_other_scale(turned: float) -> bool:
    """Whether a tilt per command is beyond what `rig.cam_error_percent` takes."""
    return abs(turned - 1) > MAX_SCALE_ERROR


def split_axes(log: AnyLog, share: float) -> tuple[dict[str, AxisLog], dict[str, AxisLog]]:
    """The axes of a log before and after a border.

    Args:
        log: The log.
        share: Share of its time that lies after the border.

    Returns:
        Axis to its log before the border, and the same after it.
    """
    border = min(each.sampled[0] + (1 - share) * np.ptp(each.sampled) for each in log.axes.values())
    return (
        {axis: each.between(-np.inf, border) for axis, each in log.axes.items()},
        {axis: each.between(border, np.inf) for axis, each in log.axes.items()},
    )


def join_logs(
    logs: list[AxisLog],
    lever: float | None = None,
    selection: AxisSelection = AXIS_SELECTION,
) -> AxisLog:
    """Logs of an axis in sequence, with a pause between.

    The samples of the first seconds of each log and after each pause of its commands are left out:
    commands before them, which the log has not, may still move the ball.

    Args:
        logs: Of one axis, each from its own start.
        lever: How far above the plate's axis the ball is known to be as good as, m; None if it is
            not.
        selection: Constants.
    """
    start, shifted, recordings = 0.0, list[tuple[Array, ...]](), list[Array]()
    for log in logs:
        pauses = np.flatnonzero(np.diff(log.time, prepend=-np.inf) > MAX_COMMAND_GAP_S)
        each = log.without(log.time[pauses], selection.earlier_commands_s)
        shift = start - float(each.sampled[0] if len(each.sampled) else each.time[0])
        across = each.across + np.array([[shift], [0.0]])
        begun = [start - selection.pause_between_logs_s / 2] if shifted else []
        recordings.append(np.append(begun, each.recordings + shift))
        own = (each.time + shift, each.tilt, each.sampled + shift, each.ball, across)
        shifted.append((*own, *each.added))
        start = float(each.time[-1]) + shift + selection.pause_between_logs_s
    parts = zip(*shifted, strict=True)
    time, tilt, sampled, ball, across, *added = (np.concatenate(part, axis=-1) for part in parts)
    return AxisLog(
        *(time, tilt, logs[0].held, sampled, ball, across),
        lever=lever,
        recordings=np.concatenate(recordings),
        added=tuple(added),
    )


def _fit_between_stops(log: AxisLog, selection: AxisSelection) -> AxisSelection:
    """Constants with windows as long as the ball usually rolls without touching an end stop.

    Or as long as the ball is seen without a gap, where that is shorter.
    """
    if log.stops is None and len(spans(log, selection.window_s)[0]) >= selection.min_windows:
        return selection
    longest = min(max(usual_free_time(log), selection.least_window_s), selection.window_s)
    search = selection.fitting.search
    search = replace(search, first_window_s=min(search.first_window_s, longest))
    return replace(selection, window_s=longest, fitting=replace(selection.fitting, search=search))


def _check_excited(log: AxisLog) -> None:
    if float(np.ptp(log.tilt)) == 0.0:
        raise LogError("this axis does not move in the log; tilt it back and forth to identify it")
    if len(log.sampled) < 30 or float(np.ptp(log.ball)) < 0.005:
        way = 1000 * float(np.ptp(log.ball)) if len(log.ball) else 0.0
        raise LogError(
            f"{len(log.sampled)} ball positions within {way:.1f} mm; let it roll some centimetres"
        )


def _select_model(
    log: AxisLog,
    names: tuple[str, ...],
    selection: AxisSelection = AXIS_SELECTION,
    advance: Callable[[float, str], None] = lambda *_: None,
    look: FirstLook | None = None,
    usual: AxisFit | None = None,
) -> tuple[AxisFit, list[str]]:
    """The fit with the parameters that reduce the prediction error, and notes on it.

    Args:
        log: The axis.
        names: Parameters that are fitted next to the usual ones; none for those that are useful.
        selection: Constants.
        advance: Called with the share of the work done, and what is done next.
        look: A first look at it.
        usual: A fit of its usual parameters, which is not repeated; None if there is none.
    """
    notes: list[str] = []
    longest, fitting = selection.window_s, selection.fitting

    def tell(share: float, stage: str, name: str) -> None:
        advance(share, f"{stage}: {PLAIN_PARAMETERS[name].key}")

    requested = tuple(
        name for name in PLAIN_PARAMETERS if name in names and name not in SMOOTH_PARAMETERS
    )
    chosen = _choose_parameters(log, requested or ("friction",))
    delays = DELAYS_S[log.held]
    advance(0.0, "windows from no first guess")
    ways = (log, replace(log, across=0 * log.across)) if log.across[1].any() else (log,)
    done = [usual] if usual and usual.problem.names == chosen else []
    fits = [
        *done,
        *(fit_axis(e, chosen, longest, delays, fitting, look) for e in ways[len(done) :]),
    ]
    # of all windows, not the usual one, in which the ball may rest; 10 um are as good as none
    squares = [f.sigma**2 * f.problem.misfit(f.found.linearisation.r) for f in fits]
    at = int(np.argmin([np.log(1e-10 + each).mean() for each in squares]))
    log, fit = ways[at], fits[at]
    if log.across[1].any():
        notes.append("friction acts against the way of the ball along both axes")
    dead_time, lag = fit.value("dead_time"), fit.value("lag")
    least, most = delays
    # an ideal drive and a camera with a late clock: dead time and lag end at zero
    behind = dead_time < least + 0.01 and lag < 0.02
    if behind or dead_time > most - 0.01:
        wider = (-0.5 if behind or not log.held else 0.0, 1.0)
        fit = fit_axis(log, chosen, longest, wider, fitting, look)
        notes.append(
            "dead time at a bound, which was widened: it holds what the clocks of camera and "
            "command differ by, and is negative where that is more"
        )
    if not names:
        advance(0.15, "dead band, play and slew of the drives")
        fit, drive_notes = _add_useful_drives(fit, selection, partial(tell, 0.15, "drives"))
        advance(0.45, "camber and viscous friction")
        fit, term_notes = _add_useful_terms(fit, selection)
        notes += drive_notes + term_notes
    advance(0.55, "likelihood profiles")
    fit = profile_drives(fit, partial(tell, 0.55, "likelihood profile"))
    advance(0.7, "shorter windows, and predictions")
    shorter = [share * longest for share in selection.shorter_window_shares]
    try:
        brief = tuple(fit.refit(fit.log, fit.problem.names, each) for each in shorter)
    except LogError:
        return fit, notes
    fit = refit_for_prediction(replace(fit, briefer=brief), longest)
    if fit.problem.drift and not names:
        known = fit
        fit, term_notes = _add_useful_terms(fit, selection)
        notes += term_notes
        names = fit.problem.names
        one = known.windowed and known.windowed.refit(known.log, names, longest)
        brief = tuple(fit.refit(known.log, names, each) for each in shorter)
        fit = replace(fit, windowed=one, briefer=brief)
    if fit.windowed:
        drifts = fit.problem.drift > 0
        why = "the level drifts: follow it" if drifts else "dead band, play or another force"
        notes.append(f"the model is in error ({why}); its values are those that predict best")
    return fit, notes


def _add_useful_drives(
    fit: AxisFit, selection: AxisSelection, tell: Callable[[str], object]
) -> tuple[AxisFit, list[str]]:
    """The fit with the drive effects that reduce the prediction error, and a note on them.

    They are compared next to all other optional parameters.

    Args:
        fit: Without them.
        selection: Constants.
        tell: Called with the name of each before it is fitted.
    """
    own, longest = fit.problem.names, selection.window_s
    if fit.explained:
        return fit, []
    every = tuple(dict.fromkeys((*own, *selection.optional_parameters)))
    middle = _take_middle(fit, selection)
    rich = middle.refit(middle.log, every, longest)
    found = add_drive_effects(rich, longest, tell)
    new = tuple(name for name in PROFILED_EFFECTS if name in found.problem.names)
    if not new:
        return fit, []
    error, without = (cross_validate(each, each.problem.names, longest) for each in (found, rich))
    useful = error < selection.accepted_drive_error_share * without
    if error >= selection.max_drive_error_m or not useful:
        return fit, []
    what = " and ".join(PLAIN_PARAMETERS[name].key for name in new)
    whole = replace(found, problem=replace(found.problem, tilt=fit.problem.tilt))
    return whole.refit(fit.log, (*own, *new), longest), [_describe_gained(what, error, without)]


def _add_useful_terms(fit: AxisFit, selection: AxisSelection) -> tuple[AxisFit, list[str]]:
    """The fit with the optional parameters that reduce the prediction error, and notes on them."""
    own = chosen = fit.problem.names
    longest, notes = selection.window_s, list[str]()
    candidates = [name for name in selection.optional_parameters if name not in own]
    share = 1.0
    if not fit.problem.drift:
        share, least = selection.accepted_error_share, selection.min_term_stds
        candidates = [each for each in candidates if find_significance(fit, each) > least]
    if not candidates:
        return fit, notes
    middle = _take_middle(fit, selection)
    best = cross_validate(middle, chosen, longest)
    for name in candidates:
        error = cross_validate(middle, (*chosen, name), longest)
        if error < share * best:
            notes.append(_describe_gained(name, error, best))
            chosen, best = (*chosen, name), error
    return fit.refit(fit.log, chosen, longest) if chosen != own else fit, notes


def _take_middle(fit: AxisFit, selection: AxisSelection) -> AxisFit:
    """The fit with the part of its log by which models are compared, and the commands of that."""
    log, longest = fit.log, selection.max_compared_s
    begin, end = float(log.sampled[0]), float(log.sampled[-1])
    if end - begin <= longest:
        return fit
    begin, end = (begin + end - longest) / 2, (begin + end + longest) / 2
    sent = (log.time > begin - selection.pause_between_logs_s) & (log.time < end + 1.0)
    part, added = log.between(begin, end), tuple(each[sent] for each in log.added)
    part = replace(part, time=log.time[sent], tilt=log.tilt[sent], added=added)
    tilt = TiltHistory(part, fit.problem.tilt.scale)
    return replace(fit, log=part, problem=replace(fit.problem, tilt=tilt))


def _describe_gained(what: str, error: float, without: float) -> str:
    """The note on a parameter that reduces the error of cross-validation, both in m."""
    return (
        f"{what} fitted along: with it one half of the log predicts the other to "
        f"{1000 * error:.1f} mm, without it to {1000 * without:.1f} mm"
    )


def _assess_axis(
    fit: AxisFit, axis: str, unit: str, selection: AxisSelection = AXIS_SELECTION
) -> list[ParameterVerdict]:
    """Value, interval and verdict of each parameter of an axis."""
    names = fit.problem.names
    rows = (*names, *(("delay",) if "lag" in names else ()))
    pair = [k for k, name in enumerate(names) if name in {"dead_time", "lag"}]
    own = _append_total_delay(fit)
    low, high = own.value - own.half_width, own.value + own.half_width
    reasons: list[list[str]] = [[] for _ in rows]
    checks = [(each, f"windows of {each.problem.longest:.1f} s") for each in fit.briefer]
    if fit.windowed:
        checks.insert(0, (fit.windowed, "windows of one level"))
    for check, label in checks:
        other = _append_total_delay(check)
        apart = np.abs(own.value - other.value)
        unlike = apart > np.hypot(own.half_width, other.half_width)
        low = np.where(unlike, np.minimum(low, other.value - other.half_width), low)
        high = np.where(unlike, np.maximum(high, other.value + other.half_width), high)
        word = f"{label} give a different value, which the interval includes: a model error"
        for k in np.flatnonzero(unlike).tolist():
            reasons[k].append(word)
    for what, changes in _find_left_out_terms(fit, selection):
        total = changes[:, pair].sum(axis=1)
        moved = np.column_stack((changes, total)) if len(rows) > len(names) else changes
        low, high = low + moved.min(axis=0, initial=0.0), high + moved.max(axis=0, initial=0.0)
        for k in np.flatnonzero(np.abs(moved).max(axis=0) > own.half_width).tolist():
            reasons[k].append(f"the interval includes what {what} would change")
    for k, name in enumerate(names):
        if name in DOUBTED_WHERE_NOT_WHITE and not (fit.windowed or fit).explained:
            low[k], high[k] = low[k] - own.half_width[k], high[k] + own.half_width[k]
            reasons[k].append(
                "the residuals are not white, so its interval is twice as wide: "
                f"{DOUBTED_WHERE_NOT_WHITE[name]}"
            )
    rivals = {PLAIN_PARAMETERS[name].key: value for name, value in fit.rivals}
    for k, name in enumerate(rows):
        if rivals and name in DRIVE_EFFECTS:
            low[k] = 0.0
            reasons[k].append(f"{' or '.join(rivals)} instead explains the log nearly as well")
    alike = np.abs(own.correlation) > MAX_CORRELATION
    drawn = own.draws - own.value
    unfitted = [each for each in fit.profiles if each.name not in names]
    hidden = {each.name: each.deviations[each.name] for each in unfitted}
    shares = {  # of the scatter of each that is of what is not fitted
        name: (moved @ drawn) ** 2 / np.maximum((moved @ moved) * (drawn**2).sum(axis=0), 1e-300)
        for name, moved in hidden.items()
    }
    ends = [*np.transpose(fit.problem.bounds), (-np.inf, np.inf)]
    swing = fit.problem.tilt.scale
    scales = {"gain": 1 / swing, "dead_band": swing, "play": 2 * swing}
    found: list[ParameterVerdict] = []
    for k, name in enumerate(rows):
        others = [
            PLAIN_PARAMETERS[each].key for j, each in enumerate(names) if alike[k, j] and j != k
        ]
        others += [
            PLAIN_PARAMETERS[each].key
            for each, share in shares.items()
            if share[k] > selection.conditional_scatter_share
        ]
        values = (own.value[k], low[k], high[k])
        indistinct = [] if name == "delay" else others
        verdict = _assess_parameter(
            plain_parameter(name, unit, held=fit.log.held),
            f"{name}_{axis}",
            values,
            ends[k],
            reasons[k],
            indistinct,
            scales.get(name, 1.0),
        )
        verdict = _to_slew_rate(verdict, swing) if name == "slew" else verdict
        found.insert(3 if name == "delay" else k, verdict)
    found += [
        _bound_hidden(fit, name, axis, unit, moved, selection) for name, moved in hidden.items()
    ]
    if (lever := fit.log.lever) is not None:
        word, half = GIVEN_VERDICT, 2 * selection.fitting.drives.height_std_m
        given = replace(found.pop(), value=lever, word=word, why=LEVER_HELD_MESSAGE)
        found.append(replace(given, low=lever - half, high=lever + half))
    return found


def _find_left_out_terms(fit: AxisFit, selection: AxisSelection) -> list[tuple[str, Array]]:
    """What a fit has not, and by how much it may change the parameters.

    A term too small to be significant still moves the others: a damping, the delay. What resembles
    friction moves friction, damping and gain. Windows with a level of their own show neither.

    Args:
        fit: Of an axis, P parameters.
        selection: Constants.

    Returns:
        Each in words, and N changes that it may make, shape (N, P); none for a term of an
        impossible sign, or one that the log does not show: Akaike's criterion is no better with it.
    """
    names, found = fit.problem.names, list[tuple[str, Array]]()
    if fit.problem.drift:
        return found
    for name in selection.optional_parameters:
        if name not in names:
            changes, std = find_term(fit, name)
            better = (changes[-1] / std) ** 2 > AKAIKE_PENALTY
            if better and changes[-1] > PLAIN_PARAMETERS[name].least:
                key = PLAIN_PARAMETERS[name].key
                found.append((f"a {key} term too small to be fitted", changes[None, :-1]))
    by_windows = fit.windowed or fit
    if "friction" in names and by_windows.problem.names == names:
        resembled = np.isin(names, RESEMBLED)
        found += [(what, each * resembled) for what, each in find_hidden_changes(by_windows)]
    return found


def _bound_hidden(
    fit: AxisFit, name: str, axis: str, unit: str, moved: Array, selection: AxisSelection
) -> ParameterVerdict:
    """The verdict of a parameter that is not fitted: how much of it there may be.

    Args:
        fit: Of the axis.
        name: The parameter.
        axis: x or y.
        unit: Unit of the tilt.
        moved: Draws of it.
        selection: Constants.
    """
    probability, swing = selection.bound_probability, fit.problem.tilt.scale
    least, most = np.quantile(moved, (1 - probability, probability)).tolist()
    by = {"dead_band": swing, "play": 2 * swing}.get(name, 1.0)
    about = plain_parameter(name, unit, held=fit.log.held)
    none = ParameterVerdict.unknown(about, f"{name}_{axis}", "not distinguishable from zero")
    if (value := dict(fit.rivals).get(name)) is not None:
        most = max(most, (1 + about.relative) * value)
        why = f"it explains the log nearly as well as the fitted effect; {about.experiment}"
        none = replace(none, why=why)
    none = replace(none, low=by * min(least, 0.0), high=by * (most or abs(about.tried[1])))
    return _to_slew_rate(none, swing) if name == "slew" else none


def _to_slew_rate(found: ParameterVerdict, swing: float) -> ParameterVerdict:
    """A verdict of seconds by swing, as it is fitted, as one of a rate."""
    low, value, high = (
        swing / end if end else None for end in (found.high, found.value, found.low)
    )
    return replace(found, low=low, value=value, high=high)


def describe_lags(verdicts: Sequence[ParameterVerdict]) -> list[str]:
    """Notes on delays that a scenario has not: of a filter, and different ones of the axes.

    Args:
        verdicts: Of all axes with commands, by names as ``lag_x``.
    """
    known = {each.name: each for each in verdicts if each.word == IDENTIFIED_VERDICT}
    notes = []
    if {"lag_x", "lag_y", "delay_x", "delay_y"} & known.keys():
        notes.append(
            "a lag is that of the drives or of a filter of the positions: a log of commands cannot "
            "tell which, and parameters.toml gives it to the drives"
        )
    x, y = (known.get(f"delay_{axis}") for axis in "xy")
    if x and y and (max(x.low or 0, y.low or 0) > min(x.high or 0, y.high or 0)):
        notes.append(
            f"dead time + lag differ along x ({digits(x.value)} s) and y ({digits(y.value)} s): a "
            "scenario has one of each, and parameters.toml has their means"
        )
    return notes


def _append_total_delay(fit: AxisFit) -> Estimate:
    """The parameters and, last, the sum of dead time and lag: often known where neither is."""
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


def _assess_parameter(
    about: IdentifiedParameter,
    name: str,
    values: tuple[Array, Array, Array],
    ends: Array | tuple[float, float],
    reasons: Sequence[str],
    alike: Sequence[str],
    scale: float = 1.0,
) -> ParameterVerdict:
    """The verdict of one parameter.

    Args:
        about: Which.
        name: With its axis.
        values: The fit and both ends of its interval.
        ends: Least and largest value of a fit.
        reasons: Errors found so far, in words.
        alike: Keys of the parameters from which it cannot be distinguished.
        scale: Factor from these values to the reported ones.
    """
    (value, low, high), (least, most) = map(float, values), map(float, ends)
    if not math.isfinite(high - low):
        return ParameterVerdict.unknown(about, name, "the log does not show it")
    low = max(min(low, value - about.floor), least)
    high = min(max(high, value + about.floor), most)
    slack = 1e-3 * (most - least)
    at_bound = value < least + slack or value > most - slack
    narrow = (high - low) / 2 <= about.allowed_half_width(value) and not at_bound
    nothing = name.startswith("gain") and low <= 0 <= high
    why = list(reasons)
    if value < least + slack and least == 0:
        why.append(f"not distinguishable from zero; {about.experiment}")
    elif at_bound:
        why.append(f"at its bound of {value:.3g}; {about.experiment}")
    if nothing:
        why.append(
            f"not distinguishable from zero: a wrong column, exchanged axes, or {about.experiment}"
        )
    elif alike and not narrow:
        why.append(f"known only together with {' and '.join(alike)}")
    elif not at_bound and not narrow:
        why.append(f"its interval is wide; {about.experiment}")
    bounded = at_bound or low <= least or high >= most
    word = IDENTIFIED_VERDICT if narrow else BOUNDED_VERDICT if bounded else NOT_IDENTIFIABLE
    return ParameterVerdict(
        about=about,
        name=name,
        value=scale * value,
        low=scale * low,
        high=scale * high,
        word=NOT_IDENTIFIABLE if nothing else word,
        why="; ".join(why),
    )
