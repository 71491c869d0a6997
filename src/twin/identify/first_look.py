"""First look at an axis in a second: gain, delay and level by the weak form, without simulation.

Windows in which the ball rolls in one direction show them best. Where too few of them show
anything, longer windows of any motion show gain, level and damping, as a plain linear model has
them, or friction and camber instead. How far the variants of such a model differ is how far it is
in error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from twin.base.errors import plural
from twin.base.page import digits
from twin.identify.axis_logs import AxisLog
from twin.identify.weak_form import WEAK_FORM, WeakForm, WeakGrid, WeakWindows, make_grids


@dataclass(frozen=True, kw_only=True)
class FirstLook:
    """Result of a first look at an axis.

    Attributes:
        gain: Acceleration of the ball by the tilt, in m/s^2 by its unit.
        gain_std: Its standard deviation.
        delay: Dead time and lag together, s.
        delay_std: Its standard deviation.
        level: m/s^2.
        level_std: Its standard deviation.
        friction: m/s^2.
        friction_std: Its standard deviation.
        camber: 1/s^2.
        camber_std: Its standard deviation.
        damping: 1/s.
        damping_std: Its standard deviation.
        windows: Number of windows that are used.
        plain: Whether they hold any motion; else the ball rolls in one direction in each.
        explained: Share of the variance of the left side that the equation explains.
        at_ends: Share of the time in which the ball is at an end stop.
        drift: By how much the clock of the positions is faster than that of the commands.
        drift_std: Its standard deviation.
        terms: What the model has next to gain, delay and level: damping, friction, camber.
    """

    gain: float
    gain_std: float
    delay: float
    delay_std: float
    level: float
    level_std: float
    friction: float
    friction_std: float
    camber: float
    camber_std: float
    damping: float
    damping_std: float
    windows: int
    plain: bool
    explained: float
    at_ends: float
    drift: float
    drift_std: float
    terms: tuple[str, ...]

    @property
    def misfit(self) -> float:
        """Twice the negative logarithm of the likelihood, but for a constant of the windows."""
        return self.windows * float(np.log(max(1 - self.explained, 1e-12)))

    def drifts(self, how: WeakForm = WEAK_FORM) -> bool:
        """Whether the clock of the positions goes at a different speed."""
        return abs(self.drift) > max(how.min_drift_stds * self.drift_std, how.min_drift)

    def describe(self, axis: str, unit: str) -> str:
        """In a sentence.

        Args:
            axis: Its name.
            unit: Unit of the tilt.
        """
        ends = f"; {100 * self.at_ends:.0f} % at an end stop" if self.at_ends else ""
        rolls = "of any motion, by a plain model" if self.plain else "of a ball that rolls freely"
        without = " without friction, which makes the gain small" if self.plain else ""
        return (
            f"first look, {axis}: gain {digits(self.gain)} +- {digits(2 * self.gain_std)} m/s^2 by "
            f"{unit}, dead time + lag {self.delay:.2f} s, level {digits(self.level)} +- "
            f"{digits(2 * self.level_std)} m/s^2, from {plural(self.windows, 'window')} "
            f"{rolls}{without}; +- is scatter alone{ends}"
        )


def look_first(log: AxisLog, how: WeakForm = WEAK_FORM) -> FirstLook | None:
    """Gain, delay and level of an axis; None if too few windows show them.

    Args:
        log: The axis.
        how: Constants.
    """
    linear = look_linearly(make_grids(log, how.plain_windows_s, how))
    return look_at_rolling(log, how) or next(iter(linear), None)


def look_plainly(
    log: AxisLog,
    window_s: float,
    how: WeakForm = WEAK_FORM,
    terms: tuple[str, ...] = ("damping",),
) -> FirstLook | None:
    """A model of an axis by windows of any motion; None if they do not show it.

    Args:
        log: The axis.
        window_s: Length of the windows.
        how: Constants.
        terms: Terms next to gain, delay and level: damping, friction, camber.
    """
    return _look(log, window_s, how, terms, rolling=False)


def look_at_rolling(
    log: AxisLog, how: WeakForm = WEAK_FORM, terms: tuple[str, ...] = ("friction", "camber")
) -> FirstLook | None:
    """Gain, delay, level and terms by windows of a ball that rolls in one direction.

    None if too few of them show these.

    Args:
        log: The axis.
        how: Constants.
        terms: Terms next to gain, delay and level: friction, camber.
    """
    return _look(log, how.window_s, how, terms, rolling=True)


def _look(
    log: AxisLog, window_s: float, how: WeakForm, terms: tuple[str, ...], *, rolling: bool
) -> FirstLook | None:
    """A look by windows of one kind and length; None if they do not show anything."""
    for grid in make_grids(log, (window_s,), how):
        if windows := WeakWindows.of(grid, rolling=rolling):
            return _look_at(windows, terms, grid.lever)
    return None


def look_linearly(grids: Sequence[WeakGrid]) -> list[FirstLook]:
    """The plain linear model of an axis by windows of several lengths, with damping and without.

    The first is the best: with damping only where it is significant. No damping is negative. How
    far they differ is how far the model is in error.

    Args:
        grids: Of a log, one for each length.
    """
    found = []
    for windows in _find_windows(grids):
        both = [_look_at(windows, terms, windows.grid.lever) for terms in (("damping",), ())]
        each = [look for look in both if look and look.damping >= 0]
        least = windows.grid.how.min_damping_stds
        weak = len(each) > 1 and each[0].damping < least * each[0].damping_std
        found += each[::-1] if weak else each
    return found


def look_at_moving(grids: Sequence[WeakGrid]) -> list[FirstLook]:
    """Looks by windows of any motion in which the ball hardly rests.

    Friction of a ball at rest balances the tilt, and so makes the gain of other windows small.

    Args:
        grids: Of a log, one for each length.
    """
    looks = [
        _look_at(windows, terms, windows.grid.lever)
        for grid in grids
        for share in grid.how.moving_slow_shares
        if (windows := WeakWindows.of(grid, rolling=False, max_slow_share=share))
        for terms in (("friction", "camber"), ("damping",))
    ]
    return [look for look in looks if look and look.damping >= 0]


def look_with_levers(grids: Sequence[WeakGrid], levers: Sequence[float]) -> list[FirstLook]:
    """Looks with friction and camber by windows of any motion, with levers that explain them.

    The plate's acceleration moves a ball that is a lever above its axis: x'' = gain (u - lever u''
    / g). Where a log hardly shows the lever, it does not show the gain of a quick motion either.

    Args:
        grids: Of a log, one for each length.
        levers: Those that are tried, rising, m.

    Returns:
        For windows of each length the looks whose lever no likelihood ratio rejects and those next
        to them, as the true lever lies between two; the best one first.
    """
    found = []
    for windows in _find_windows(grids):
        every = [_look_at(windows, ("friction", "camber"), lever) for lever in levers]
        found += _keep_possible(every, windows.grid.how)
    return found


def look_at_any_motion(
    log: AxisLog, levers: Sequence[float], how: WeakForm = WEAK_FORM
) -> list[FirstLook]:
    """Looks by windows of any motion, first the one that explains them best for its terms.

    With damping and without, with friction, camber and the levers that explain them, and by those
    windows alone in which the ball hardly rests. How far they differ is how far a model is in
    error, or the log does not show a number.

    Args:
        log: The axis.
        levers: Those that are tried, rising, m.
        how: Constants.
    """
    grids = make_grids(log, how.plain_windows_s, how)
    linear, rubbed = look_linearly(grids), look_with_levers(grids, levers)
    moving = look_at_moving(grids)
    if not linear or not rubbed:
        return linear + rubbed + moving
    # by Bayes's information criterion; a lever is a term as well
    criteria = [
        each.misfit + (len(each.terms) + lever) * np.log(each.windows)
        for each, lever in ((linear[0], 0), (rubbed[0], log.lever is None))
    ]
    best = linear + rubbed if criteria[0] <= criteria[1] else rubbed + linear
    return best + moving


def look_at_rolling_in_several_ways(
    log: AxisLog, levers: Sequence[float], how: WeakForm = WEAK_FORM
) -> list[FirstLook]:
    """Looks at a ball that rolls in one direction by windows of several lengths, the usual first.

    Each with friction and camber, without camber, and with the levers that explain them. How far
    they differ is how far the model is in error.

    Args:
        log: The axis.
        levers: Those that are tried, rising, m; that of the log is one of them.
        how: Constants.
    """
    found = []
    for grid in make_grids(log, (how.window_s, *how.rolling_windows_s), how):
        if windows := WeakWindows.of(grid, rolling=True):
            every = [_look_at(windows, ("friction", "camber"), each) for each in levers]
            plain = every[levers.index(grid.lever)], _look_at(windows, ("friction",), grid.lever)
            found += [*filter(None, plain), *_keep_possible(every, how)]
    return found


def _find_windows(grids: Sequence[WeakGrid]) -> Iterator[WeakWindows]:
    """Windows of any motion of each grid that has enough of them."""
    for grid in grids:
        if windows := WeakWindows.of(grid, rolling=False):
            yield windows


def _keep_possible(every: Sequence[FirstLook | None], how: WeakForm) -> list[FirstLook]:
    """Of looks with rising levers those no likelihood ratio rejects and their neighbours, sorted.

    Args:
        every: The looks, None where there is none.
        how: Constants.
    """
    if not any(every):
        return []
    misfits = np.array([each.misfit if each else np.inf for each in every])
    may_be = (misfits - misfits.min() < how.max_likelihood_ratio).astype(np.uint8)
    near = maximum_filter1d(may_be, 3, mode="nearest") > 0
    return [look for k in np.argsort(misfits).tolist() if near[k] and (look := every[k])]


def _look_at(windows: WeakWindows, terms: tuple[str, ...], lever: float) -> FirstLook | None:
    """The look of some terms with a lever in m; None if the windows do not show it.

    Args:
        windows: Of one kind.
        terms: Terms next to gain, delay and level: damping, friction, camber.
        lever: m.
    """
    grid, found, how = windows.grid, windows.solve(terms, lever), windows.grid.how
    if found is None:
        return None
    enough = found.independent >= how.min_windows
    explains = 1 - found.explained <= how.max_residual_share**2
    if not (enough and explains and abs(found.values[0]) > how.min_gain_stds * found.stds[0]):
        return None
    names = ("level", *terms)
    value = dict(zip(names, found.values[1:].tolist(), strict=False))
    std = dict(zip(names, found.stds[1:].tolist(), strict=False))
    rub = max(value.get("friction", 0.0), 0.0)
    at_ends = 0.0
    if windows.rolling:
        # an end stop holds the ball against the tilt; where it only turns, the tilt pushes it back
        tilt = grid.tilt.at(grid.time - found.delay, found.lag, 0.0, 0.0, 0.0, lever)
        push = found.values[0] * tilt + value["level"] + value.get("camber", 0.0) * grid.ball
        low, high = windows.near
        at_ends = float(((low & (push < -rub)) | (high & (push > rub))).mean())
    return FirstLook(
        gain=float(found.values[0]) / grid.tilt.scale,
        gain_std=float(found.stds[0]) / grid.tilt.scale,
        delay=found.delay + found.lag,
        delay_std=max(found.delay_std, how.step_s / 2),
        level=value["level"],
        level_std=std["level"],
        friction=rub,
        friction_std=std.get("friction", 0.0),
        camber=value.get("camber", 0.0),
        camber_std=std.get("camber", 0.0),
        damping=value.get("damping", 0.0),
        damping_std=std.get("damping", 0.0),
        windows=round(found.independent),
        plain=not windows.rolling,
        explained=found.explained,
        at_ends=at_ends if at_ends > how.min_end_share else 0.0,
        drift=found.drift[0],
        drift_std=found.drift[1],
        terms=terms,
    )
