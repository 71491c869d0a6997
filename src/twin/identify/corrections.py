"""Corrects logs by what their fits leave: clocks that drift, turned axes, gains that bend.

Each is one parameter more of a fit, which one step of it shows with its interval. What is found is
taken out of the log, and the log is fitted again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from controllers.arrays import Array
from twin.base.page import digits
from twin.identify.axis_logs import AnyLog
from twin.identify.command_model import TiltHistory
from twin.identify.further_terms import find_admixture, find_clock_drift
from twin.identify.plain_model import AxisFit

OTHER_AXIS = {"x": "y", "y": "x"}


@dataclass(frozen=True, kw_only=True)
class CorrectionSearch:
    """Constants of the search for corrections.

    Attributes:
        min_ratio: Smallest value in half-widths of its interval that is corrected.
        min_drift: Smallest drift of a clock as a share.
        min_crossed: Smallest share of the other axis's tilt.
        max_crossed: Largest one: beyond it axes are exchanged.
        min_bend: Smallest change of the gain up to the largest tilt, as a share.
        max_bend: Largest one.
    """

    min_ratio: float = 2.0
    min_drift: float = 5e-5
    min_crossed: float = 0.01
    max_crossed: float = 0.5
    min_bend: float = 0.03
    max_bend: float = 0.6


CORRECTION_SEARCH = CorrectionSearch()


@dataclass(frozen=True)
class Correction:
    """What is taken out of a log.

    Attributes:
        drift: Relative excess of the speed of the positions' clock over the commands'.
        crossed: Axis to the share of the other axis's tilt that acts along it.
        bends: Axis to the change of its gain by a unit of tilt, as a share.
        notes: The same in words.
    """

    drift: float = 0.0
    crossed: Mapping[str, float] = field(default_factory=dict)
    bends: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def apply(self, log: AnyLog) -> AnyLog:
        """The log without it: with the tilt that acts, and positions in the time of commands."""
        axes = {}
        for axis, own in log.axes.items():
            tilt, added = own.tilt, list[Array]()
            if share := self.crossed.get(axis):
                added.append(log.axes[OTHER_AXIS[axis]].tilt_at(own.time))
                tilt = tilt + share * added[-1]
            if bend := self.bends.get(axis):
                added.append(tilt * np.abs(tilt))
                tilt = tilt + bend * added[-1]
            axes[axis] = replace(own, tilt=tilt, added=tuple(added)).with_clock(self.drift)
        return replace(log, axes=axes)


def find_correction(
    fits: Mapping[str, AxisFit],
    units: Mapping[str, str],
    how: CorrectionSearch = CORRECTION_SEARCH,
) -> Correction:
    """What the fits of the axes leave of a clock, the other axis, and the tilt's square.

    Args:
        fits: Fit of each axis.
        units: Units of their tilt.
        how: Constants.
    """
    notes, bends, crossed = list[str](), dict[str, float](), dict[str, float]()
    drift, half = _mean_drift(fits)
    if fits and abs(drift) > max(how.min_ratio * half, how.min_drift):
        notes.append(describe_drift(drift, half))
    else:
        drift = 0.0
    for axis, fit in fits.items():
        other = fits.get(OTHER_AXIS[axis])
        if other and len(set(units.values())) == 1:
            share, half, _ = find_admixture(fit, other.log.tilt_at(fit.log.time))
            if how.max_crossed > abs(share) > max(how.min_ratio * half, how.min_crossed):
                crossed[axis] = share
                notes.append(describe_crossed(axis, share, half))
        most = float(np.abs(fit.log.tilt).max())
        bend, half, gain = find_admixture(fit, fit.log.tilt * np.abs(fit.log.tilt))
        if how.max_bend > abs(bend) * most > max(how.min_ratio * half * most, how.min_bend):
            bends[axis], gain = _refine_bend(fit, bend)
            bend = bends[axis]
            notes.append(describe_bend(axis, gain, gain * (1 + bend * most)))
    return Correction(drift, crossed, bends, tuple(notes))


def _refine_bend(fit: AxisFit, bend: float) -> tuple[float, float]:
    """A bend after one step more, from a fit with it, and the gain at small tilts next to it.

    One step alone leaves a tenth of it, as gain, lag and friction were fitted without.
    """
    more = fit.log.tilt * np.abs(fit.log.tilt)
    log = replace(fit.log, tilt=fit.log.tilt + bend * more)
    problem = replace(fit.problem, tilt=TiltHistory(log, fit.problem.tilt.scale))
    bent = replace(fit, problem=problem).refit(log, problem.names, fit.window_s)
    further, _, gain = find_admixture(bent, more)
    return bend + further, gain


def _mean_drift(fits: Mapping[str, AxisFit]) -> tuple[float, float]:
    """Drift of the clock of the positions by all axes, and its half-width."""
    each = [find_clock_drift(fit) for fit in fits.values()]
    weights = np.array([half**-2.0 if np.isfinite(half) and half > 0 else 0.0 for _, half in each])
    if not weights.sum():
        return 0.0, math.inf
    mean = float(weights @ [drift for drift, _ in each] / weights.sum())
    return mean, float(weights.sum() ** -0.5)


def describe_drift(drift: float, half: float) -> str:
    """A note on a clock that was corrected.

    Args:
        drift: By how much the clock of the positions is faster, as a share.
        half: Half-width of its interval.
    """
    return (
        f"the clock of the positions is {1e6 * drift:+.0f} ppm ({1e6 * (drift - half):.0f} to "
        f"{1e6 * (drift + half):.0f}) off the clock of the commands: corrected; dead times are "
        "those of the beginning of the log"
    )


def describe_crossed(axis: str, share: float, half: float) -> str:
    """A note on an axis along which the tilt of the other one acts, too.

    Args:
        axis: x or y.
        share: Of the other axis's tilt.
        half: Half-width of its interval.
    """
    turned = math.degrees(math.atan(abs(share)))
    return (
        f"{axis}: the tilt of the other axis acts along it by {share:+.3f} ({share - half:.3f} to "
        f"{share + half:.3f}), as of axes that are turned by {turned:.1f} deg: corrected"
    )


def describe_bend(axis: str, small: float, large: float) -> str:
    """A note on a gain that changes with the tilt.

    Args:
        axis: x or y.
        small: Gain at small tilts.
        large: Gain at the largest tilt.
    """
    return (
        f"{axis}: the gain is {digits(small)} at small tilts and {digits(large)} at the largest: "
        "corrected to the gain at small tilts"
    )
