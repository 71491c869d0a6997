"""Chooses the model of an axis: the parameters that reduce the error of predictions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from twin.base.errors import LogError
from twin.identify.axis_logs import AxisLog
from twin.identify.axis_prediction import cross_validate, refit_for_prediction
from twin.identify.axis_selection import AXIS_SELECTION, DELAYS_S, AxisSelection
from twin.identify.command_model import PROFILED_EFFECTS, TiltHistory
from twin.identify.drive_effects import add_drive_effects, profile_drives
from twin.identify.first_look import FirstLook
from twin.identify.further_terms import find_significance
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.plain_model import SMOOTH_PARAMETERS, AxisFit, fit_axis
from twin.identify.windows import spans, usual_free_time


def fit_usual_parameters(
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
            check_excited(log)
            each, names = fit_between_stops(log, selection), _choose_parameters(log)
            delays = DELAYS_S[log.held]
            fits[axis] = fit_axis(log, names, each.window_s, delays, each.fitting, looks[axis])
    return fits


def _choose_parameters(log: AxisLog, others: tuple[str, ...] = ("friction",)) -> tuple[str, ...]:
    """The parameters of a first fit: the smooth ones that the log may show, and others."""
    return (*(each for each in SMOOTH_PARAMETERS if log.held or each != "lag"), *others)


def fit_between_stops(log: AxisLog, selection: AxisSelection) -> AxisSelection:
    """Constants with windows as long as the ball usually rolls without touching an end stop.

    Or as long as the ball is seen without a gap, where that is shorter.
    """
    if log.stops is None and len(spans(log, selection.window_s)[0]) >= selection.min_windows:
        return selection
    longest = min(max(usual_free_time(log), selection.least_window_s), selection.window_s)
    search = selection.fitting.search
    search = replace(search, first_window_s=min(search.first_window_s, longest))
    return replace(selection, window_s=longest, fitting=replace(selection.fitting, search=search))


def check_excited(log: AxisLog) -> None:
    """Check that a plate and its ball move enough to show anything.

    Raises:
        LogError: If they do not.
    """
    if float(np.ptp(log.tilt)) == 0.0:
        raise LogError("this axis does not move in the log; tilt it back and forth to identify it")
    if len(log.sampled) < 30 or float(np.ptp(log.ball)) < 0.005:
        way = 1000 * float(np.ptp(log.ball)) if len(log.ball) else 0.0
        raise LogError(
            f"{len(log.sampled)} ball positions within {way:.1f} mm; let it roll some centimetres"
        )


def select_model(
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
            "the first fit had the dead time at a bound, so its range was widened: it holds what "
            "the clocks of camera and command differ by, and is negative where that is more"
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
    """The fit with the optional parameters that reduce the prediction error, and notes on them.

    A parameter that is zero by its interval is left out again: halves of a log may show what all of
    it does not, and at a single frequency a camber leaves the gain open.
    """
    own = chosen = fit.problem.names
    longest, notes = selection.window_s, dict[str, str]()
    candidates = [name for name in selection.optional_parameters if name not in own]
    share = 1.0
    if not fit.problem.drift:
        share, least = selection.accepted_error_share, selection.min_term_stds
        candidates = [each for each in candidates if find_significance(fit, each) > least]
    if not candidates:
        return fit, []
    middle = _take_middle(fit, selection)
    best = cross_validate(middle, chosen, longest)
    for name in candidates:
        error = cross_validate(middle, (*chosen, name), longest)
        if error < share * best:
            notes[name] = _describe_gained(name, error, best)
            chosen, best = (*chosen, name), error
    found = fit.refit(fit.log, chosen, longest) if notes else fit
    if notes and not fit.problem.drift:
        every = found.estimate()
        zero = dict(zip(chosen, np.abs(every.value) < every.half_width, strict=True))
        left = tuple(name for name in chosen if name in own or not zero[name])
        if left != chosen:
            found = fit.refit(fit.log, left, longest) if left != own else fit
            notes = {name: note for name, note in notes.items() if name in left}
    return found, list(notes.values())


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
