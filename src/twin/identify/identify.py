"""From a log to fitted parameters, their intervals, and what they are worth on the rest of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.identify.columns import LogError
from twin.identify.drives import fit_drives
from twin.identify.holdout import Horizons, hold_out
from twin.identify.log import Log
from twin.identify.parameters import fitted
from twin.identify.plausible import check_motion, check_ranges
from twin.identify.prepare import Data, prepare
from twin.identify.scores import Estimate, estimate
from twin.identify.search import Fit, cut, search
from twin.identify.verdict import Verdict, verdicts
from twin.identify.whiteness import Whiteness, whiteness

SHARE = 2 / 3
"""Share of the usable time that is fitted; the rest is held out."""


@dataclass(frozen=True)
class Identification:
    """What a log told.

    Attributes:
        data: What of it was used.
        fitted_time: Seconds of it that were fitted.
        fit: The best fit.
        verdicts: The parameters asked for.
        horizons: Replay error on the part held out.
        whiteness: What the fit leaves over.
        notes: What had to be left out or supposed, in words.
    """

    data: Data
    fitted_time: float
    fit: Fit
    verdicts: tuple[Verdict, ...]
    horizons: Horizons | None
    whiteness: Whiteness
    notes: tuple[str, ...]


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
        progress: Told the share of the work done.

    Raises:
        LogError: If the log is broken, or nothing can be learned from it.
    """
    check_ranges(log)
    data = prepare(log)
    check_motion(data)
    known, unknown = data.split(share) if share < 1 else (data, None)
    drives = fit_drives(known)
    lag = 0.0 if drives is None else float(drives.value[0])
    progress(0.1)
    windows = cut(known, lag)
    if windows is None or len(windows) < 3:
        raise LogError(
            f"{data.source}: too short: {known.length:.0f} s give "
            f"{0 if windows is None else len(windows)} windows to fit, at least 3 are needed"
        )
    fits = []
    for grip in data.grips:
        fits.append(search(data.model, windows, fitted(names), grip))
        progress(0.1 + 0.8 * len(fits) / len(data.grips))
    fit = min(fits, key=lambda each: each.costs[0])
    notes = list(data.notes)
    if len(fits) > 1:
        kind = "softened as in the mechanism" if fit.problem.grip else "sharp as in Coulomb's law"
        notes.append(f"friction at rest taken to be {kind}, which fits better")
    if fit.left_out:
        notes.append(
            f"{fit.left_out} of {len(windows)} windows left out: no replay explains the ball there"
        )
    if data.stretches[0].command is None:
        notes.append("no commanded rates in the log: the plate is taken from its encoders alone")
    horizons = None
    if unknown is not None and unknown.stretches:
        horizons = hold_out(unknown, fit, lag)
    if horizons is None and share < 1:
        notes.append("too little left to hold out")
    progress(1.0)
    return Identification(
        data=data,
        fitted_time=known.length,
        fit=fit,
        verdicts=verdicts(names, fit, bootstrap(fit), drives),
        horizons=horizons,
        whiteness=whiteness(fit),
        notes=tuple(notes),
    )


def bootstrap(fit: Fit) -> Estimate:
    """The fit with what chance leaves open, window by window."""
    free, _ = fit.linear.eliminate()
    r, J = free[0, ..., 0], free[0, ..., 1:]  # noqa: N806
    weight = fit.problem.weights(fit.linear.r)[0]
    return estimate(
        fit.theta,
        np.einsum("wmi,wmj,w->wij", J, J, weight),
        np.einsum("wmi,wm,w->wi", J, r, weight),
    )
