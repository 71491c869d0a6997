"""What a fit of an axis would gain by one term more: a single step, without another fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from controllers.arrays import Array
from twin.identify.least_squares import estimate
from twin.identify.plain_model import AxisFit


def find_term(fit: AxisFit, name: str) -> tuple[Array, float]:
    """A term that a fit has not, by its next step from zero, and what it changes in the fit.

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


def find_clock_drift(fit: AxisFit) -> tuple[float, float]:
    """By how much the clock of the positions is faster than that of the commands, and its error.

    The dead time grows by it with the time in each recording; an offset of each recording's clock
    is fitted along. The error is the half-width of its interval.
    """
    fit = fit.windowed or fit
    changes = fit.log.clock_columns(fit.problem.windows.begin)
    by_time = fit.found.linearisation.by_parameter[0, ..., fit.problem.names.index("dead_time")]
    (drift, _), (half, _) = _step_by(fit, by_time[..., None] * changes[:, None])
    return drift, half


def find_admixture(fit: AxisFit, more: Array) -> tuple[float, float, float]:
    """Share of further tilt that acts along with the tilt, its error, and the gain next to it.

    The step finds the acceleration by the further tilt. Its share is of the gain next to it, not of
    the gain of the fit, which is a mean over small tilts and large ones.

    Args:
        fit: Of the axis.
        more: The further tilt, when each command begins, shape (K,).

    Returns:
        The share, the half-width of its interval, and the gain in m/s^2 by the unit of the tilt.
    """
    fit = fit.windowed or fit
    (found, gain), (half, _) = _step_by(fit, fit.slope_by_tilt(more)[..., None])
    fitted = fit.value("gain")
    return found * fitted / gain, half * abs(fitted / gain), gain / fit.problem.tilt.scale


def _step_by(fit: AxisFit, more: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """One step of a fit with C parameters more: the last one and the gain, and their half-widths.

    Args:
        fit: The fit, in which these parameters are zero.
        more: Slopes of the residuals by them, shape (W, M, C).
    """
    line = fit.found.linearisation
    slopes = np.concatenate((line.by_parameter, more[None]), axis=-1)
    free, _ = line._replace(by_parameter=slopes).eliminate_starts()
    weight = fit.problem.weights(line.r)[0]
    r, J = free[0, ..., 0], free[0, ..., 1:]  # noqa: N806
    information = np.einsum("wmi,wmj,w->wij", J, J, weight)
    score = np.einsum("wmi,wm,w->wi", J, r, weight)
    step = -np.linalg.pinv(information.sum(axis=0), hermitian=True) @ score.sum(axis=0)
    half = estimate(step, information, score + information @ step).half_width
    gain = fit.problem.names.index("gain")
    return (float(step[-1]), fit.value("gain") + float(step[gain])), (
        float(half[-1]),
        float(half[gain]),
    )
