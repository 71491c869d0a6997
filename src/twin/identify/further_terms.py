"""The gain of a fit of an axis by one term more: a single step, without a second fit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from controllers.arrays import Array
from twin.identify.axis_problem import AxisProblem
from twin.identify.intervals import estimate
from twin.identify.least_squares import fit_starts, minimise
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.plain_model import AxisFit

FILTER_SHARES = (0.4, math.sqrt(0.5), 0.9, 1.0)
"""Time constants of a filter of the positions that are tried, as shares of a lag."""
MIN_LAG_SHARE = 0.3
"""Smallest share of the lag from which a fit with a filter begins: no step leaves a lag of zero."""
FILTER_SETTLES = 3.0
"""Time for which a filter still has its start, over the lag."""
MAX_COST_RISE = 4.0
"""Largest excess of a fit's cost over the best one of a filter: two standard deviations."""
LEVER_DIFFERENCE_M = 0.02
"""Difference of the lever for slopes by it."""
STICKING_SPEEDS_M_S = (0.005, 0.015, 0.05)
"""Speeds at which half of an additional friction at rest is left, from the twin's own upwards."""


def find_term(fit: AxisFit, name: str) -> tuple[Array, float]:
    """A term that a fit has not, by its next step from zero, and the changes that follow from it.

    The changes are those of the omitted-variable bias, -N_pp^-1 N_pt t with the normal matrix N and
    the term t: a fit to predictions, which is at no minimum for its windows, is not moved to one. A
    parameter at its bound, as a friction of zero, stays there.

    Args:
        fit: Without the term, P parameters.
        name: The term.

    Returns:
        Changes of the parameters and, last, the term, shape (P + 1,); and the term's standard
        deviation, as of white residuals.
    """
    problem = replace(fit.problem, names=(*fit.problem.names, name))
    theta = np.append(fit.found.theta, [[0.0]], axis=1)
    line = problem.linearise(theta, fit.found.starts)
    free, _ = line.eliminate_starts()
    each = np.einsum("wmi,wmj,w->ij", free[0], free[0], problem.weights(line.r)[0])
    normal = each[1:, 1:] + np.diag(problem.known[1] + 1e-9)
    least, most = problem.bounds
    inside = (theta[0] > least) & (theta[0] < most)
    inside[-1] = True
    free_terms, moved = np.flatnonzero(inside), np.flatnonzero(inside[:-1])
    inverse = np.linalg.inv(normal[np.ix_(free_terms, free_terms)])
    term = float(-inverse[-1] @ each[1:, 0][free_terms])
    changes = np.zeros(len(inside))
    changes[moved] = -term * np.linalg.solve(normal[np.ix_(moved, moved)], normal[moved, -1])
    changes[-1] = term
    return changes, float(np.sqrt(inverse[-1, -1]))


def find_significance(fit: AxisFit, name: str) -> float:
    """Standard deviations by which the next step of a fit would move a parameter from zero."""
    changes, std = find_term(fit, name)
    return float(abs(changes[-1]) / std)


def find_hidden_changes(fit: AxisFit) -> list[tuple[str, Array]]:
    """What a fit may take for other values of its parameters, and by how much that changes them.

    A damping that is not fitted resembles friction. A friction that is larger at rest resembles
    more friction and less damping; a ball that it holds moves later. Each is a step of the fit with
    its term, within the term's interval. A lag may come from a filter of the positions, behind
    which a friction that turns looks smoother: fits with such filters change the parameters as
    well, if they explain the log.

    Args:
        fit: Of an axis, P parameters.

    Returns:
        What there may be, and changes that it may make, shape (N, P + 1): of the parameters and,
        last, of the whole delay, which a filter of the positions is part of.
    """
    names, theta, starts = fit.problem.names, fit.found.theta, fit.found.starts
    own = fit.problem.simulate_samples(theta, starts)[0][0, ..., 0]
    weight = fit.problem.windows.weight[..., 0]

    def change(other: AxisProblem, values: Array, by: float) -> Array:
        places = other.simulate_samples(values, starts)[0][0, ..., 0]
        return _change_by(fit, weight * (places - own) / by)

    found = []
    if "viscous" not in names:
        by = PLAIN_PARAMETERS["viscous"].difference
        damped = replace(fit.problem, names=(*names, "viscous"))
        changes = change(damped, np.append(theta, [[by]], axis=1), by)
        changes[:, [name != "friction" for name in names]] = 0.0
        found.append(("a damping too small to be fitted", append_delay(changes, names)))
    by = PLAIN_PARAMETERS["friction"].difference
    each = [
        change(replace(fit.problem, sticking=(by, speed)), theta, by)
        for speed in STICKING_SPEEDS_M_S
    ]
    found.append(("a friction that sticks", append_delay(np.concatenate(each), names)))
    if len(filtered := _change_by_filters(fit)):
        found.append(("a filter of the positions", filtered))
    return found


def append_delay(changes: Array, names: tuple[str, ...]) -> Array:
    """Changes of P parameters, shape (N, P), and of the whole delay, shape (N, P + 1)."""
    parts = [name in {"dead_time", "lag"} for name in names]
    return np.column_stack((changes, changes[:, parts].sum(axis=1)))


