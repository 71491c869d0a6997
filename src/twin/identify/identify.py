"""From a log to fitted parameters, their intervals, and what they are worth on the rest of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from twin.errors import LogError
from twin.identify.judged import Identified, replayed, score
from twin.identify.log import Log
from twin.identify.log_checks import check_motion, check_ranges
from twin.identify.parameters import SHARE, fitted
from twin.identify.plate_motion import fit_drives
from twin.identify.prepare import PreparedLog, prepare
from twin.identify.search import BestFit, search
from twin.identify.verdict import Whiteness, verdicts, whiteness
from twin.identify.windows import cut, moving_spans

LONGEST = 2.5
"""Longest window in s: long enough for friction to add up, short enough to forget a bad start."""


@dataclass(frozen=True, kw_only=True)
class Identification(Identified):
    """What a log shows.

    Attributes:
        log: The part of it that was used.
        fit: The best fit.
        whiteness: What the fit leaves over.
    """

    log: PreparedLog
    fit: BestFit
    whiteness: Whiteness

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
            "fit": asdict(self.fit.termination),
        }


def identify(
    log: Log,
    names: tuple[str, ...],
    share: float = SHARE,
    progress: Callable[[float], None] = lambda _: None,
) -> Identification:
    """Fit the parameters of these names to the first share of a log and try them on the rest.

    Args:
        log: The log.
        names: What is asked for, from ``parameters.CHOICES``.
        share: Share of the usable time that is fitted; 1 holds nothing out.
        progress: Called with the share of the work done.

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
    windows = cut(known, lag, LONGEST, moving_spans)
    if windows is None or len(windows) < 3:
        raise LogError(
            f"{usable.source}: too short: {known.length:.0f} s give "
            f"{0 if windows is None else len(windows)} windows to fit, at least 3 are needed"
        )
    fits = []
    for grip in usable.grips:
        fits.append(search(usable.model, windows, fitted(names), grip))
        progress(0.1 + 0.8 * len(fits) / len(usable.grips))
    fit = min(fits, key=lambda each: each.cost)
    notes, white = list(usable.notes), whiteness(fit)
    if not white.white and "viscous" not in names:
        richer = search(usable.model, windows, fitted((*names, "viscous")), fit.problem.grip)
        if whiteness(richer).white:
            fit, white, names = richer, whiteness(richer), (*names, "viscous")
            notes.append("viscous friction fitted along: without it the log is not explained")
    if len(fits) > 1:
        kind = "softened as in the mechanism" if fit.problem.grip else "sharp as in Coulomb's law"
        notes.append(f"friction at rest taken to be {kind}, which fits better")
    if fit.left_out:
        notes.append(
            f"{fit.left_out} of {len(windows)} windows left out: no replay explains the ball there"
        )
    if not log.scenario and not log.age.any():
        notes.append("no column age: the wait for a frame is counted in the dead time")
    if usable.segments[0].command is None:
        notes.append("no commanded rates in the log: the plate is taken from its encoders alone")
    tried = replayed(unknown, fit, lag) if unknown is not None and unknown.segments else {}
    if not tried and share < 1:
        notes.append("too little left to hold out")
    progress(1.0)
    return Identification(
        source=usable.source,
        log=usable,
        seconds=known.length,
        fit=fit,
        verdicts=verdicts(names, fit, drives, white=white.white),
        scores=(score(tried),) if tried else (),
        predictions=tried,
        whiteness=white,
        notes=tuple(notes),
    )
