"""Chooses the fit by which an axis is predicted: the full one, or five numbers if they are better.

The five numbers are gain, dead time, level, viscous friction and Coulomb friction, fitted to the
errors of predictions. A full model in error may explain windows well and predict badly. So each
half of the log is predicted by fits of the other, and five numbers are taken if their median error
is clearly smaller. So they are where the full model leaves the gain open, or cannot be fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError
from twin.base.page import digits
from twin.identify.command_model import TiltHistory
from twin.identify.first_look import FirstLook
from twin.identify.logs import AxisLog
from twin.identify.plain_model import (
    AXIS_FITTING,
    AxisFit,
    AxisFitting,
    AxisProblem,
    fit_from_guesses,
    fit_to_predictions,
    guess_from,
    predict_axis,
    prediction_times,
)
from twin.identify.verdicts import absolute_quantile
from twin.identify.windows import axis_windows

FIVE_NUMBERS = ("gain", "dead_time", "level", "viscous", "friction")
"""Parameters of the plain model."""


@dataclass(frozen=True, kw_only=True)
class PredictorChoice:
    """Constants of the choice.

    Attributes:
        windows_s: Lengths of the windows of a first fit of five numbers, the best first.
        first_residual_m: First guess of their residual.
        horizon_s: Time ahead at which predictions are compared, and up to which five numbers are
            fitted.
        interval_s: Time between the predictions to which they are fitted.
        leads_s: Lengths of the samples from which a prediction may start, the usual one first: long
            ones average noise, short ones forget errors of the model.
        lead_interval_s: Time between the predictions by which these are compared.
        max_lead_predictions: Largest number of these.
        accepted_lead_share: Another length is taken if it reduces the error to this share of that
            of the usual one: few predictions differ by more by chance.
        accepted_error_share: Five numbers are taken if they reduce the error to this share of that
            of a full model that shows the gain.
    """

    windows_s: tuple[float, ...] = (1.4, 0.7)
    first_residual_m: float = 2e-3
    horizon_s: float = 1.0
    interval_s: float = 0.25
    leads_s: tuple[float, ...] = (0.4, 0.25, 0.7, 1.2)
    lead_interval_s: float = 0.125
    max_lead_predictions: int = 250
    accepted_lead_share: float = 0.9
    accepted_error_share: float = 0.9


PREDICTOR_CHOICE = PredictorChoice()


def choose_predictor(
    fit: AxisFit,
    how: PredictorChoice = PREDICTOR_CHOICE,
    *,
    known: bool = True,
    look: FirstLook | None = None,
) -> tuple[AxisFit, str]:
    """The fit that predicts best, and a note if it is not the given one.

    A fit that explains its log is kept: no other model leaves much less. One that does not and does
    not show the gain either is not kept, whatever it predicts: its terms make up for each other.

    Args:
        fit: The full fit of an axis.
        how: Constants.
        known: Whether its gain is identified.
        look: A first look at its log, which is a guess of the five numbers as well.
    """
    if (fit.windowed or fit).explained:
        return fit, ""
    try:
        if not known:
            plain = _reduce(fit, fit.log, look, how)
            five = describe_five_numbers(plain)
            return plain, f"predictions are those of {five}: the full model leaves the gain open"
        full = _cross_validate(fit, lambda log: _refit(fit, log), how)
        least = _cross_validate(fit, lambda log: _reduce(fit, log, look, how), how)
        if not least < how.accepted_error_share * full:
            return fit, ""
        plain = _reduce(fit, fit.log, look, how)
    except LogError:  # a half has too few windows
        return fit, ""
    return plain, (
        f"predictions are those of {describe_five_numbers(plain)}: by them one half of the log "
        f"predicts the other to {1000 * least:.1f} mm, by the full model to {1000 * full:.1f} mm"
    )


def choose_lead(fit: AxisFit, how: PredictorChoice = PREDICTOR_CHOICE) -> AxisFit:
    """The fit with the length of samples from which its predictions of its log start best.

    The usual length if no other one is clearly better.

    Args:
        fit: A fit of an axis.
        how: Constants.
    """
    often = replace(fit.how.hold_out, interval_s=how.lead_interval_s)
    at = prediction_times(fit.log, replace(fit.how, hold_out=often), max(how.leads_s))
    at = at[:: max(1, -(-len(at) // how.max_lead_predictions))]
    if not len(at):
        return fit
    fits = [
        replace(fit, how=replace(fit.how, hold_out=replace(fit.how.hold_out, lead_s=lead_s)))
        for lead_s in how.leads_s
    ]
    errors = [absolute_quantile(_find_errors(each, fit.log, at, how), 0.5) for each in fits]
    best = int(np.nanargmin(errors)) if np.isfinite(errors).any() else 0
    return fits[best if not errors[best] > how.accepted_lead_share * errors[0] else 0]


def _find_errors(fit: AxisFit, log: AxisLog, at: Array, how: PredictorChoice) -> Array:
    """Errors in m of predictions that begin at some times in s, where the ball moves."""
    found = predict_axis(log, fit, at, follow=False)
    return found.errors("model", how.horizon_s)[found.moves]


def fit_five_numbers(
    log: AxisLog,
    delays: tuple[float, float],
    look: FirstLook | None = None,
    fitting: AxisFitting = AXIS_FITTING,
    how: PredictorChoice = PREDICTOR_CHOICE,
) -> AxisFit:
    """The plain model of an axis from no first guess, or a first look, end stops not regarded.

    Args:
        log: The axis.
        delays: Smallest and largest dead time in s.
        look: A first look at it, which is a guess as well.
        fitting: Constants of fits.
        how: Constants.

    Raises:
        LogError: If there are too few windows.
    """
    log = replace(log, stops=None)
    nothing = axis_windows(log, np.zeros(0), np.zeros(0))
    problem = AxisProblem(nothing, FIVE_NUMBERS, TiltHistory(log), how.windows_s[0], delays)
    guess = problem.first_guesses(dead_time=fitting.search.delay_guesses_s)
    if look:
        guess = np.vstack((guess, guess_from(look, problem)))
    return _fit(log, problem, guess, look, how.first_residual_m, 0.0, fitting, how)


def describe_five_numbers(fit: AxisFit) -> str:
    """The plain model in words.

    Args:
        fit: Its fit.
    """
    values = [fit.value("gain") / fit.problem.tilt.scale]
    values += [fit.value(name) for name in FIVE_NUMBERS[1:]]
    gain, dead_time, level, viscous, friction = map(digits, values)
    return (
        f"a plain model of five numbers, of values that predict best (gain {gain}, dead time "
        f"{dead_time} s, level {level} m/s^2, viscous {viscous} 1/s, friction {friction} m/s^2)"
    )


def _reduce(fit: AxisFit, log: AxisLog, look: FirstLook | None, how: PredictorChoice) -> AxisFit:
    """The plain model of a part of the log of a full fit, begun from that and a first look."""
    value = {name: fit.value(name) for name in FIVE_NUMBERS}
    value["dead_time"] += fit.value("lag")
    problem = replace(fit.problem, names=FIVE_NUMBERS, drift=0.0)
    guess = problem.first_guesses(**{name: [each] for name, each in value.items()})
    if look:
        guess = np.vstack((guess, guess_from(look, problem)))
    return _fit(log, problem, guess, look, fit.sigma, fit.noise, fit.how, how)


def _fit(
    log: AxisLog,
    problem: AxisProblem,
    guess: Array,
    look: FirstLook | None,
    sigma: float,
    noise: float,
    fitting: AxisFitting,
    how: PredictorChoice,
) -> AxisFit:
    """The plain model by windows from C guesses, shape (C, P), and then by predictions."""
    for window_s in how.windows_s:
        try:
            found = fit_from_guesses(log, problem, window_s, guess, sigma, fitting)
            break
        except LogError:
            if window_s == how.windows_s[-1]:
                raise
    found = replace(found, noise=noise or found.sigma)
    if len(prediction_times(log, fitting, fitting.hold_out.lead_s)) < 3:
        return found
    near = replace(fitting.hold_out, horizons_s=(how.horizon_s,), interval_s=how.interval_s)
    theta = fit_to_predictions(replace(found, how=replace(fitting, hold_out=near)), look)
    return replace(found, found=found.found._replace(theta=theta))


def _refit(fit: AxisFit, log: AxisLog) -> AxisFit:
    """The full fit to a part of its log, by what it is fitted to: windows or predictions."""
    other = fit.refit(log, fit.problem.names, fit.problem.longest)
    if fit.windowed is None or fit.problem.drift:
        return other
    return replace(other, found=other.found._replace(theta=fit_to_predictions(other)))


def _cross_validate(
    fit: AxisFit, refit: Callable[[AxisLog], AxisFit], how: PredictorChoice
) -> float:
    """Median error in m of predictions of each half of a log by a fit of the other.

    Infinite if nothing is known of it.
    """
    middle = float(np.median(fit.log.sampled))
    halves = fit.log.between(-np.inf, middle), fit.log.between(middle, np.inf)
    errors = []
    for fitted, tried in (halves, halves[::-1]):
        at = prediction_times(tried, fit.how, fit.how.hold_out.lead_s)
        if not len(at):
            return np.inf
        errors.append(_find_errors(refit(fitted), tried, at, how))
    return absolute_quantile(np.concatenate(errors), 0.5)
