"""Chooses the fits by which an axis is predicted: the full one, five numbers, or both together.

The five numbers are gain, dead time, level, viscous friction and Coulomb friction, fitted to the
errors of predictions. A full model in error may explain windows well and predict badly, and noise
may hide such an error. So each half of the log is predicted by fits of the other. If one of the two
fits is better by more than the standard error of their comparison, it predicts alone; else the mean
of both does, which is seldom much worse than the better one. A full model whose gain may be zero
predicts in the mean where it is clearly better, and else not at all. Five numbers also predict
alone where it cannot be fitted.
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
from twin.identify.axis_prediction import fit_to_predictions, predict_axis, prediction_times
from twin.identify.axis_problem import AxisProblem
from twin.identify.command_model import TiltHistory
from twin.identify.first_look import FirstLook
from twin.identify.plain_model import AxisFit, fit_from_guesses, guess_from
from twin.identify.verdicts import HOLD_OUT, Predicted, absolute_quantile
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
        leads_s: Lengths of the samples from which a prediction may start: long ones average noise,
            short ones forget errors of the model.
        long_lead_s: The length where the model explains the log.
        brief_lead_s: The length where it does not.
        min_lead_samples: Smallest number of samples of such a length.
        lead_interval_s: Time between the predictions by which these are compared.
        max_lead_predictions: Largest number of these.
        accepted_stds: A fit predicts alone, and another length is taken, if it is better by more
            standard errors of the comparison; by up to so many, a length is no worse than the best.
    """

    windows_s: tuple[float, ...] = (1.4, 0.7)
    first_residual_m: float = 2e-3
    horizon_s: float = 1.0
    interval_s: float = 0.25
    leads_s: tuple[float, ...] = (0.25, 0.4, 0.7, 1.2)
    long_lead_s: float = 0.7
    brief_lead_s: float = 0.25
    min_lead_samples: int = 5
    lead_interval_s: float = 0.125
    max_lead_predictions: int = 250
    accepted_stds: float = 1.0


PREDICTOR_CHOICE = PredictorChoice()


@dataclass(frozen=True)
class AxisPredictor:
    """Fits of an axis whose predictions are averaged.

    Attributes:
        fits: The fits, to the same log.
        lead_s: Length of the samples from which a prediction starts, s.
    """

    fits: tuple[AxisFit, ...]
    lead_s: float = HOLD_OUT.lead_s

    @property
    def explained(self) -> bool:
        """Whether a fit explains the log, so that no other model leaves much less."""
        return any((fit.windowed or fit).explained for fit in self.fits)

    def predict(self, log: AxisLog, at: Array, *, follow: bool = True) -> Predicted:
        """Predict from times in s, shape (W,), by the samples before them.

        Args:
            log: The axis, held out.
            at: When predictions begin.
            follow: Whether to predict with a followed level and without friction as well.
        """
        every = [
            predict_axis(log, fit.with_lead(self.lead_s), at, follow=follow) for fit in self.fits
        ]
        mean = {who: np.mean([each.by[who] for each in every], axis=0) for who in every[0].by}
        return replace(every[0], by=mean)


def choose_predictor(
    fit: AxisFit,
    how: PredictorChoice = PREDICTOR_CHOICE,
    *,
    alone: bool = True,
    look: FirstLook | None = None,
) -> tuple[AxisPredictor, str]:
    """The fits that predict best, and a note if they are not the given one alone.

    A fit that explains its log is compared as well: noise may hide what it lacks. So is one that
    leaves the gain open: its terms make up for each other, which predictions need not show.

    Args:
        fit: The full fit of an axis.
        how: Constants.
        alone: Whether it may predict alone: its gain is not zero.
        look: A first look at its log, which is a guess of the five numbers as well.
    """
    full = AxisPredictor((fit,))
    try:
        plain = _reduce(fit, look, how)
    except LogError:
        return full, ""
    fits, why = _choose_fits(fit, plain, how)
    if not alone:
        fits = (fit, plain) if fits[-1] is fit else (plain,)
        why = f"the gain of the full model may be zero; {why}"
    if fits[-1] is fit:
        return full, ""
    whose = "the mean of the full model and" if len(fits) > 1 else "those of"
    return AxisPredictor(fits), f"predictions are {whose} {describe_five_numbers(plain)}: {why}"


def _choose_fits(
    full: AxisFit, plain: AxisFit, how: PredictorChoice
) -> tuple[tuple[AxisFit, ...], str]:
    """The better one of two fits to a log, or both where that is unclear, and why.

    Args:
        full: By the full model.
        plain: By five numbers.
        how: Constants.
    """
    refits = (lambda log: _refit(full, log), lambda log: _refit_plainly(plain, log, how))
    try:
        (by_full, by_plain), at = _cross_validate(full, refits, how)
    except LogError:  # a half has too few windows
        return (full, plain), "the log is too short to compare them"
    gained = _compare(by_full, by_plain, at, how)
    first, second = (1000 * absolute_quantile(each, 0.5) for each in (by_full, by_plain))
    why = f"by five numbers one half of the log predicts the other to {second:.1f} mm, by the full "
    why += f"model to {first:.1f} mm"
    if abs(gained) <= how.accepted_stds:
        return (full, plain), why
    return ((plain,) if gained > 0 else (full,)), why


