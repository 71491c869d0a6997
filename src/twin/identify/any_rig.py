"""Fits the plain model of each axis to logs of any rig, with intervals and held-out errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.base.errors import LogError
from twin.identify.axis_identification import AxisIdentification, is_other_scale
from twin.identify.axis_logs import MAX_COMMAND_GAP_S, AnyLog, AxisLog
from twin.identify.axis_prediction import prediction_times
from twin.identify.axis_selection import AXIS_SELECTION, DELAYS_S, AxisSelection
from twin.identify.axis_verdicts import assess_axis, describe_lags
from twin.identify.corrections import find_correction
from twin.identify.end_stops import describe_stops, find_end_stops
from twin.identify.fallback import assess_plainly
from twin.identify.first_look import FirstLook, look_first
from twin.identify.model_choice import (
    check_excited,
    fit_between_stops,
    fit_usual_parameters,
    select_model,
)
from twin.identify.offsets import take_out_offsets, tell_level_at_zero
from twin.identify.parameters import plain_parameter
from twin.identify.plain_model import SMOOTH_PARAMETERS, AxisFit
from twin.identify.predictor import (
    AxisPredictor,
    choose_predictor,
    describe_five_numbers,
    fit_five_numbers,
    predict_plainly,
)
from twin.identify.slow_cameras import scale_to_samples
from twin.identify.suspicions import AXIS_SIGNS, describe_suspicions, find_other_ball
from twin.identify.verdicts import IDENTIFIED_VERDICT, ParameterVerdict, Predicted, score
from twin.identify.weak_form import WeakForm
from twin.identify.windows import usual_step

EXPLAINED_S, UNEXPLAINED_S = (1.4, 0.04), (5.5, 0.05)
"""Processor time of an axis in s, and more of it for each second of its log: where a fit of the
usual parameters leaves noise, and where it leaves more, so that drive effects are fitted as well
and predictions decide. Measured on eleven logs of 20 to 300 s."""


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
    more = ball.radius * (1 / factor - 1)  # J / (m r): c4 of (5.1) is the height and this
    levers = {axis: height + more for axis, height in zip("xy", heights or (), strict=False)}
    notes = [note for log in logs for note in log.notes]
    first = logs[0]
    ready = _prepare_axes(logs, held, levers, factor, selection, progress, say)
    notes += ready.warned
    for axis, log in ready.joined.items():
        notes += describe_stops(axis, log)
    fits, found, reasons, remarks_on_fits = _fit_axes(ready, first.unit, names, progress)
    found, about_offsets = tell_level_at_zero(found, ready.offsets, first.unit)
    notes += remarks_on_fits + about_offsets
    if not fits and not any(each.value is not None for each in found):
        raise LogError(f"{first.source}: no axis can be identified: {'; '.join(reasons)}")
    notes += [f"not identified: {each}" for each in reasons]
    tried = _predict_held_out(fits, ready.others, levers, ready.selection)
    scored = [{axis: each} for axis, each in tried.items()]
    scored += [tried] if len(tried) > 1 else []
    seconds = sum(float(np.ptp(next(iter(part.values())).sampled)) for part in ready.fitted)
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
        scores=tuple(map(score, scored)),
        predictions=tried,
        notes=tuple(notes),
        factor=factor,
        ball=ball,
        on=str(on or ""),
        how=ready.selection.fitting.hold_out,
        warned=tuple(ready.warned),
    )


class PreparedAxes(NamedTuple):
    """Logs of any rig, ready to be fitted axis by axis.

    Attributes:
        fitted: The part of each log that is fitted, by axis.
        joined: These parts of all logs joined, by axis, with end stops.
        others: What is held out of each log, or the other logs, by axis.
        offsets: Middle of the commands by axis, where it was taken out of them.
        looks: First looks at the joined logs.
        usual: Fits of their usual parameters, as far as there are any; none after a correction.
        warned: Suspicions and corrections in words.
        selection: Constants of the fit, scaled to the rate of the samples.
        form: Constants of first looks, scaled alike.
    """

    fitted: list[dict[str, AxisLog]]
    joined: dict[str, AxisLog]
    others: list[Mapping[str, AxisLog]]
    offsets: dict[str, float]
    looks: dict[str, FirstLook | None]
    usual: dict[str, AxisFit]
    warned: list[str]
    selection: AxisSelection
    form: WeakForm


def _prepare_axes(
    logs: Sequence[AnyLog],
    held: list[AnyLog] | float,
    levers: Mapping[str, float],
    factor: float,
    selection: AxisSelection,
    progress: Callable[[float, str], None],
    say: Callable[[str], object],
) -> PreparedAxes:
    """Join the logs of each axis, look at them first, and correct clocks and axes that need it.

    Args:
        logs: What is fitted.
        held: What is held out: other logs of the same rig, or a share of each log's time.
        levers: How far above the plate's axis the ball is as good as, m, by axis, where known.
        factor: Share of gravity that accelerates the ball.
        selection: Constants of the fit.
        progress: Called with the share of the work done and the name of the next step.
        say: Called with lines on the work, first looks and warnings.
    """
    logs, held, offsets = take_out_offsets(logs, held)
    first = logs[0]

    def join(how: AxisSelection) -> tuple[list[dict[str, AxisLog]], dict[str, AxisLog]]:
        parts = [
            split_axes(log, held)[0] if isinstance(held, float) else dict(log.axes) for log in logs
        ]
        return parts, {
            axis: join_logs([part[axis] for part in parts], levers.get(axis), how)
            for axis in first.unit
        }

    fitted, joined = join(selection)
    selection, form = scale_to_samples(min(map(usual_step, joined.values())), selection)
    say(_describe_work(joined, first.source))
    looks = {axis: look_first(log, form) for axis, log in joined.items()}
    for axis, look in looks.items():
        if look:
            say(look.describe(axis, first.unit[axis]))
    warned = list(describe_suspicions(joined, first.unit, looks, factor))
    for suspicion in warned:
        say(f"warning: {suspicion}")
    joined = _find_stops(joined, looks)
    usual = fit_usual_parameters(joined, looks, selection, progress)
    _tell_rest(joined, usual, say)
    correction = find_correction(usual, first.unit)
    if correction.notes:
        usual = {}
        warned += correction.notes
        for note in correction.notes:
            say(f"warning: {note}")
        logs = [correction.apply(log) for log in logs]
        held = held if isinstance(held, float) else [correction.apply(log) for log in held]
        fitted, joined = join(selection)
        looks = {axis: look_first(log, form) for axis, log in joined.items()}
        joined = _find_stops(joined, looks)
    others: list[Mapping[str, AxisLog]] = (
        [split_axes(log, held)[1] for log in logs]
        if isinstance(held, float)
        else [log.axes for log in held]
    )
    return PreparedAxes(fitted, joined, others, offsets, looks, usual, warned, selection, form)


def _find_stops(
    logs: Mapping[str, AxisLog], looks: Mapping[str, FirstLook | None]
) -> dict[str, AxisLog]:
    """The logs of the axes with their end stops, by first looks at them."""
    found = {}
    for axis, log in logs.items():
        look = looks[axis]
        found[axis] = replace(log, stops=find_end_stops(log, look)) if look else log
    return found


def _fit_axes(
    ready: PreparedAxes,
    units: Mapping[str, str],
    names: tuple[str, ...],
    progress: Callable[[float, str], None],
) -> tuple[dict[str, AxisPredictor], list[ParameterVerdict], list[str], list[str]]:
    """Fit the plain model to each axis by itself.

    Args:
        ready: The logs by axis, x or y, as they were prepared.
        units: Unit of the command by axis.
        names: Parameters that are fitted in addition to the smooth ones.
        progress: Called with the share of the work done and the name of the next step.

    Returns:
        What predicts best by axis, without an axis that cannot be fitted; the verdicts of the
        parameters of all axes; a reason for each axis without a full fit; notes for the report.
    """
    looks, selection, form = ready.looks, ready.selection, ready.form
    fits: dict[str, AxisPredictor] = {}
    found: list[ParameterVerdict] = []
    reasons, notes = list[str](), list[str]()
    for k, (axis, log) in enumerate(ready.joined.items()):

        def advance(share: float, stage: str, k: int = k, axis: str = axis) -> None:
            progress((k + share) / len(ready.joined), f"{axis}: {stage}")

        try:
            check_excited(log)
            between = fit_between_stops(log, selection)
            fit, about = select_model(
                log, names, between, advance, looks[axis], ready.usual.get(axis)
            )
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
            verdicts, plain_notes = assess_plainly(
                log, axis, units[axis], unknown, form, looks[axis]
            )
            found += verdicts
            notes += plain_notes
            with suppress(LogError):
                check_excited(log)
                plain = fit_five_numbers(log, DELAYS_S[log.held], looks[axis], selection.fitting)
                fits[axis] = predict_plainly(plain)
                five = describe_five_numbers(plain)
                notes.append(f"{axis}: predictions are those of {five}")
            continue
        notes += [f"{axis}: {each}" for each in about]
        verdicts = assess_axis(fit, axis, units[axis], selection)
        (gain,) = (each for each in verdicts if each.name == f"gain_{axis}")
        alone = _excludes_zero(gain)
        fits[axis], note = choose_predictor(fit, alone=alone, look=looks[axis])
        notes += [f"{axis}: {note}"] if note else []
        if not fit.problem.drift:  # the plain model has one level for the whole log
            verdicts, plain_notes = assess_plainly(
                log, axis, units[axis], verdicts, form, looks[axis]
            )
            notes += plain_notes
        found += verdicts
        if fit.pushed:
            notes.append(f"{axis}: {fit.pushed:.1f} s left out: a hand, the rim or a false ball")
    notes += [
        f"{axis}: a prediction starts from {1000 * fit.lead_s:.0f} ms of positions in the mean"
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
    longest = max((_measure_span(log) for log in logs.values()), default=0.0)
    least, most = (
        sum(begin + share * _measure_span(log) for log in logs.values())
        for begin, share in (EXPLAINED_S, UNEXPLAINED_S)
    )
    return (
        f"{source}: fitting {longest:.0f} s along {' and '.join(logs)}: about {least:.0f} s of "
        f"processor time if the model explains the log, else about {most:.0f} s"
    )


def _tell_rest(
    logs: Mapping[str, AxisLog], usual: Mapping[str, AxisFit], say: Callable[[str], object]
) -> None:
    """Tell what the first fits leave, and so how long all of it takes on one processor.

    An axis that cannot be fitted takes no longer than one that is explained.

    Args:
        logs: The joined logs by axis.
        usual: Fits of their usual parameters, as far as there are any; nothing is told of none.
        say: Called with the line.
    """
    left = [axis for axis, fit in usual.items() if not fit.explained]
    kinds = {axis: UNEXPLAINED_S if axis in left else EXPLAINED_S for axis in logs}
    whole = sum(begin + share * _measure_span(logs[axis]) for axis, (begin, share) in kinds.items())
    found = "the first fits explain the log"
    if left:
        found = f"the first fits do not explain {' and '.join(left)}: more models are tried"
    if usual:
        say(f"{found}: about {whole:.0f} s of processor time in all")


def _measure_span(log: AxisLog) -> float:
    """Time from the first sample to the last, s."""
    return float(np.ptp(log.sampled)) if len(log.sampled) else 0.0


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
    assert gain.low is not None
    assert gain.high is not None
    if ball := find_other_ball(gain.value, gain.low, gain.high, factor):
        sentence += f" A {ball} ball has this gain: state it by --ball {ball} if it is one."
    if not is_other_scale(turned):
        return sentence
    least, most = sorted(sign * end / push for end in (gain.low, gain.high))
    return (
        f"{sentence} For compare, shadow and whatif, give the {what} times {turned:.3g} "
        f"({least:.3g} to {most:.3g}; a - before its name turns the sign, a factor stands before "
        "its unit)."
    )


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
