"""First look at an axis in a second: gain, delay and level by the weak form, without simulation.

Windows in which the ball rolls in one direction show them best. Where too few of them show
anything, longer windows of any motion show gain, level and damping, as a plain linear model has
them, or friction and camber instead. How far the variants of such a model differ is how far it is
in error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from controllers.arrays import Array, Mask
from twin.base.errors import plural
from twin.base.page import digits
from twin.identify.axis_fitting import AXIS_FITTING
from twin.identify.axis_logs import AxisLog
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.weak_form import (
    WEAK_FORM,
    Linkage,
    WeakForm,
    WeakGrid,
    WeakWindows,
    make_grids,
)


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
        drift: Relative excess of the speed of the positions' clock over the commands'.
        drift_std: Its standard deviation.
        terms: What the model has next to gain, delay and level: damping, friction, camber.
        linkage: Lever and play that it is made with.
        residuals: Of the equation in all windows of this kind and length, shape (R,).
        kept: Those that are used; others are outliers, shape (R,).
        variants: Looks by other windows, terms, levers and plays. How far they differ from this one
            is how far its model is in error, or the log leaves a number open.
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
    linkage: Linkage
    residuals: Array = field(repr=False, compare=False)
    kept: Mask = field(repr=False, compare=False)
    variants: tuple[FirstLook, ...] = field(default=(), repr=False, compare=False)

    def drifts(self, how: WeakForm = WEAK_FORM) -> bool:
        """Whether the clock of the positions goes at a different speed."""
        return abs(self.drift) > max(how.min_drift_stds * self.drift_std, how.min_drift)

    def interval(self, name: str) -> tuple[float, float]:
        """The 95 % interval of a number; it holds the intervals of all variants with this number.

        Args:
            name: gain, delay, level, or one of the terms.
        """
        ends = [
            getattr(each, name) + sign * getattr(each, f"{name}_std")
            for each in (self, *self.variants)
            if name not in self.terms or name in each.terms
            for sign in (-2, 2)
        ]
        return min(ends), max(ends)

    def describe(self, axis: str, unit: str) -> str:
        """In a sentence.

        Args:
            axis: Its name.
            unit: Unit of the tilt.
        """
        ends = f"; {100 * self.at_ends:.0f} % at an end stop" if self.at_ends else ""
        rolls = "of any motion, by a plain model" if self.plain else "of a ball that rolls freely"
        rubs = "friction" in self.terms
        without = "" if rubs else " without friction, which makes the gain small"
        spans = map(self.interval, ("gain", "delay", "level"))
        gain, delay, level = (" to ".join(digits(end, places=3) for end in span) for span in spans)
        return (
            f"first look, {axis}: gain {gain} m/s^2 by {unit} (best {digits(self.gain)}), "
            f"dead time + lag {delay} s, level {level} m/s^2, from "
            f"{plural(self.windows, 'window')} {rolls}{without}; these 95 % intervals hold windows "
            f"of several lengths, friction, camber, damping, play and the height of the ball{ends}"
        )


def look_first(log: AxisLog, how: WeakForm = WEAK_FORM) -> FirstLook | None:
    """Gain, delay and level of an axis, with variants; None if too few windows show them.

    Args:
        log: The axis.
        how: Constants.
    """
    tried = find_possible_linkages(log)
    looks = look_at_rolling_in_several_ways(log, tried, how)
    return join_looks(looks or look_at_any_motion(log, tried, how))


@dataclass(frozen=True)
class TriedLinkages:
    """Linkages that are tried for a log.

    Attributes:
        levers: Rising, m, the lever of the log among them.
        plays: Half the widths of a gap, rising from none, in swings of the tilt.
    """

    levers: Sequence[float] = (0.0,)
    plays: Sequence[float] = (0.0,)

    def around(self, linkage: Linkage, *, aslant: bool = True) -> set[Linkage]:
        """A linkage and those next to it.

        Args:
            linkage: One of those that are tried.
            aslant: Whether with those of which both lever and play differ.
        """
        levers, plays = (
            line[max(at - 1, 0) : at + 2]
            for line, at in (
                (self.levers, self.levers.index(linkage.lever)),
                (self.plays, self.plays.index(linkage.play)),
            )
        )
        return {
            Linkage(lever, play)
            for lever in levers
            for play in plays
            if aslant or linkage.lever == lever or linkage.play == play
        }


def find_possible_linkages(log: AxisLog) -> TriedLinkages:
    """All that a rig may have: any lever, or a given one within a ruler's error; and any play.

    No play lies between a measured angle and the ball.
    """
    plays = PLAIN_PARAMETERS["play"].tried if log.held else (0.0,)
    if log.lever is None:
        return TriedLinkages(PLAIN_PARAMETERS["lever"].tried, plays)
    error = 2 * AXIS_FITTING.drives.height_std_m
    return TriedLinkages((log.lever - error, log.lever, log.lever + error), plays)


def join_looks(looks: Sequence[FirstLook]) -> FirstLook | None:
    """The first of several looks, with the others as its variants; None without any."""
    return replace(looks[0], variants=tuple(looks[1:])) if looks else None


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
            return _look_at(windows, terms, grid.linkage)
    return None


def look_linearly(windows: WeakWindows) -> list[FirstLook]:
    """The plain linear model of an axis, with damping and without, the better one first.

    With damping only where it is significant. No damping is negative. How far the two differ is how
    far the model is in error.

    Args:
        windows: Of any motion.
    """
    both = [_look_at(windows, terms, windows.grid.linkage) for terms in (("damping",), ())]
    found = [look for look in both if look and look.damping >= 0]
    least = windows.grid.how.min_damping_stds
    weak = len(found) > 1 and found[0].damping < least * found[0].damping_std
    return found[::-1] if weak else found


def look_at_moving(grids: Sequence[WeakGrid], tried: TriedLinkages) -> list[FirstLook]:
    """Looks by windows of any motion in which the ball hardly rests.

    Friction of a ball at rest balances the tilt, and so makes the gain of other windows small.

    Args:
        grids: Of a log, one for each length.
        tried: Linkages.
    """
    looks = list[FirstLook]()
    for grid in grids:
        for share in grid.how.moving_slow_shares:
            if windows := WeakWindows.of(grid, rolling=False, max_slow_share=share):
                looks += _look_with_friction(windows, tried)
                damped = _look_at(windows, ("damping",), grid.linkage)
                looks += [damped] if damped and damped.damping >= 0 else []
    return looks


def look_with_linkages(
    windows: WeakWindows,
    tried: TriedLinkages,
    known: Mapping[Linkage, FirstLook | None] = MappingProxyType({}),
) -> list[FirstLook]:
    """Looks with friction and camber, with the levers and plays that explain the windows.

    The plate's acceleration moves a ball that is a lever above its axis: x'' = gain (u - lever u''
    / g). Behind a gap the plate moves by less than the command, and later. Where a log hardly shows
    these, it does not show the gain either. A play makes up for a part of a lever, so both are
    sought together. All levers without play and all plays with the lever of the log are tried, and
    then what lies next to each linkage that explains the windows, until no new one explains them.
    Of so many, one explains some windows by chance: there is none where the linkage of the log
    shows nothing.

    Args:
        windows: Of one kind.
        tried: Linkages.
        known: Looks that are not repeated, by their linkages.

    Returns:
        The looks with a linkage that no likelihood ratio rejects, and with those next to the best
        one, as the true one may lie between two; the best one first.
    """
    own, most = windows.grid.linkage, windows.grid.how.max_likelihood_ratio
    looks = dict(known) or {own: _look_at(windows, ("friction", "camber"), own)}
    if not looks[own]:
        return []
    wanted = {own._replace(lever=each) for each in tried.levers}
    wanted |= {own._replace(play=each) for each in tried.plays}
    while True:
        fresh = sorted(wanted - looks.keys())
        looks |= {each: _look_at(windows, ("friction", "camber"), each) for each in fresh}
        misfits = dict(zip(looks, find_misfits(list(looks.values())).tolist(), strict=True))
        least = min(misfits.values())
        possible = [each for each, misfit in misfits.items() if misfit < least + most]
        wanted = {other for each in possible for other in tried.around(each)}
        if wanted <= looks.keys():
            break
    best = min(possible, key=misfits.__getitem__)
    near = {*possible, *tried.around(best, aslant=False)}
    return [look for each in sorted(near, key=misfits.__getitem__) if (look := looks[each])]


def look_at_any_motion(
    log: AxisLog, tried: TriedLinkages, how: WeakForm = WEAK_FORM
) -> list[FirstLook]:
    """Looks by windows of any motion, first the one that explains them best for its terms.

    With damping and without, with friction, camber and the linkages that explain them, and by those
    windows alone in which the ball hardly rests. How far they differ is how far a model is in
    error, or the log does not show a number. Where the ball sticks in most windows, those in which
    it hardly rests come first, and there is no look without them.

    Args:
        log: The axis.
        tried: Linkages.
        how: Constants.
    """
    grids, found, sticks = make_grids(log, how.plain_windows_s, how), list[FirstLook](), False
    for grid in grids:
        if windows := WeakWindows.of(grid, rolling=False):
            found += _put_best_first(look_linearly(windows), look_with_linkages(windows, tried))
            sticks = sticks or windows.sticks
    moving = look_at_moving(grids, tried)
    # damping does not stand for what holds a ball
    return (
        sorted(moving, key=lambda look: "friction" not in look.terms) if sticks else found + moving
    )


def look_at_rolling_in_several_ways(
    log: AxisLog, tried: TriedLinkages, how: WeakForm = WEAK_FORM
) -> list[FirstLook]:
    """Looks at a ball that rolls in one direction by windows of several lengths, the usual first.

    Each with friction and camber, without camber, with damping in its place, and with the linkages
    that explain them. How far they differ is how far the model is in error.

    Args:
        log: The axis.
        tried: Linkages.
        how: Constants.
    """
    found = []
    for grid in make_grids(log, (how.window_s, *how.rolling_windows_s), how):
        if windows := WeakWindows.of(grid, rolling=True):
            found += _look_with_friction(windows, tried, (("friction",), ("friction", "damping")))
    return found


def _look_with_friction(
    windows: WeakWindows, tried: TriedLinkages, others: Sequence[tuple[str, ...]] = ()
) -> list[FirstLook]:
    """Looks with friction and camber and the linkages that explain the windows, the best one first.

    Args:
        windows: Of one kind.
        tried: Linkages.
        others: Further terms, which are tried with the linkage of the log.
    """
    own, several = windows.grid.linkage, (("friction", "camber"), *others)
    usual = [_look_at(windows, terms, own) for terms in several]
    linked = look_with_linkages(windows, tried, {own: usual[0]})
    possible = [look for look in usual if look and look.damping >= 0]
    return _put_best_first(possible, linked)


def _put_best_first(usual: list[FirstLook], with_linkages: list[FirstLook]) -> list[FirstLook]:
    """Looks at the same windows, the kind first that explains them best for its number of terms.

    By Bayes's information criterion. A lever or play that the others lack is a term as well.

    Args:
        usual: With the linkage of the log.
        with_linkages: With those that are possible.
    """
    if not usual or not with_linkages:
        return usual + with_linkages
    pair = usual[0], with_linkages[0]
    more = np.not_equal(pair[1].linkage, pair[0].linkage).sum()
    terms = np.array([len(pair[0].terms), len(pair[1].terms) + more])
    plain, linked = find_misfits(pair) + terms * np.log(min(each.windows for each in pair))
    return usual + with_linkages if plain <= linked else with_linkages + usual


def find_misfits(looks: Sequence[FirstLook | None]) -> Array:
    """Twice the negative logarithms of the likelihoods of looks at the same windows.

    But for a constant that is the same for all. A window counts unless it is an outlier of every
    look: one that only some explain is evidence for these. Windows overlap: as many count as fit
    end to end.

    Args:
        looks: Of windows of one kind and length, L of them, None where there is none.

    Returns:
        Shape (L,); infinite where there is no look.
    """
    there = [each for each in looks if each]
    known = np.any([each.kept for each in there], axis=0)
    count = there[0].windows * known.sum() / there[0].kept.sum()
    return np.array(
        [count * np.log((each.residuals[known] ** 2).mean()) if each else np.inf for each in looks]
    )


def _look_at(windows: WeakWindows, terms: tuple[str, ...], linkage: Linkage) -> FirstLook | None:
    """The look of some terms with a linkage; None if the windows do not show it.

    Args:
        windows: Of one kind.
        terms: Terms next to gain, delay and level: damping, friction, camber.
        linkage: Lever and play.
    """
    grid, found, how = windows.grid, windows.solve(terms, linkage), windows.grid.how
    if found is None:
        return None
    enough = found.independent >= how.min_windows
    explains = 1 - found.explained <= how.max_residual_share**2
    if not (enough and explains and abs(found.values[0]) > how.min_gain_stds * found.stds[0]):
        return None
    names = ("level", *terms)
    value = dict(zip(names, found.values[1:].tolist(), strict=False))
    std = dict(zip(names, found.stds[1:].tolist(), strict=False))
    rub = value.get("friction", 0.0)
    at_ends = 0.0
    if windows.rolling:
        # an end stop holds the ball against the tilt; where it only turns, the tilt pushes it back
        tilt = grid.delayed_tilt(found.delay, found.lag, linkage)
        push = found.values[0] * tilt + value["level"] + value.get("camber", 0.0) * grid.ball
        low, high = windows.near
        at_ends = float(((low & (push < -rub)) | (high & (push > rub))).mean())
    return FirstLook(
        gain=float(found.values[0]) / grid.scale,
        gain_std=float(found.stds[0]) / grid.scale,
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
        linkage=linkage,
        residuals=found.residuals,
        kept=found.kept,
    )
