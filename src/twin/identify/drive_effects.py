"""Dead band, play, slew and lever: fitted value by value, and profiled for the intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.identify.command_model import DRIVE_EFFECTS, residual_by_dead_band
from twin.identify.least_squares import fit_starts, minimise
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.plain_model import AxisFit, set_lags
from twin.identify.profiles import Profile


def profile(
    fit: AxisFit, name: str, values: Sequence[float] | Array, *, thorough: bool = True
) -> Profile:
    """Fits with a parameter at each of K rising values, begun from one fit.

    Args:
        fit: From which they begin.
        name: The parameter.
        values: Its values.
        thorough: Whether fits converge, and a fit of a lever with a lag is also begun from the fits
            at the neighbouring values, of which the best one is kept: a ball that sticks for a
            moment has many local minima. Else the fits only show which value is near the best.
    """
    names = tuple(dict.fromkeys((*fit.problem.names, name)))
    problem, at, K = replace(fit.problem, names=names), names.index(name), len(values)  # noqa: N806
    theta = np.array([[fit.value(each) for each in names]]).repeat(K, axis=0)
    starts, costs = fit.found.starts.repeat(K, axis=1), np.full((K, 1), np.inf)
    own = int(np.abs(np.subtract(values, theta[0, at])).argmin())
    hides = name == "lever" and "lag" in names
    for offset in (0, 1, -1) if hides and thorough else (0,):
        source = np.clip(np.arange(K) + offset, 0, K - 1)
        guess = theta[source]
        guess[:, at] = values
        if hides:  # to second order lag^2 / 2 - lever / g shows, and the sum of lag and dead time
            more = 2 / BallPlate.gravity * (guess[:, at] - theta[source, at])
            lags = np.sqrt(np.maximum(guess[:, names.index("lag")] ** 2 + more, 1e-6))
            guess = set_lags(guess, names, lags, problem.delays)
        begin = fit_starts(problem, guess, starts[:, source], 4)
        steps = 12 if thorough else 6
        found = minimise(problem, guess, begin, steps, 2, 2, fit.how.search.control)
        each = problem.costs(found.linearisation.r)
        better = each.sum(axis=1, keepdims=True) < costs.sum(axis=1, keepdims=True)
        theta, costs = np.where(better, found.theta, theta), np.where(better, each, costs)
        starts = np.where(better, found.starts, starts)
    known = name == "lever" and fit.log.lever is not None
    return Profile(name, names, theta, costs, own, known, fit.how.drives)


def profile_contenders(fit: AxisFit, name: str, values: Sequence[float]) -> Profile:
    """As ``profile``, without values that no draw takes.

    If the fit explains its log, the cost is taken to rise beyond a value that is rejected. If not,
    a part of the windows rejects values; all of the windows reject them more clearly.
    """
    if fit.explained:
        return _profile_bracket(fit, name, values)
    how, count = fit.how.drives, len(fit.problem.windows)
    if count >= 2 * how.scan_windows:
        some = np.zeros(count, bool)
        some[np.linspace(0, count - 1, how.scan_windows).round().astype(int)] = True
        takes = profile(fit.take(some), name, values).contenders
        values = [value for value, taken in zip(values, takes, strict=True) if taken]
    return profile(fit, name, values)


def _profile_bracket(fit: AxisFit, name: str, values: Sequence[float]) -> Profile:
    """As ``profile``, of the values about the fitted one up to the first that no draw takes."""
    own = int(np.abs(np.subtract(values, fit.value(name))).argmin())
    low, high, more = max(own - 2, 0), own + 3, 2
    found = profile(fit, name, values[low:high])
    while True:
        below, above = found.closed
        fresh = [*([] if below else values[max(low - more, 0) : low])]
        fresh += [] if above else values[high : high + more]
        if not fresh:
            return found
        low, high, more = max(low - more, 0), high + more, 2 * more
        found = found.join(profile(fit, name, fresh))


def add_drive_effects(
    fit: AxisFit, longest: float, tell: Callable[[str], object] = lambda _: None
) -> AxisFit:
    """The fit with what the log shows of its drives: dead band, play, slew.

    Each is fitted alone, and the one that explains the same windows best is taken; others that
    explain them nearly as well are its rivals. Then further ones are added to it.

    Args:
        fit: Without them.
        longest: Length of the windows in s.
        tell: Called with the name of each before it is fitted.
    """
    if fit.explained:
        return fit
    tilt, how = fit.problem.tilt, fit.how.drives
    dead_time, lag = fit.value("dead_time"), fit.value("lag")
    rest = residual_by_dead_band(tilt, fit.problem.windows, dead_time, lag, how.scan)
    few = np.argsort(rest)[: how.fitted_dead_bands]
    few = np.sort(few[rest[few] < how.dead_band_residual_share * rest[0]])
    values = {name: np.array(PLAIN_PARAMETERS[name].tried) for name in tilt.tried}
    if "dead_band" in values:
        values["dead_band"] = np.array(how.scan.dead_bands)[few]

    def accepts(other: AxisFit, name: str, own: AxisFit) -> bool:
        return other.value(name) != 0 and other.sigma < how.accepted_residual_share * own.sigma

    alone = {}
    for name, each in values.items():
        tell(name)
        alone[name] = _fit_effect(fit, name, each, longest)
    alone = {name: each for name, each in alone.items() if accepts(each, name, fit)}
    if not alone:
        return fit
    best = min(alone, key=lambda name: alone[name].sigma)
    found = alone[best]
    rivals = tuple(
        (name, each.value(name))
        for name, each in alone.items()
        if {name, best} <= set(DRIVE_EFFECTS)
        and name != best
        and each.sigma < how.rival_residual_ratio * found.sigma
    )
    for name, each in values.items():
        if name != best and not found.explained:
            tell(name)
            other = _fit_effect(found, name, each, longest)
            found = other if accepts(other, name, found) else found
    return replace(found, rivals=rivals)


def _fit_effect(fit: AxisFit, name: str, values: Array, longest: float) -> AxisFit:
    """The fit with a drive effect, first at the best of some values, then about the fitted one.

    The given fit if no value reduces its cost enough.
    """
    other, how = fit, fit.how.drives
    enough = how.useful_cost_share * fit.problem.costs(fit.found.linearisation.r).sum()
    while values.any():
        last = name in other.problem.names
        found = profile(other, name, values, thorough=last)
        costs = found.costs.sum(axis=1)
        theta = found.theta[[costs.argmin()]]
        fitted = theta[0, found.names.index(name)]
        if not last and (fitted == 0 or costs.min() > enough):
            return fit
        more = replace(fit.problem, names=found.names)
        begun_from = replace(other, problem=more, found=fit.found._replace(theta=theta))
        other = begun_from.refit(fit.log, found.names, longest)
        values = np.zeros(0) if last else np.array(how.value_factors) * fitted
    return other


def profile_drives(fit: AxisFit, tell: Callable[[str], object] = lambda _: None) -> AxisFit:
    """The fit with profiles of drives and lever, by which its intervals know of them.

    Args:
        fit: Without profiles.
        tell: Called with the name of each before its profile.
    """
    how = fit.how.drives
    near = {name: np.array(how.value_factors) * fit.value(name) for name in fit.problem.tilt.tried}
    tried = {
        name: sorted({*PLAIN_PARAMETERS[name].tried, *values}) for name, values in near.items()
    }
    # of a lever that is given
    tried.setdefault("lever", [-2 * how.height_std_m, 0.0, 2 * how.height_std_m])
    profiles = []
    for name, values in tried.items():
        tell(name)
        profiles.append(profile_contenders(fit, name, values))
    return replace(fit, profiles=tuple(profiles))