def _change_by_filters(fit: AxisFit) -> Array:
    """Changes where a part of the lag comes from a filter of the positions, shape (N, P + 1).

    Of N filters that explain the log as well as the best one of those tried, or none. A fit with a
    filter tau begins where mean and variance of the response to an impulse are those of the fit
    without: with a lag of sqrt(lag^2 - tau^2) and the same whole delay. Dead time and lag by
    themselves are those before the filter, and not compared. Starts are fitted along with every
    step: with those that a step merely shifts, a friction that turns the ball makes the cost rise,
    and no step would be taken. The first samples of each window, where a filter still has its
    start, do not count.
    """
    names = fit.problem.names
    lag = fit.value("lag") if "lag" in names else 0.0
    if not fit.log.held or lag < fit.problem.step:
        return np.zeros((0, len(names) + 1))
    windows, pair = fit.problem.windows, [names.index(each) for each in ("dead_time", "lag")]
    settled = windows.time[..., None] > FILTER_SETTLES * lag
    problem = replace(fit.problem, windows=replace(windows, weight=windows.weight * settled))
    delay, fits, costs = fit.found.theta[0, pair].sum(), list[Array](), list[float]()
    for share in (0.0, *FILTER_SHARES):
        behind, theta = replace(problem, filter_s=share * lag), fit.found.theta.copy()
        rest = max(math.sqrt(1 - share**2), MIN_LAG_SHARE) * lag
        theta[0, pair] = delay - share * lag - rest, rest
        theta = np.clip(theta, *behind.bounds)
        starts = fit_starts(behind, theta, fit.found.starts, 4)
        found = minimise(behind, theta, starts, 20, 3, 2, fit.how.search.control).best(1)
        left = behind.linearise(found.theta, found.starts, slopes=False)
        fits.append(append_delay(found.theta, names)[0])
        fits[-1][-1] += share * lag
        costs.append(float((left.r[0] ** 2).sum()))
    good = np.array(costs[1:]) < min(costs) + MAX_COST_RISE
    changes = np.array(fits[1:])[good] - fits[0]
    changes[:, pair] = 0.0
    return np.asarray(changes)


def _change_by(fit: AxisFit, more: Array) -> Array:
    """Changes of the P parameters at both ends of the interval of one term more, shape (2, P).

    Args:
        fit: The fit, in which the term is zero, its least value.
        more: Slopes of the residuals by it, shape (W, M).
    """
    step, half, information = _step_by(fit, more[..., None])
    ends = np.maximum((step[-1] - half[-1], step[-1] + half[-1]), 0.0)
    taken = np.linalg.pinv(information[:-1, :-1], hermitian=True) @ information[:-1, -1]
    return np.asarray(-ends[:, None] * taken)


def find_clock_drift(fit: AxisFit) -> tuple[float, float]:
    """Relative excess of the speed of the positions' clock over the commands', and its error.

    The dead time grows by it with the time in each recording; an offset of each recording's clock
    is fitted along. The error is the half-width of its interval.
    """
    fit = fit.windowed or fit
    changes = fit.log.clock_columns(fit.problem.windows.begin)
    by_time = fit.found.linearisation.by_parameter[0, ..., fit.problem.names.index("dead_time")]
    step, half, _ = _step_by(fit, by_time[..., None] * changes[:, None])
    return float(step[-1]), float(half[-1])


def find_admixture(fit: AxisFit, more: Array) -> tuple[float, float, float]:
    """Share of further tilt that acts along with the tilt, its error, and the gain next to it.

    The step finds the acceleration by the further tilt, and by a lever where one is possible: the
    fit has none yet, and what a lever leaves resembles a gain that changes with the tilt. The share
    is of the gain next to it, not of the gain of the fit, which is a mean over small tilts and
    large ones.

    Args:
        fit: Of the axis.
        more: The further tilt, when each command begins, shape (K,).

    Returns:
        The share, the half-width of its interval, and the gain in m/s^2 by the unit of the tilt.
    """
    fit = fit.windowed or fit
    names, slopes = fit.problem.names, [fit.slope_by_tilt(more)]
    if "lever" in fit.problem.tilt.tried and "lever" not in names:
        slopes.append(_slope_by_lever(fit))
    step, half, _ = _step_by(fit, np.stack(slopes, axis=-1))
    fitted, at = fit.value("gain"), len(names)
    gain = fitted + float(step[names.index("gain")])
    share = fitted / gain
    return float(step[at]) * share, float(half[at]) * abs(share), gain / fit.problem.tilt.scale


def _slope_by_lever(fit: AxisFit) -> Array:
    """Slope of the residuals by a lever in m, which the fit has not, shape (W, M)."""
    problem = replace(fit.problem, names=(*fit.problem.names, "lever"))
    ways = []
    for lever in (LEVER_DIFFERENCE_M, -LEVER_DIFFERENCE_M):
        theta = np.append(fit.found.theta, [[lever]], axis=1)
        ways.append(problem.linearise(theta, fit.found.starts, slopes=False).r[0])
    return np.asarray((ways[0] - ways[1]) / (2 * LEVER_DIFFERENCE_M))


def _step_by(fit: AxisFit, more: Array) -> tuple[Array, Array, Array]:
    """One step of a fit of P parameters with C parameters more.

    Args:
        fit: The fit, in which these parameters are zero.
        more: Slopes of the residuals by them, shape (W, M, C).

    Returns:
        The step and its half-widths, shape (P + C,), and the information, shape (P + C, P + C).
    """
    line = fit.found.linearisation
    slopes = np.concatenate((line.by_parameter, more[None]), axis=-1)
    free, _ = line._replace(by_parameter=slopes).eliminate_starts()
    weight = fit.problem.weights(line.r)[0]
    r, J = free[0, ..., 0], free[0, ..., 1:]  # noqa: N806
    information = np.einsum("wmi,wmj,w->wij", J, J, weight)
    score = np.einsum("wmi,wm,w->wi", J, r, weight)
    every = information.sum(axis=0)
    step = -np.linalg.pinv(every, hermitian=True) @ score.sum(axis=0)
    half = estimate(step, information, score + information @ step).half_width
    return step, half, every
