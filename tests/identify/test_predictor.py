"""`twin.identify.predictor`: the choice of the fit by which an axis is predicted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from docs.five_numbers import FiveNumbers, fit_five_numbers_by_scipy, predict_five_numbers
from docs.identify_errors import Rig, simulate_log
from twin.base.errors import LogError
from twin.identify import any_rig, axis_prediction, predictor
from twin.identify.any_rig import identify_axes
from twin.identify.axis_logs import AnyLog, AxisLog, EndStops
from twin.identify.axis_prediction import predict_axis, predict_by_levels, prediction_times
from twin.identify.plain_model import fit_axis
from twin.identify.predictor import (
    FIVE_NUMBERS,
    AxisPredictor,
    choose_predictor,
    fit_five_numbers,
)
from twin.identify.verdicts import Predicted

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


def test_five_numbers_find_a_dead_time_above_that_of_windows():
    slow = replace(PLAIN, dead_time=0.6, seconds=24.0)
    assert fit_five_numbers(axis_of(1, slow), (0.0, 0.5)).value("dead_time") == pytest.approx(
        slow.dead_time, abs=0.02
    )


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


def test_the_rival_predicts_what_a_slow_camera_saw():
    log = axis_of(2, replace(PLAIN, rate=200.0))
    seen = slice(None, None, 40)  # 5 in a second
    at = np.arange(2.0, 12.0, 0.4)
    rival = FiveNumbers(PLAIN.gain, PLAIN.level, PLAIN.dead_time, PLAIN.friction, PLAIN.viscous)
    errors = predict_five_numbers(
        rival, log.time, log.tilt, log.sampled[seen], log.ball[seen], at + 0.01
    )
    assert np.isfinite(errors).all()
    assert np.median(np.abs(errors)) < 3e-3


HOW = predictor.PREDICTOR_CHOICE
FIVE = (3e-3, 2e-3, 4e-3, 8e-3)
"""Median errors of five numbers by the length from which they predict, m."""


def choose(monkeypatch, plain, full, five, **given):
    """The choice between a full fit, here one of other values, and five numbers, by their errors.

    Args:
        monkeypatch: Of pytest.
        plain: The five numbers.
        full: Median errors in m by length, or None of a log that is too short.
        five: The same of five numbers.
        given: Further arguments of the choice.
    """
    errors = None if full is None else np.array([full, five])
    monkeypatch.setattr(predictor, "_cross_validate", lambda *_: errors)
    monkeypatch.setattr(predictor, "_reduce", lambda *_: plain)
    other = replace(plain, found=plain.found._replace(theta=plain.found.theta * 0.8))
    found, note = choose_predictor(other, **given)
    ways = zip(found.fits, found.weights, strict=True)
    share = sum(weight for fit, weight in ways if fit.found is plain.found)
    assert found.weights.sum() == pytest.approx(1)
    return found, share, note


@pytest.mark.parametrize("ratio", [0.2, 0.5, 1.0, 2.0, 5.0])
def test_the_better_fit_has_more_weight(monkeypatch, plain, ratio):
    _, share, note = choose(monkeypatch, plain, ratio * np.array(FIVE), FIVE)
    assert share == pytest.approx(ratio**4 / (1 + ratio**4), abs=HOW.min_weight)
    assert bool(share) is (ratio > 0.2)
    assert ("five numbers one half of the log predicts the other to 2.0 mm" in note) is bool(share)
    assert (f"to {100 * share:.0f} % those of a plain model" in note) is bool(0 < share < 1)


def test_weights_fall_with_the_error_and_of_equal_errors_are_equal():
    weights = predictor.find_weights(np.full((2, 4), 3e-3), HOW)
    np.testing.assert_allclose(weights, 1 / 8)
    errors = np.array([[2e-3, 3e-3], [4e-3, 1.0]])
    weights = predictor.find_weights(errors, HOW)
    assert weights[0, 0] / weights[0, 1] == pytest.approx((3 / 2) ** HOW.weight_power)
    assert weights[1, 1] == 0
    np.testing.assert_allclose(predictor.find_weights(7 * errors, HOW), weights)


@pytest.mark.parametrize("full", [1e-3, 1.9e-3, 2.1e-3, 3e-3])
def test_a_model_whose_gain_may_be_zero_has_at_most_half_the_weight(full):
    weights = predictor.find_weights(np.array([[full], [2e-3]]), HOW, alone=False)
    share = min(0.5, 1 / (1 + (full / 2e-3) ** HOW.weight_power))
    np.testing.assert_allclose(weights[:, 0], [share, 1 - share])


def test_it_has_at_most_half_the_weight_where_small_weights_are_left_out():
    errors = np.array([[1.0, 9.0, 9.0, 9.0], [2.0, 3.9, 3.9, 3.9]]) / 1000
    weights = predictor.find_weights(errors, HOW, alone=False)
    np.testing.assert_allclose(weights, [[0.5, 0, 0, 0], [0.5, 0, 0, 0]])


def test_a_note_states_a_gain_that_may_be_zero(monkeypatch, plain):
    _, share, note = choose(monkeypatch, plain, np.divide(FIVE, 2), FIVE, alone=False)
    assert share == pytest.approx(0.5)
    assert "may be zero" in note


def test_a_log_too_short_to_compare_is_predicted_by_both_fits_from_all_lengths(monkeypatch, plain):
    found, share, note = choose(monkeypatch, plain, None, None)
    assert share == pytest.approx(0.5)
    assert "too short" in note
    np.testing.assert_allclose(found.weights, 1 / (2 * len(HOW.leads_s)))
    leads = [fit.how.hold_out.lead_s for fit in found.fits]
    assert leads == pytest.approx(2 * HOW.leads_s)


def test_it_is_predicted_by_five_numbers_alone_where_the_gain_may_be_zero(monkeypatch, plain):
    found, share, _ = choose(monkeypatch, plain, None, None, alone=False)
    assert share == pytest.approx(1)
    np.testing.assert_allclose(found.weights, 1 / len(HOW.leads_s))


def bent_fit(plain, **values):
    """A fit of five numbers and a camber to the log of ``plain``, with these values of it."""
    names = (*FIVE_NUMBERS, "camber")
    known = {name: plain.value(name) for name in FIVE_NUMBERS} | {"camber": 0.0} | values
    theta = np.array([[known[name] for name in names]])
    problem = replace(plain.problem, names=names)
    return replace(plain, problem=problem, found=plain.found._replace(theta=theta))


@pytest.mark.parametrize("alone", [True, False])
def test_a_camber_predicts_only_where_the_gain_is_not_zero(monkeypatch, plain, alone):
    bent = bent_fit(plain, camber=-2.0, gain=0.5 * plain.value("gain"))
    monkeypatch.setattr(predictor, "_cross_validate", lambda *_: np.full((1, 4), 1e-3))
    monkeypatch.setattr(predictor, "_reduce", refuse)
    found, _ = choose_predictor(bent, alone=alone)
    for fit in found.fits:
        assert ("camber" in fit.problem.names) is alone
        # what is left is fitted again
        assert fit.value("gain") == pytest.approx((0.5 if alone else 1) * plain.value("gain"), 0.1)


def refuse(*_):
    raise LogError("too few windows")


def test_four_samples_are_enough_to_start_from(plain):
    for step, least in ((0.01, 0.256), (0.1, 0.4), (0.2, 0.704), (0.3, 1.2), (0.6, 1.2)):
        slow = replace(plain.log, sampled=np.arange(0, 20, step), ball=np.zeros(round(20 / step)))
        leads = predictor._possible_leads(slow, HOW)
        assert leads == pytest.approx([each for each in HOW.leads_s if each >= least - 1e-9])


def predictions(model, followed):
    """Predictions every half second of a ball that moves, with these errors after 1 s in m."""
    begin, ahead = 0.5 * np.arange(len(model)), np.array([-0.1, 0.0, 0.5, 1.0])
    ball = np.tile([0.0, 0.0, 0.1, 0.2], (len(begin), 1))
    by = {
        who: ball + np.multiply.outer(errors, ahead > 0)
        for who, errors in (("model", np.array(model)), ("level followed", np.array(followed)))
    }
    return Predicted(begin, np.tile(ahead, (len(begin), 1)), ball, by)


def test_a_level_is_followed_once_it_has_predicted_better_by_more_than_chance():
    often = predictions([2e-3] * 12, [1e-3] * 12)
    errors = axis_prediction.choose_level(often).errors("level followed", 1.0)
    # a prediction is seen 1.06 s after it begins; one by itself is chance
    np.testing.assert_allclose(errors, np.where(np.arange(12) < 4, 2e-3, 1e-3))
    by_turns = predictions([1e-3, 2.1e-3] * 20, [2e-3, 1e-3] * 20)
    errors = axis_prediction.choose_level(by_turns).errors("level followed", 1.0)
    np.testing.assert_allclose(errors, by_turns.errors("model", 1.0))


def test_the_mean_of_ways_is_that_of_the_positions_of_the_same_times(plain):
    wrong = plain.found.theta + np.array([0, 0, 0.3, 0, 0])  # alone it follows the level
    other = replace(plain, found=plain.found._replace(theta=wrong))
    unseen = axis_of(2, PLAIN)
    at = prediction_times(unseen)
    ways = (plain.with_lead(HOW.leads_s[3]), other.with_lead(HOW.leads_s[0]))
    alone = [predict_by_levels(unseen, each, at) for each in ways]
    assert alone[0].ahead.shape[1] > alone[1].ahead.shape[1]
    both = AxisPredictor(ways, np.array([0.25, 0.75])).predict(unseen, at)
    for horizon in (0.5, 1.0, 2.0):
        errors = {
            who: alone[0].errors(who, horizon) / 4 + 3 * alone[1].errors(who, horizon) / 4
            for who in ("model", "level followed", "stays")
        }
        for who in ("model", "stays"):
            np.testing.assert_allclose(both.errors(who, horizon), errors[who], atol=1e-9)
        # the mean with the level that is followed, or without
        nearest = [np.abs(both.errors("level followed", horizon) - errors[who]) for who in errors]
        assert np.nanmax(np.minimum(*nearest[:2])) < 1e-9
    assert (both.moves == alone[1].moves).all()


def test_noise_of_a_log_that_is_explained_is_no_model_error(monkeypatch, plain):
    monkeypatch.setattr(axis_prediction, "_median_error", lambda *_, **__: 0.01)
    assert plain.explained
    assert axis_prediction.refit_for_prediction(plain, 2.5) is plain


def lengths_by(plain, log, theta):
    """Weights of the lengths from which five numbers of these values predict a log, shape (4,)."""
    known = replace(plain, found=plain.found._replace(theta=theta))
    errors = predictor._cross_validate(replace(plain, log=log), [lambda _: known], HOW.leads_s, HOW)
    return predictor.find_weights(errors, HOW)[0]


def test_predictions_start_from_more_samples_where_noise_is_all_that_is_wrong(plain):
    noisy = axis_of(3, replace(PLAIN, noise=2e-3, seconds=30.0))
    weights = lengths_by(plain, noisy, plain.found.theta)
    assert weights[2:].sum() > 0.7


def test_predictions_start_from_few_samples_where_the_model_is_wrong(plain):
    wrong = plain.found.theta * np.array([0.5, 1, 1, 1, 1])
    assert lengths_by(plain, plain.log, wrong)[:2].sum() > 0.7


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


def test_each_half_is_predicted_by_a_fit_of_the_other(monkeypatch, plain):
    fitted = []

    def refit(log):
        fitted.append((log.sampled[0], log.sampled[-1]))
        return plain

    tried = []
    monkeypatch.setattr(
        predictor,
        "_find_errors",
        lambda _, log, at, lead_s, how: tried.append(log.sampled[0]) or np.full(len(at), lead_s),
    )
    errors = predictor._cross_validate(plain, (refit,), (0.4, 0.25), HOW)
    (first, middle), (after, last) = fitted
    assert first < middle < after < last
    assert middle - first == pytest.approx(last - after, abs=0.1)
    assert tried == [after, after, first, first]
    np.testing.assert_allclose(errors, [[0.4, 0.25]])


def test_too_few_predictions_of_a_ball_that_moves_compare_nothing(monkeypatch, plain):
    moving = [HOW.min_predictions - 1]

    def errors(_, log, at, *rest):
        count = moving[0] if log.sampled[0] > 1.0 else 0
        return np.where(np.arange(len(at)) < count, 1e-3, np.nan)

    monkeypatch.setattr(predictor, "_find_errors", errors)
    assert predictor._cross_validate(plain, [lambda _: plain], (0.4,), HOW) is None
    moving[0] += 1
    assert predictor._cross_validate(plain, [lambda _: plain], (0.4,), HOW) is not None


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