def choose_lead(predictor: AxisPredictor, how: PredictorChoice = PREDICTOR_CHOICE) -> AxisPredictor:
    """The predictor with the length of samples from which its predictions of its log start best.

    A long one where the model explains the log, so that noise is all that is wrong; a brief one
    where it does not, as what the model lacks moves the ball in that time, too. Others are taken if
    one is clearly better: the shortest that is not clearly worse than the best, for what the model
    lacks may be more in another log (the rule of one standard error of Breiman et al. 1984).

    Args:
        predictor: Of an axis.
        how: Constants.
    """
    fit = predictor.fits[0]
    step = float(np.median(np.diff(fit.log.sampled)))
    leads = [each for each in how.leads_s if each >= (how.min_lead_samples - 0.5) * step]
    leads = leads or [max(how.leads_s)]
    usual = how.long_lead_s if predictor.explained else how.brief_lead_s
    usual = min(leads, key=lambda each: abs(each - usual))
    often = replace(fit.how.hold_out, interval_s=how.lead_interval_s)
    at = prediction_times(fit.log, replace(fit.how, hold_out=often), max(leads))
    at = at[:: max(1, -(-len(at) // how.max_lead_predictions))]
    ways = {each: replace(predictor, lead_s=each) for each in leads}
    if not len(at):
        return ways[usual]
    errors = {lead: _find_errors(each, fit.log, at, how) for lead, each in ways.items()}
    gained = {lead: _compare(errors[usual], each, at, how) for lead, each in errors.items()}
    best = max(gained.values())
    if best <= how.accepted_stds:
        return ways[usual]
    return ways[min(lead for lead, each in gained.items() if each >= best - how.accepted_stds)]


def _find_errors(predictor: AxisPredictor, log: AxisLog, at: Array, how: PredictorChoice) -> Array:
    """Errors in m of predictions that begin at some times in s; NaN where the ball rests."""
    found = predictor.predict(log, at, follow=False)
    return np.where(found.moves, found.errors("model", how.horizon_s), np.nan)


def _compare(errors: Array, others: Array, at: Array, how: PredictorChoice) -> float:
    """By how many standard errors other predictions are better than some; 0 if unknown.

    By the mean logarithm of errors plus their median, shape (W,), of predictions that begin at the
    same times: neither large errors nor those near zero decide. Predictions of one horizon count as
    one.
    """
    sizes = np.abs((errors, others))
    known = np.isfinite(sizes).all(axis=0)
    usual = float(np.median(sizes[:, known])) if known.any() else 0.0
    ratio = -np.diff(np.log(sizes + usual), axis=0)[0]
    independent = len(np.unique(np.floor(at[known] / how.horizon_s)))
    if independent < 2:
        return 0.0
    spread = float(np.std(ratio[known], ddof=1)) / np.sqrt(independent)
    return float(np.mean(ratio[known])) / max(spread, 1e-12)


def fit_five_numbers(
    log: AxisLog,
    delays: tuple[float, float],
    look: FirstLook | None = None,
    fitting: AxisFitting = AXIS_FITTING,
    how: PredictorChoice = PREDICTOR_CHOICE,
) -> AxisFit:
    """The plain model of an axis from no first guess, or a first look.

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


def _refit(fit: AxisFit, log: AxisLog) -> AxisFit:
    """The full fit to a part of its log, by what it is fitted to: windows or predictions."""
    other = fit.refit(log, fit.problem.names, fit.problem.longest)
    if fit.windowed is None or fit.problem.drift:
        return other
    return replace(other, found=other.found._replace(theta=fit_to_predictions(other)))


def _cross_validate(
    fit: AxisFit, refits: Sequence[Callable[[AxisLog], AxisFit]], how: PredictorChoice
) -> tuple[list[Array], Array]:
    """Errors in m of predictions of each half of a log by fits of the other, and their times in s.

    Args:
        fit: A fit to the log.
        refits: Fit a part of it, in different ways.
        how: Constants.

    Raises:
        LogError: If a half has too few windows.
    """
    middle = float(np.median(fit.log.sampled))
    halves = fit.log.between(-np.inf, middle), fit.log.between(middle, np.inf)
    errors: list[list[Array]] = [[] for _ in refits]
    times = []
    for fitted, tried in (halves, halves[::-1]):
        at = prediction_times(tried, fit.how, fit.how.hold_out.lead_s)
        if not len(at):
            raise LogError("no predictions")
        times.append(at)
        for refit, found in zip(refits, errors, strict=True):
            found.append(_find_errors(AxisPredictor((refit(fitted),)), tried, at, how))
    return [np.concatenate(each) for each in errors], np.concatenate(times)
