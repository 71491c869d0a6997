"""The twin itself fitted to a log: from a log with plate angles to parameters and verdicts.

The part of the log that is held out shows their worth.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from controllers.ballplate import time_constant
from twin.base.errors import LogError, plural
from twin.identify.least_squares import Fit
from twin.identify.logs import Log, rig_of
from twin.identify.parameters import AT_REST, FITTED_SHARE, LEVEL_PARAMETERS, fitted_parameters
from twin.identify.plate_motion import check_motion, fit_drives
from twin.identify.prepare import PreparedLog, Segment, check_ranges, prepare
from twin.identify.twin_fit import (
    TWIN_SELECTION,
    TwinProblem,
    TwinSelection,
    fit_twin,
    has_viscous_friction,
)
from twin.identify.twin_verdicts import Whiteness, assess_parameters, whiteness
from twin.identify.verdicts import (
    HOLD_OUT,
    IDENTIFIED_VERDICT,
    HoldOutPrediction,
    Identification,
    Predicted,
    predict_windows,
    score,
)
from twin.identify.windows import LOOKBACK_S, Spans, Windows, cut, moving_spans

VISCOUS_NOTE = "friction grows with speed: viscous friction fitted along"


def replay_log(
    log: PreparedLog, fit: Fit[TwinProblem], lag: float, how: HoldOutPrediction = HOLD_OUT
) -> dict[str, Predicted]:
    """Replay a part of a log by a fitted twin from many starts: both axes, or none if too short.

    Args:
        log: The part held out.
        fit: The parameters.
        lag: Time constant of the drives in s.
        how: Constants of the predictions.
    """

    def overlapping_spans(_: Segment, begin: float, end: float, longest: float) -> Spans:
        begins = np.arange(begin, end - longest, how.interval_s)
        return Spans(begins, np.full(len(begins), longest), np.zeros(len(begins), bool))

    longest = how.lead_s + how.horizons_s[-1] + how.horizon_tolerance_s
    windows = cut(log, lag, longest, overlapping_spans)
    if windows is None:
        return {}
    lead = LOOKBACK_S + how.lead_s
    there = windows.weight[..., 0] > 0
    before = (there & (windows.time < lead)).sum(axis=1)
    windows = windows.take((before >= 3) & (there.sum(axis=1) > before))
    if not len(windows):
        return {}
    problem, theta = replace(fit.problem, windows=windows), fit.found.theta
    frictionless = theta.copy()
    for name, value in (("rolling", 0.0), ("breakaway", 1.0), ("viscous", 0.0)):
        if name in problem.names:
            frictionless[:, problem.names.index(name)] = value
    predictors = {"model": theta, "without friction": frictionless}
    return predict_windows(problem, lead, predictors, "xy"[: windows.axes], how)


@dataclass(frozen=True, kw_only=True)
class TwinIdentification(Identification):
    """Identification of a rig like the twin's from a log.

    Attributes:
        log: The part of it that was used.
        fit: The best fit.
        whiteness: What the fit leaves over.
    """

    log: PreparedLog
    fit: Fit[TwinProblem]
    whiteness: Whiteness

    def settings(self, words: Collection[str]) -> dict[str, str]:
        """Scenario keys to values in TOML with remarks, of those with one of some verdicts.

        Over a rig's file, dead time and lag are also what law and observer assume, as in the file.
        """
        known = {
            each.name: each
            for each in self.verdicts
            if each.word in words and each.value is not None
        }
        pair = [known.pop(name, None) for name in LEVEL_PARAMETERS]
        values = {
            each.about.key: f"{each.value:z.6g}  # {each.interval}, 95 %" for each in known.values()
        }
        if any(pair):
            level = ", ".join("0.0" if each is None else f"{each.value:z.6g}" for each in pair)
            known_ends = pair[: self.log.axes]
            ends = "; ".join("unknown" if each is None else each.interval for each in known_ends)
            values["plant.level_deg"] = f"[{level}]  # {ends}, 95 %"
        delay, corner = known.get("delay"), known.get("servo")
        if self.on and delay and delay.value is not None:
            values["predictor.delay"] = f"{delay.value:.6g}  # as found"
        if self.on and corner and corner.value:
            values["rig.plate_lag"] = f"{time_constant(corner.value):.6g}  # of these drives"
        return values | self.over

    def as_dict(self) -> dict[str, Any]:
        """The numbers, for ``--json``."""
        found = super().as_dict()
        older = {"twin": "model", "frictionless": "without friction", "still": "stays"}
        errors = [each["median"] for each in found["held_out"]]
        replay = [{old: each[now] for old, now in older.items()} for each in errors]
        return {
            **found,
            "replay_error": {"ahead": found["ahead"], **replay[0]} if replay else None,
            "usable_seconds": self.log.length,
            "residuals": self.whiteness.as_dict(),
            "fit": asdict(self.fit.found.termination),
        }


def fit_windows(
    log: PreparedLog,
    windows: Windows,
    names: tuple[str, ...],
    selection: TwinSelection = TWIN_SELECTION,
    progress: Callable[[float], None] = lambda _: None,
    guess: Mapping[str, float] | None = None,
) -> tuple[tuple[str, ...], Fit[TwinProblem], Whiteness, list[str]]:
    """Fit the parameters, on an even screen or, if that does not explain the log, an uneven one.

    The ageing of the contact at rest is fitted along, whether it is requested or not: noise may
    hide it in residuals that look white, while it moves breakaway, rolling friction and dead time.

    Args:
        log: The log, with the kinds of friction at rest to try.
        windows: Its windows.
        names: The requested parameters.
        selection: Constants of the fit.
        progress: Called with the share of the work done.
        guess: Every ball parameter by name, in SI units, where a fit begins; None to search.

    Returns:
        The fitted parameters (viscous friction may be added), the fit, the whiteness of its
        residuals, and notes for the report.
    """

    def best(asked: tuple[str, ...], *, uneven: bool = False) -> Fit[TwinProblem]:
        fitted = fitted_parameters(asked, windows.axes)
        guesses = None if guess is None else np.array([[guess[name] for name in fitted]])
        fits = [
            fit_twin(
                log.model,
                windows,
                fitted,
                grip,
                uneven=uneven,
                guesses=guesses,
                selection=selection,
            )
            for grip in log.grips
        ]
        return min(fits, key=lambda each: each.found.cost[0])

    more: tuple[str, ...] = AT_REST

    def explains(fit: Fit[TwinProblem], white: Whiteness) -> bool:
        enough = selection.even_screen_share * len(windows)
        return white.white and len(fit.problem.windows) >= enough

    fit, notes = best((*names, *more)), list[str]()
    white = whiteness(fit)
    progress(0.4)
    if explains(fit, white):
        return names, fit, white, notes
    rough = best((*names, *more), uneven=True)
    if "viscous" not in names and has_viscous_friction(rough, selection):
        more = (*more, "viscous")
        damped = best((*names, *more))
        if explains(damped, damped_white := whiteness(damped)):
            return (*names, "viscous"), damped, damped_white, [VISCOUS_NOTE]
        rough = best((*names, *more), uneven=True)
    left = whiteness(rough)
    if not white.white or (left.white and any(rough.problem.sizes)):
        fit, white = rough, left
        notes.append(
            "friction that differs from place to place, and other unknown forces, are taken as "
            "a part of the noise: without it the log is not explained; a longer log tells more"
        )
        if "viscous" in more:
            names = (*names, "viscous")
            notes.append(VISCOUS_NOTE)
    return names, fit, white, notes


def _describe_fit(
    log: Log, usable: PreparedLog, fit: Fit[TwinProblem], windows: int
) -> Iterator[str]:
    """Notes on the log and its fit; ``windows`` is the number of windows before the fit."""
    if len(usable.grips) > 1:
        kind = "softened as in the mechanism" if fit.problem.grip else "sharp as in Coulomb's law"
        yield f"friction at rest taken to be {kind}, which fits better"
    if left_out := windows - len(fit.problem.windows):
        of_all = plural(windows, "window")
        yield f"{left_out} of {of_all} left out: no replay explains the ball there"
    if not log.scenario and not log.age.any():
        yield "column age missing or zero: a wait for a frame is counted in the dead time"
    if usable.segments[0].command is None:
        yield "no commanded rates in the log: the plate is taken from its encoders alone"


def identify_twin(
    log: Log,
    names: tuple[str, ...],
    share: float = FITTED_SHARE,
    progress: Callable[[float], None] = lambda _: None,
    selection: TwinSelection = TWIN_SELECTION,
    how: HoldOutPrediction = HOLD_OUT,
) -> TwinIdentification:
    """Fit the parameters of these names to the first share of a log and try them on the rest.

    Args:
        log: The log.
        names: The requested parameters, of ``PARAMETER_CHOICES``.
        share: Share of the usable time that is fitted; 1 holds nothing out.
        progress: Called with the share of the work done.
        selection: Constants of the fit.
        how: Constants of the predictions of the held-out part.

    Raises:
        LogError: If the log is broken, or nothing can be learned from it.
    """
    check_ranges(log)
    usable = prepare(log)
    check_motion(usable)
    known, unknown = usable.split(share) if share < 1 else (usable, None)
    drives = fit_drives(known)
    lag = 0.0 if drives is None else drives.lag
    progress(0.1)
    windows = cut(known, lag, selection.max_window_s, moving_spans)
    if windows is None or len(windows) < 3:
        raise LogError(
            f"{usable.source}: too short: {known.length:.0f} s give "
            f"{plural(0 if windows is None else len(windows), 'window')} to fit, at least 3 are "
            "needed"
        )

    names, fit, white, notes = fit_windows(usable, windows, names, selection, progress)
    notes = [*usable.notes, *notes, *_describe_fit(log, usable, fit, len(windows))]
    tried = replay_log(unknown, fit, lag, how) if unknown is not None and unknown.segments else {}
    if not tried and share < 1:
        notes.append("too little left to hold out")
    progress(1.0)
    words, known_of = white.words, assess_parameters(names, fit, drives, white)
    if all(each.word != IDENTIFIED_VERDICT for each in known_of):
        notes.append(
            "nothing was identified: two minutes of the scenario excite would show more; a "
            "twin that follows a log needs no file: ballplate shadow LOG --learn"
        )
    return TwinIdentification(
        source=usable.source,
        extent=f"{usable.source}: {usable.length:.1f} usable seconds, of which {known.length:.1f} "
        f"were fitted, in {plural(len(fit.problem.windows), 'window')}; {fit.found.termination}.",
        remarks=(f"{words[0].upper()}{words[1:]}.",),
        log=usable,
        seconds=known.length,
        fit=fit,
        verdicts=known_of,
        scores=(score(tried),) if tried else (),
        predictions=tried,
        whiteness=white,
        notes=tuple(notes),
        on=rig_of(log.scenario),
        how=how,
    )
