"""Predictions by a fit of the plain model, and fits and choices by their errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from controllers.arrays import Array
from twin.base.errors import LogError
from twin.identify.axis_fitting import AXIS_FITTING, AxisFitting
from twin.identify.axis_logs import AxisLog
from twin.identify.axis_problem import AxisProblem
from twin.identify.command_model import PROFILED_EFFECTS, TiltHistory
from twin.identify.first_look import FirstLook
from twin.identify.least_squares import fit_starts, fit_starts_from_scratch
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.plain_model import AxisFit, guess_from
from twin.identify.verdicts import PREDICTOR_NAMES, Predicted, absolute_quantile, predict_windows
from twin.identify.windows import axis_windows


def predict_axis(log: AxisLog, fit: AxisFit, at: Array, *, follow: bool = True) -> Predicted:
    """Predict from times in s, shape (W,), by the samples before them.

    Args:
        log: The axis, held out.
        fit: The model.
        at: When predictions begin.
        follow: Whether to predict without friction as well, and with a level that is followed while
            that has predicted better.
    """
    found = predict_by_levels(log, fit, at, follow=follow)
    return choose_level(found) if follow else found


def predict_by_levels(log: AxisLog, fit: AxisFit, at: Array, *, follow: bool = True) -> Predicted:
    """Predictions as of ``predict_axis``, with a level that is followed at all times."""
    how, hold_out = fit.how.prediction, fit.how.hold_out
    log = replace(log, across=log.across * fit.log.across[1].any())
    theta, tilt = fit.found.theta, fit.problem.tilt.on(log)
    by = {"model": theta}
    if follow:
        windows = axis_windows(log, at - how.level_history_s, at)
        windows = replace(windows, weight=windows.weight / fit.sigma)
        past = replace(
            fit.problem,
            windows=windows,
            tilt=tilt,
            longest=how.level_history_s + hold_out.horizon_tolerance_s,
            drift=how.level_std_m_s2,
            stops=fit.log.stops,
        )
        own = fit_starts_from_scratch(past, theta, 8)[2]
        for who, name, values in (
            ("without friction", "friction", 0.0),
            ("level followed", "level", fit.value("level") + own),
        ):
            by[who] = np.repeat(theta[:, None], len(at), axis=1)
            if name in fit.problem.names:
                by[who][..., fit.problem.names.index(name)] = values
    problem = _prediction_problem(log, fit, at, tilt)
    return predict_windows(problem, hold_out.lead_s, by, "x", hold_out)["x"]


def _prediction_problem(log: AxisLog, fit: AxisFit, at: Array, tilt: TiltHistory) -> AxisProblem:
    """Windows from before the times ``at`` in s to the last horizon, with the tilt of the log."""
    how = fit.how.hold_out
    lead, tolerance = how.lead_s, how.horizon_tolerance_s
    windows = axis_windows(log, at - lead, at + how.horizons_s[-1] + tolerance)
    windows = replace(windows, weight=windows.weight / fit.noise)
    longest = lead + how.horizons_s[-1] + 2 * tolerance
    return replace(
        fit.problem,
        windows=windows,
        tilt=tilt,
        longest=longest,
        drift=0.0,
        stops=fit.log.stops,
    )


def refit_for_prediction(fit: AxisFit, longest: float) -> AxisFit:
    """The fit that predicts its own log best where the one to windows does so badly.

    A model in error, such as of servos with a dead band, explains a window best by other values
    than those by which it predicts, for with its start free it may bend its whole way; a level
    that drifts is taken for gain and friction unless each window has its own. A fit that explains
    its log is no model in error: the noise of its starts is what predictions leave.
    """
    how = fit.how.prediction
    if fit.explained:
        return fit
    own = _median_error(fit, fit.log, follow=True)
    if own < how.huber_error_m:
        return fit
    found, least = fit, own
    drifting = replace(fit, problem=replace(fit.problem, drift=how.level_std_m_s2))
    for other in (
        drifting.refit(fit.log, fit.problem.names, longest),
        replace(fit, found=fit.found._replace(theta=fit_to_predictions(fit))),
    ):
        left = _median_error(other, fit.log, follow=True)
        if left < least:
            found, least = replace(other, windowed=fit, profiles=fit.profiles), left
    return found


def fit_to_predictions(
    fit: AxisFit, look: FirstLook | None = None, known: Array | None = None
) -> Array:
    """Parameters fitted to predictions of the log, the best from several first guesses, (1, P).

    Args:
        fit: A fit to windows of the log.
        look: A first look at it, which is a guess as well.
        known: A guess that is near the fit, shape (1, P), so that no other is needed.
    """
    how, hold_out = fit.how.prediction, fit.how.hold_out
    at = _thin_prediction_times(fit.log, fit.how, hold_out.lead_s)
    problem = _prediction_problem(fit.log, fit, at, fit.problem.tilt.on(fit.log))
    windows, names = problem.windows, problem.names
    before = problem.first_part(hold_out.lead_s)
    first = before.initial_starts()
    target = (windows.weight[..., 0] > 0) & (windows.time >= hold_out.lead_s)
    # what has no slope stays as it is
    step = np.array([PLAIN_PARAMETERS[name].difference or 1e-12 for name in names])
    least, most = problem.bounds
    most[[name in ("dead_time", "lag") for name in names]] = how.max_delay_and_lag_s

    def off(theta: Array) -> Array:
        theta = np.atleast_2d(theta)
        starts = fit_starts(before, theta, np.repeat(first, len(theta), axis=1), 4)
        places = problem.simulate_samples(theta, starts)[0]
        each = np.clip((places - windows.ball)[:, target, 0] / how.huber_error_m, -1e3, 1e3)
        return np.asarray(np.squeeze(each))

    def slopes(theta: Array) -> Array:
        moved = theta + np.diag(np.where(theta + step > most, -step, step))
        each = off(np.concatenate((theta[None], moved)))
        return np.asarray(((each[1:] - each[0]) / np.diagonal(moved - theta)[:, None]).T)

    guesses = known
    if guesses is None:
        usual = {"gain": (*fit.briefer, fit)[0].value("gain")} | dict(how.initial_values)
        usual |= {name: fit.value(name) for name in PROFILED_EFFECTS}
        rows = [[usual.get(name, 0.0) for name in names]]
        rows += [[each.value(name) for name in names] for each in (fit, *fit.briefer)]
        rows += guess_from(look, problem).tolist() if look else []
        guesses = np.array(rows)
    begun_at = np.clip(guesses, least + 1e-6, most - 1e-6)
    # the soft L1 loss of scipy's least squares
    initial = (np.sqrt(1 + off(begun_at) ** 2) - 1).sum(axis=-1)
    tried = [
        least_squares(
            off,
            guess,
            slopes,
            bounds=(least, most),
            x_scale=step,
            loss="soft_l1",
            ftol=how.cost_tolerance,
            max_nfev=how.max_evaluations,
        )
        for guess in begun_at[np.argsort(initial)[: how.continued_guesses]]
    ]
    found = min(tried, key=lambda each: float(each.cost))
    return np.asarray(found.x[None])


def choose_level(found: Predicted) -> Predicted:
    """The level followed only while that has predicted better, in what had been seen by then.

    Better by more than chance may: the sum of the gains, in logarithms of the errors, is above its
    standard deviation for gains that have either sign alike.
    """
    gained = [
        np.log(np.maximum(np.abs(found.errors(name, 1.0)), 1e-4)) for name in PREDICTOR_NAMES[:2]
    ]
    gain = np.where(found.moves, gained[0] - gained[1], np.nan)
    seen = found.begin[:, None] >= found.begin + 1.0 + found.how.horizon_tolerance_s
    so_far = np.where(seen, np.nan_to_num(gain), 0.0)
    better = so_far.sum(axis=1) > np.sqrt((so_far**2).sum(axis=1))
    followed = np.where(better[:, None], found.by["level followed"], found.by["model"])
    return replace(found, by={**found.by, "level followed": followed})


def prediction_times(
    log: AxisLog, fitting: AxisFitting = AXIS_FITTING, history_s: float | None = None
) -> Array:
    """When predictions begin: every half second with enough samples before and after, s.

    Args:
        log: What is predicted.
        fitting: Constants of fits.
        history_s: Length of the samples before, in s; None for those of a followed level.
    """
    how = fitting.hold_out
    history = fitting.prediction.level_history_s if history_s is None else history_s
    time, first_horizon = log.sampled, how.horizons_s[0]
    if len(time) < 10:
        return np.zeros(0)
    tries = np.arange(time[0] + history, time[-1] - first_horizon, how.interval_s)
    step = float(np.median(np.diff(time)))
    before, past, after = (
        np.searchsorted(time, tries + last) - np.searchsorted(time, tries + first)
        for first, last in (
            (-how.lead_s, 0.0),
            (-history, 0.0),
            (0.0, first_horizon + how.horizon_tolerance_s),
        )
    )
    return tries[
        (before >= max(3, 0.5 * how.lead_s / step)) & (past >= 0.5 * history / step) & (after > 0)
    ]


def _thin_prediction_times(
    log: AxisLog, fitting: AxisFitting, history_s: float | None = None
) -> Array:
    """Evenly chosen ones of the prediction times, at most as many as fits are compared by, s."""
    every = prediction_times(log, fitting, history_s)
    return every[:: max(1, -(-len(every) // fitting.prediction.max_predictions))]


def cross_validate(fit: AxisFit, names: tuple[str, ...], longest: float) -> float:
    """Error in m of fits of each half of a log by these parameters, in the other half.

    See ``_median_error``.
    """
    time = fit.log.sampled
    middle = float(np.median(time))
    halves = fit.log.between(-np.inf, middle), fit.log.between(middle, np.inf)
    try:
        each = [
            _median_error(fit.refit(fitted, names, longest), tried, follow=fit.problem.drift > 0)
            for fitted, tried in (halves, halves[::-1])
        ]
    except LogError:  # a half has too few windows
        return np.inf
    return float(np.sqrt(np.prod(each)))


def _median_error(fit: AxisFit, log: AxisLog, *, follow: bool = False) -> float:
    """Geometric mean over the horizons of the median error in m where the ball moves.

    Infinite if one is unknown; of the better of model and level that is followed.
    """
    at = _thin_prediction_times(log, fit.how)
    if len(at) < 3:
        return np.inf
    found = predict_axis(log, fit, at, follow=follow)
    medians = [
        [
            absolute_quantile(found.errors(who, ahead)[found.moves], 0.5)
            for ahead in found.how.horizons_s
        ]
        for who in PREDICTOR_NAMES[: 1 + follow]
    ]
    each = np.exp(np.mean(np.log(medians), axis=1))
    return float(np.min(each)) if np.isfinite(each).all() else np.inf
