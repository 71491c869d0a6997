"""`twin.identify.predictor`: the choice of the fit by which an axis is predicted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from docs.five_numbers import fit_five_numbers_by_scipy, predict_five_numbers
from docs.identify_errors import Rig, simulate_log
from twin.base.errors import LogError
from twin.identify import any_rig, axis_prediction, predictor
from twin.identify.any_rig import identify_axes
from twin.identify.axis_logs import AnyLog, AxisLog, EndStops
from twin.identify.axis_prediction import predict_axis, prediction_times
from twin.identify.plain_model import fit_axis
from twin.identify.predictor import (
    FIVE_NUMBERS,
    AxisPredictor,
    choose_lead,
    choose_predictor,
    fit_five_numbers,
)

PLAIN = Rig(
    seconds=14.0, rate=50.0, gain=6.0, dead_time=0.1, lag=0.0, friction=0.03, viscous=0.3, level=0.1
)
"""A rig that five numbers describe."""


def axis_of(seed: int, rig: Rig) -> AxisLog:
    time, sampled, ball, command, _ = simulate_log(seed, rig)
    return AxisLog(time, command, True, sampled, ball)


@pytest.fixture(scope="module")
def plain():
    return fit_five_numbers(axis_of(1, PLAIN), (0.0, 0.5))


def test_five_numbers_are_those_of_a_rig_that_has_no_more(plain):
    gain = plain.value("gain") / plain.problem.tilt.scale
    assert gain == pytest.approx(PLAIN.gain, rel=0.03)
    assert plain.value("dead_time") == pytest.approx(PLAIN.dead_time, abs=0.006)
    assert plain.value("level") == pytest.approx(PLAIN.level, abs=0.006)
    assert plain.value("friction") == pytest.approx(PLAIN.friction, abs=0.006)
    assert plain.value("viscous") == pytest.approx(PLAIN.viscous, abs=0.06)


@pytest.mark.long
def test_five_numbers_predict_as_well_as_those_that_scipy_fits(plain):
    fitted, unseen = axis_of(1, PLAIN), axis_of(2, PLAIN)
    rival = fit_five_numbers_by_scipy(fitted.time, fitted.tilt, fitted.sampled, fitted.ball)
    found = predict_axis(unseen, plain, prediction_times(unseen), follow=False)
    errors = predict_five_numbers(
        rival, unseen.time, unseen.tilt, unseen.sampled, unseen.ball, found.begin
    )
    own, other = (
        np.nanmedian(np.abs(e[found.moves])) for e in (found.errors("model", 1.0), errors)
    )
    assert own < 1.2 * other
    assert other < 2e-3


AT = np.arange(0.0, 40.0, 0.5)
"""When predictions begin, s."""


def errors_of(size, seed):
    return size * np.random.default_rng(seed).standard_normal(len(AT))


@pytest.mark.parametrize(
    ("by_full", "by_five", "predicts"),
    [(5e-3, 2e-3, "five"), (5e-3, 5e-3, "both"), (2e-3, 5e-3, "full")],
)
def test_a_fit_predicts_alone_only_if_it_is_clearly_better(
    monkeypatch, plain, by_full, by_five, predicts
):
    compared = [errors_of(by_full, 1), errors_of(by_five, 1)]
    monkeypatch.setattr(predictor, "_cross_validate", lambda *_: (compared, AT))
    monkeypatch.setattr(predictor, "_reduce", lambda *_: plain)
    given = SimpleNamespace(windowed=None, explained=False, log=None)
    found, note = choose_predictor(given)
    assert found.fits == {"five": (plain,), "both": (given, plain), "full": (given,)}[predicts]
    assert ("five numbers" in note) is (predicts != "full")
    assert ("mean" in note) is (predicts == "both")


def test_errors_of_one_horizon_count_as_one():
    small, large = errors_of(2e-3, 1), errors_of(3e-3, 2)
    once = predictor._compare(large, small, AT, predictor.PREDICTOR_CHOICE)
    often = [np.repeat(each, 8) for each in (large, small, AT)]
    assert once > 0
    assert predictor._compare(*often, predictor.PREDICTOR_CHOICE) == pytest.approx(once, rel=0.02)
    assert predictor._compare(small, large, AT, predictor.PREDICTOR_CHOICE) == pytest.approx(-once)
    unknown = predictor._compare(large, np.nan * small, AT, predictor.PREDICTOR_CHOICE)
    assert unknown == 0.0


def test_the_mean_of_two_fits_predicts_between_them(plain):
    other = replace(plain, found=plain.found._replace(theta=plain.found.theta * 0.8))
    unseen = axis_of(2, PLAIN)
    at = prediction_times(unseen)
    alone = [AxisPredictor((each,)).predict(unseen, at) for each in (plain, other)]
    both = AxisPredictor((plain, other)).predict(unseen, at)
    for who in ("model", "level followed", "stays"):
        between = (alone[0].by[who] + alone[1].by[who]) / 2
        np.testing.assert_allclose(both.by[who], between)
    wrong = [np.nanmedian(np.abs(each.errors("model", 1.0))) for each in (*alone, both)]
    assert wrong[0] < wrong[2] < wrong[1]


def test_a_log_too_short_to_compare_fits_is_predicted_by_both(monkeypatch, plain):
    def refuse(*_):
        raise LogError("2 stretches")

    monkeypatch.setattr(predictor, "_cross_validate", refuse)
    monkeypatch.setattr(predictor, "_reduce", lambda *_: plain)
    given = SimpleNamespace(windowed=None, explained=False, log=None)
    found, note = choose_predictor(given)
    assert found.fits == (given, plain)
    assert "mean" in note


@pytest.mark.parametrize(
    ("by_full", "by_five", "predicts"), [(5e-3, 5e-3, "five"), (2e-3, 5e-3, "both")]
)
def test_a_model_whose_gain_may_be_zero_does_not_predict_alone(
    monkeypatch, plain, by_full, by_five, predicts
):
    compared = [errors_of(by_full, 1), errors_of(by_five, 1)]
    monkeypatch.setattr(predictor, "_cross_validate", lambda *_: (compared, AT))
    monkeypatch.setattr(predictor, "_reduce", lambda *_: plain)
    given = SimpleNamespace(windowed=None, explained=False, log=None)
    found, note = choose_predictor(given, alone=False)
    assert found.fits == {"five": (plain,), "both": (given, plain)}[predicts]
    assert "may be zero" in note


def test_a_model_that_explains_its_log_is_compared_as_well(monkeypatch, plain):
    compared = [errors_of(5e-3, 1), errors_of(5e-3, 1)]
    monkeypatch.setattr(predictor, "_cross_validate", lambda *_: (compared, AT))
    monkeypatch.setattr(predictor, "_reduce", lambda *_: plain)
    given = SimpleNamespace(windowed=None, explained=True, log=None)
    assert choose_predictor(given)[0].fits == (given, plain)


def test_noise_of_a_log_that_is_explained_is_no_model_error(monkeypatch, plain):
    monkeypatch.setattr(axis_prediction, "_median_error", lambda *_, **__: 0.01)
    assert plain.explained
    assert axis_prediction.refit_for_prediction(plain, 2.5) is plain


@pytest.mark.long
def test_predictions_start_from_more_samples_where_noise_is_all_that_is_wrong(plain):
    noisy = axis_of(3, replace(PLAIN, noise=2e-3, seconds=30.0))
    given = AxisPredictor((replace(plain, log=noisy),))
    found = choose_lead(given)
    assert found.lead_s > 0.4
    at = prediction_times(noisy)
    before, after = (each.predict(noisy, at, follow=False) for each in (given, found))
    medians = [np.nanmedian(np.abs(e.errors("model", 1.0)[e.moves])) for e in (before, after)]
    assert medians[1] < 0.8 * medians[0]
    for baseline in ("stays", "goes on"):  # these do not gain by it
        own, other = (np.nanmedian(np.abs(e.errors(baseline, 1.0))) for e in (before, after))
        assert own == pytest.approx(other, rel=0.05)


def test_predictions_start_from_few_samples_where_the_model_is_wrong(plain):
    wrong = plain.found._replace(theta=plain.found.theta * np.array([0.5, 1, 1, 1, 1]))
    assert choose_lead(AxisPredictor((replace(plain, found=wrong),))).lead_s <= 0.4


@pytest.mark.parametrize(("gained", "lead_s"), [(-3.0, 0.7), (0.8, 0.7), (1.2, 0.4)])
def test_another_lead_is_taken_beyond_one_standard_error_of_the_pairs(
    monkeypatch, plain, gained, lead_s
):
    """Errors of a lead of 0.4 s are better by that many standard errors, each than its own pair."""

    def errors(predicting, _, at, how):
        rng = np.random.default_rng(1)
        sizes = 1e-3 * np.exp(rng.standard_normal(len(at)))  # far apart, but the same for all
        if predicting.lead_s == 0.4:
            return sizes
        scatter = rng.standard_normal(len(at))
        scatter = (scatter - scatter.mean()) / scatter.std(ddof=1)
        horizons = len(np.unique(np.floor(at / how.horizon_s)))
        better = 1e-3 * (scatter + gained / np.sqrt(horizons))
        return sizes + (sizes + np.median(sizes)) * better

    monkeypatch.setattr(predictor, "_find_errors", errors)
    assert plain.explained
    assert choose_lead(AxisPredictor((plain,))).lead_s == lead_s


@pytest.mark.parametrize(
    ("gained", "lead_s"),
    [({0.4: 2.0, 1.2: 2.5}, 0.4), ({0.4: 1.2, 1.2: 2.5}, 1.2), ({0.25: 2.0, 0.4: 2.5}, 0.25)],
)
def test_of_leads_as_good_as_the_best_the_shortest_is_taken(monkeypatch, plain, gained, lead_s):
    monkeypatch.setattr(predictor, "_find_errors", lambda each, *_: each.lead_s)
    monkeypatch.setattr(predictor, "_compare", lambda _, lead, *__: gained.get(lead, 0.0))
    assert choose_lead(AxisPredictor((plain,))).lead_s == lead_s


@pytest.mark.parametrize(
    ("low", "high", "excludes"),
    [(1.0, 2.0, True), (-2.0, -1.0, True), (-1.0, 2.0, False), (None, None, False)],
)
def test_a_gain_is_not_zero_if_its_interval_is_known_and_excludes_it(low, high, excludes):
    verdict = SimpleNamespace(low=low, high=high)
    assert any_rig._excludes_zero(verdict) is excludes


def test_five_numbers_know_end_stops_though_no_window_is_without_a_touch():
    begin = np.arange(0.0, 14.0, 0.25)
    stops = EndStops(-0.3, 0.3, 0.5, np.array([begin, begin + 0.02]))
    log = replace(axis_of(1, PLAIN), stops=stops)
    with pytest.raises(LogError):
        fit_axis(log, FIVE_NUMBERS, 0.7, (0.0, 0.5))
    found = fit_five_numbers(log, (0.0, 0.5))
    assert found.value("gain") / found.problem.tilt.scale == pytest.approx(PLAIN.gain, rel=0.03)
    assert found.log.stops is stops


@pytest.mark.long
def test_five_numbers_are_fitted_to_all_of_a_log(monkeypatch):
    log, begun = axis_of(1, replace(PLAIN, seconds=8.0)), []

    def keep(*given):
        begun.append(given[2])
        return problem(*given)

    problem = axis_prediction._prediction_problem
    monkeypatch.setattr(axis_prediction, "_prediction_problem", keep)
    fit_five_numbers(log, (0.0, 0.5))
    (at,) = begun
    assert at[0] - log.sampled[0] == pytest.approx(0.4, abs=0.01)
    assert log.sampled[-1] - at[-1] == pytest.approx(1.0, abs=0.26)
    assert np.diff(at).max() == pytest.approx(0.25)


def test_five_numbers_begin_from_a_first_look_as_well(monkeypatch, plain):
    guesses = []

    def keep(_, guess, *rest, **named):
        guesses.append(guess)
        return SimpleNamespace(x=guess, cost=1.0)

    monkeypatch.setattr(axis_prediction, "least_squares", keep)
    seen = SimpleNamespace(gain=6.0, delay=0.1, level=0.1, friction=0.03, camber=0.0, damping=0.3)
    wrong = plain.found._replace(theta=plain.found.theta * np.array([0.2, 4, 1, 1, 1]))
    axis_prediction.fit_to_predictions(replace(plain, found=wrong), seen)
    gain = 6.0 * plain.problem.tilt.scale
    assert guesses[0] == pytest.approx([gain, 0.1, 0.1, 0.3, 0.03], rel=1e-3)


def test_each_half_is_predicted_by_a_fit_of_the_other(plain):
    fitted = []

    def refit(log):
        fitted.append((log.sampled[0], log.sampled[-1]))
        return plain

    how = predictor.PREDICTOR_CHOICE
    (errors,), at = predictor._cross_validate(plain, (refit,), how)
    (first, middle), (after, last) = fitted
    assert first < middle < after < last
    assert middle - first == pytest.approx(last - after, abs=0.1)
    assert errors.shape == at.shape
    assert at[0] > middle > at[-1]
    assert np.nanmedian(np.abs(errors)) < 2e-3


@pytest.mark.long
def test_a_log_without_a_full_fit_is_predicted_by_five_numbers(monkeypatch):
    def refuse(*_):
        raise LogError("2 stretches")

    monkeypatch.setattr(any_rig, "select_model", refuse)
    monkeypatch.setattr(any_rig, "fit_usual_parameters", lambda *_: {})
    logs = [AnyLog("rig.csv", {"x": axis_of(s, PLAIN)}, {"x": "rad"}, ()) for s in (1, 2)]
    found = identify_axes(logs[:1], logs[1:])
    assert found.scores[0].median["model"][1] < 3e-3
    assert any("x: predictions are those of a plain model of five" in each for each in found.notes)
    assert any("not identified: x: 2 stretches" in each for each in found.notes)
