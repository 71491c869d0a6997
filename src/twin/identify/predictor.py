"""Predicts an axis by a weighted mean of the full model and five numbers, from several starts.

The five numbers are gain, dead time, level, viscous friction and Coulomb friction, fitted to the
errors of predictions. A full model in error may explain windows well and predict badly, and noise
may hide such an error. A prediction from a long stretch of samples averages noise, one from a brief
stretch forgets what the model lacks. Fits that predict equally well may have other values, and no
log shows which of them is best on another log: one chosen by a small difference is chosen by
chance. So each half of the log is predicted by fits of the other, in each of these ways, and the
ways are averaged with weights by their errors, as forecasts are (Bates and Granger 1969). A full
model whose gain may be zero predicts without a camber, with at most half the weight. Five numbers
predict alone where it cannot be fitted, or its gain may be zero and the log is too short to
compare.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError
from twin.base.page import digits
from twin.identify.axis_fitting import AXIS_FITTING, AxisFitting
from twin.identify.axis_logs import AxisLog
from twin.identify.axis_prediction import (
    choose_level,
    fit_to_predictions,
    predict_axis,
    predict_by_levels,
    prediction_times,
)
from twin.identify.axis_problem import AxisProblem
from twin.identify.command_model import TiltHistory
from twin.identify.first_look import FirstLook
from twin.identify.plain_model import AxisFit, fit_from_guesses, guess_from
from twin.identify.verdicts import Predicted
from twin.identify.windows import SAMPLE_BIN_S, axis_windows

FIVE_NUMBERS = ("gain", "dead_time", "level", "viscous", "friction")
"""Parameters of the plain model."""


@dataclass(frozen=True, kw_only=True)
class PredictorChoice:
    """Constants of the mean.

    Attributes:
        windows_s: Lengths of the windows of a first fit of five numbers, the best first.
        first_residual_m: First guess of their residual.
        horizon_s: Time ahead at which predictions are compared, and up to which five numbers are
            fitted.
        interval_s: Time between the predictions to which they are fitted.
        leads_s: Lengths of the samples from which a prediction may start, in whole bins of samples,
            so that predictions of the same time have the same samples ahead.
        min_lead_samples: Smallest number of samples of such a length.
        weight_power: Weights fall with this power of the median error. For the mean of independent
            errors 2 would be best; those of the ways have much in common, so the better of two
            deserves more.
        least_error_m: Smallest error that counts.
        min_weight: Weight below which a way is left out.
        min_predictions: Smallest number of predictions by which ways are compared.
    """

    windows_s: tuple[float, ...] = (1.4, 0.7)
    first_residual_m: float = 2e-3
    horizon_s: float = 1.0
    interval_s: float = 0.25
    leads_s: tuple[float, ...] = tuple(n * SAMPLE_BIN_S for n in (16, 25, 44, 75))
    min_lead_samples: int = 4
    weight_power: float = 4.0
    least_error_m: float = 1e-6
    min_weight: float = 0.03
    min_predictions: int = 6


PREDICTOR_CHOICE = PredictorChoice()


@dataclass(frozen=True)
class AxisPredictor:
    """Fits of an axis whose predictions are averaged.

    Attributes:
        fits: Fits to the same log, each with the length of the samples from which it predicts.
        weights: Weights of their predictions, shape (F,), with the sum 1.
    """

    fits: tuple[AxisFit, ...]
    weights: Array

    @property
    def lead_s(self) -> float:
        """Mean length of the samples from which a prediction starts, s."""
        return float(self.weights @ [fit.how.hold_out.lead_s for fit in self.fits])

    def predict(self, log: AxisLog, at: Array, *, follow: bool = True) -> Predicted:
        """Predict from times in s, shape (W,), by the samples before them.

        Args:
            log: The axis, held out.
            at: When predictions begin.
            follow: Whether to predict without friction as well, and with a level that is followed
                while the mean has so predicted better.
        """
        every = [predict_by_levels(log, fit, at, follow=follow) for fit in self.fits]
        # all end at the same time, and those from long starts have more samples before
        first = min(every, key=lambda each: each.ahead.shape[1])
        columns = slice(-first.ahead.shape[1], None)
        mean = {
            who: np.average([each.by[who][:, columns] for each in every], 0, self.weights)
            for who in first.by
        }
        found = replace(first, by=mean)
        return choose_level(found) if follow else found


def choose_predictor(
    fit: AxisFit,
    how: PredictorChoice = PREDICTOR_CHOICE,
    *,
    alone: bool = True,
    look: FirstLook | None = None,
) -> tuple[AxisPredictor, str]:
    """The mean of a fit and five numbers that predicts an axis, and a note on their weights.

    A fit that explains its log is compared as well: noise may hide what it lacks. So is one that
    leaves the gain open: its terms make up for each other, which predictions need not show.

    Args:
        fit: The full fit of an axis.
        how: Constants.
        alone: Whether it may have more than half the weight: its gain is not zero.
        look: A first look at its log, which is a guess of the five numbers as well.
    """
    fit = fit if alone else _leave_out_camber(fit)
    refits = [lambda log: _refit(fit, log)]
    try:
        plain = _reduce(fit, look, how)
    except LogError:
        return _average((fit,), refits, how)[0], ""
    refits.append(lambda log: _refit_plainly(plain, log, how))
    found, (_, share), errors = _average((fit, plain), refits, how, alone=alone)
    if not share:
        return found, ""
    whose, others = "those", ""
    if share < 1:
        whose, others = f"to {100 * share:.0f} % those", ", else those of the full model"
    why = "the log is too short to compare them"
    if errors is not None:
        by_full, by_plain = (f"{1000 * each:.1f} mm" for each in errors.min(axis=1))
        why = f"by five numbers one half of the log predicts the other to {by_plain}, by the full "
        why += f"model to {by_full}"
    if not alone:
        why = f"the gain of the full model may be zero; {why}"
    return found, f"predictions are {whose} of {describe_five_numbers(plain)}{others}: {why}"


def predict_plainly(plain: AxisFit, how: PredictorChoice = PREDICTOR_CHOICE) -> AxisPredictor:
    """The mean of the predictions of five numbers alone, from starts of all lengths.

    Args:
        plain: Their fit.
        how: Constants.
    """
    return _average((plain,), [lambda log: _refit_plainly(plain, log, how)], how)[0]


def _average(
    fits: Sequence[AxisFit],
    refits: Sequence[Callable[[AxisLog], AxisFit]],
    how: PredictorChoice,
    *,
    alone: bool = True,
) -> tuple[AxisPredictor, Array, Array | None]:
    """The mean of fits from starts of all lengths, with weights by their errors.

    Args:
        fits: F fits to a log.
        refits: Fit a part of it, in the ways of these fits.
        how: Constants.
        alone: Whether the first fit may have more than half the weight.

    Returns:
        The mean, the weight of each fit, shape (F,), and the median errors in m by which they were
        found, shape (F, L): None of a log that is too short to compare, where all ways have the
        same weight, but none a first fit that may not be alone.
    """
    leads = _possible_leads(fits[0].log, how)
    errors = _cross_validate(fits[0], refits, leads, how)
    alike = np.ones((len(fits), len(leads)))
    if not alone:
        alike[0] = np.inf
    weights = find_weights(alike if errors is None else errors, how, alone=alone)
    used = np.argwhere(weights)
    ways = tuple(fits[k].with_lead(leads[each]) for k, each in used)
    return AxisPredictor(ways, weights[weights > 0]), weights.sum(axis=1), errors


def find_weights(errors: Array, how: PredictorChoice, *, alone: bool = True) -> Array:
    """Weights of ways to predict by their errors, with the sum 1, shape (F, L).

    Args:
        errors: Median errors in m, shape (F, L).
        how: Constants.
        alone: Whether the first of the F fits may have more than half the weight.
    """
    weights: Array = np.asarray(np.maximum(errors, how.least_error_m) ** -how.weight_power)
    weights = weights if alone else _halve(weights)
    weights[weights < how.min_weight * weights.sum()] = 0.0
    return np.asarray(weights / weights.sum()) if alone else _halve(weights)


def _halve(weights: Array) -> Array:
    """Weights with the sum 1, at most half of it of the first of the F fits, shape (F, L)."""
    first, others = weights[:1], weights[1:]
    factor = min(1.0, others.sum() / first.sum()) if first.any() else 1.0
    limited = np.concatenate((factor * first, others))
    return np.asarray(limited / limited.sum())


def _possible_leads(log: AxisLog, how: PredictorChoice) -> list[float]:
    """Lengths in s that hold enough samples; the longest if none does."""
    step = float(np.median(np.diff(log.sampled)))
    leads = [each for each in how.leads_s if each >= (how.min_lead_samples - 0.5) * step]
    return leads or [max(how.leads_s)]


def fit_five_numbers(
    log: AxisLog,
    delays: tuple[float, float],
    look: FirstLook | None = None,
    fitting: AxisFitting = AXIS_FITTING,
    how: PredictorChoice = PREDICTOR_CHOICE,
) -> AxisFit:
    """The plain model of an axis, begun from usual values and, where there is one, a first look.

    Args:
        log: The axis.
        delays: Smallest and largest dead time in s.
        look: A first look at it, which is a guess as well.
        fitting: Constants of fits.
        how: Constants.

    Raises:
        LogError: If there are too few windows.
    """
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


def _reduce(fit: AxisFit, look: FirstLook | None, how: PredictorChoice) -> AxisFit:
    """The plain model of the log of a full fit, begun from that and a first look.

    Raises:
        LogError: If there are too few windows.
    """
    value = {name: fit.value(name) for name in FIVE_NUMBERS}
    value["dead_time"] += fit.value("lag")
    problem = replace(fit.problem, names=FIVE_NUMBERS, drift=0.0)
    guess = problem.first_guesses(**{name: [each] for name, each in value.items()})
    if look:
        guess = np.vstack((guess, guess_from(look, problem)))
    return _fit(fit.log, problem, guess, look, fit.sigma, fit.noise, fit.how, how)


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
    found = _fit_first(log, problem, guess, sigma, fitting, how)
    found = replace(found, noise=noise or found.sigma, log=log)
    if len(prediction_times(log, fitting, fitting.hold_out.lead_s)) < 3:
        return found
    theta = fit_to_predictions(_predict_near(found, how), look)
    return replace(found, found=found.found._replace(theta=theta))


def _fit_first(
    log: AxisLog,
    problem: AxisProblem,
    guess: Array,
    sigma: float,
    fitting: AxisFitting,
    how: PredictorChoice,
) -> AxisFit:
    """The plain model by the first length of windows that is enough; arguments as of ``_fit``.

    Where too few windows of any length touch no end stop, those that touch one count as well.

    Raises:
        LogError: If there are too few even then.
    """
    why = LogError("no windows to fit")
    for each in (log, replace(log, stops=None)):
        for window_s in how.windows_s:
            try:
                return fit_from_guesses(each, problem, window_s, guess, sigma, fitting)
            except LogError as error:
                why = error
    raise why


def _predict_near(fit: AxisFit, how: PredictorChoice) -> AxisFit:
    """The fit with the predictions to which five numbers are fitted."""
    near = replace(fit.how.hold_out, horizons_s=(how.horizon_s,), interval_s=how.interval_s)
    return replace(fit, how=replace(fit.how, hold_out=near))


def _refit_plainly(fit: AxisFit, log: AxisLog, how: PredictorChoice) -> AxisFit:
    """The plain model of a part of its log, begun from that of all of it.

    Raises:
        LogError: If there are too few predictions.
    """
    if len(prediction_times(log, fit.how, fit.how.hold_out.lead_s)) < 3:
        raise LogError("too few predictions")
    other = replace(fit, log=log)
    theta = fit_to_predictions(_predict_near(other, how), known=fit.found.theta)
    return replace(other, found=fit.found._replace(theta=theta))


def _refit(fit: AxisFit, log: AxisLog, names: tuple[str, ...] | None = None) -> AxisFit:
    """The full fit to a part of its log, by what it is fitted to: windows or predictions.

    Args:
        fit: Of an axis.
        log: The part.
        names: Other parameters than those of the fit.
    """
    other = fit.refit(log, names or fit.problem.names, fit.problem.longest)
    if fit.windowed is None or fit.problem.drift:
        return other
    theta = fit_to_predictions(other)
    return replace(other, found=other.found._replace(theta=theta), windowed=fit.windowed)


def _leave_out_camber(fit: AxisFit) -> AxisFit:
    """The full fit without a camber.

    A force that grows with the place makes up for gain, level and damping where the ball has been;
    on another log the ball is elsewhere.
    """
    names = tuple(name for name in fit.problem.names if name != "camber")
    return fit if names == fit.problem.names else _refit(fit, fit.log, names)


def _cross_validate(
    fit: AxisFit,
    refits: Sequence[Callable[[AxisLog], AxisFit]],
    leads: Sequence[float],
    how: PredictorChoice,
) -> Array | None:
    """Median errors in m of predictions of each half of a log by fits of the other, shape (F, L).

    Args:
        fit: A fit to the log.
        refits: Fit a part of it, in F different ways.
        leads: L lengths of the samples from which predictions start, s.
        how: Constants.

    Returns:
        None if a half has too few windows, or too few predictions are of a ball that moves.
    """
    middle = float(np.median(fit.log.sampled))
    halves = fit.log.between(-np.inf, middle), fit.log.between(middle, np.inf)
    errors: list[Array] = []
    for fitted, tried in (halves, halves[::-1]):
        near = replace(fit.how.hold_out, horizons_s=(how.horizon_s,))
        at = prediction_times(tried, replace(fit.how, hold_out=near), near.lead_s)
        if not len(at):
            return None
        try:
            every = [refit(fitted) for refit in refits]
        except LogError:
            return None
        errors.append(
            np.array(
                [[_find_errors(each, tried, at, lead, how) for lead in leads] for each in every]
            )
        )
    sizes = np.abs(np.concatenate(errors, axis=-1))
    known = np.isfinite(sizes).all(axis=(0, 1))
    return np.median(sizes[..., known], axis=-1) if known.sum() >= how.min_predictions else None


def _find_errors(
    fit: AxisFit, log: AxisLog, at: Array, lead_s: float, how: PredictorChoice
) -> Array:
    """Errors in m of predictions that begin at some times in s; NaN where the ball rests."""
    near = replace(fit.how.hold_out, horizons_s=(how.horizon_s,), lead_s=lead_s)
    found = predict_axis(log, replace(fit, how=replace(fit.how, hold_out=near)), at, follow=False)
    return np.where(found.moves, found.errors("model", how.horizon_s), np.nan)
