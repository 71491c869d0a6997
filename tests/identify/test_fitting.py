"""What a fit is made of: servo, replay, intervals and verdicts."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.identify.bootstrap import Estimate, estimate
from twin.identify.plate_motion import servo_response
from twin.identify.prepare import Segment
from twin.identify.replay import STEP, AccelerationField, replay
from twin.identify.rests import SPEED_SPAN, rested
from twin.identify.verdict import BOUNDED, IDENTIFIED, _servo
from twin.scenario import load
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction


@pytest.mark.parametrize(("lag", "word"), [(1.2e-4, BOUNDED), (2.0e-4, IDENTIFIED)])
def test_drives_faster_than_a_scenario_takes_are_bounded(lag, word):
    draws = lag + 1e-5 * np.random.default_rng(1).standard_normal((400, 1))
    verdict = _servo(Estimate(np.array([lag]), draws, np.array([True]), 20))
    assert verdict.word == word
    if verdict.value is not None:
        load("circle", [f"plant.servo.bandwidth_hz={verdict.value}"])


def test_a_servo_solves_its_first_order_equation():
    period, lag, parts = 0.002, 0.02, 2000
    command = np.random.default_rng(0).normal(0, 0.2, (50, 1))
    angle, speed = servo_response(command, period, lag)
    truth, step = np.zeros(2), period / parts
    for k in range(50):
        assert angle[k, 0] == pytest.approx(truth[0], abs=1e-7)
        assert speed[k, 0] == pytest.approx(truth[1], abs=1e-5)
        for _ in range(parts):
            truth = truth + step * np.array([truth[1], (command[k, 0] - truth[1]) / lag])


def test_a_replay_rolls_as_the_exact_plant_does():
    model, friction = BallPlate(), Friction(rolling=2e-4, breakaway_ratio=1.5)
    plant = ExactPlant(model, rigs=1, step=0.001, friction=friction)
    plant.start(np.array([[0.02, 0.0, -0.03, 0.0]]))
    states, rng = [plant.state.copy()], np.random.default_rng(3)
    swing = rng.uniform(0.5, 1.5, 2)
    for k in range(500):
        t = 0.004 * (k + 1)
        plant.advance(np.array([[0.05 * np.sin(swing[0] * t), 0.04 * np.sin(swing[1] * t)]]), 4)
        states.append(plant.state.copy())
    states = np.array(states)[:, 0]
    field = AccelerationField.of(model, states[None, :, 2::4], states[None, :, 3::4])
    start = states[0, [0, 4, 1, 5]][:, None, None]
    places, _ = replay(field, model, friction, np.zeros((2, 1, 1)), start)
    assert STEP == 0.004
    way = np.abs(np.diff(states[:, 0::4], axis=0)).sum()
    assert way > 0.1
    assert np.abs(places[:, :, 0, 0] - states[:, 0::4]).max() < 0.005 * way


def test_a_ball_that_has_rested_a_while_starts_as_one_that_was_watched_all_the_while():
    model = BallPlate()
    friction = Friction(rolling=2e-4, breakaway_ratio=2.0, stribeck_speed=0.005, dwell_time=1.5)
    # the plate rises so slowly that how old the contact is decides when the ball starts
    count, later = 1000, 200
    angle = np.zeros((1, count, 2))
    angle[..., 0] = 0.004 + 0.01 * STEP * np.arange(count)
    rate = np.full_like(angle, 0.0)
    rate[..., 0] = 0.01

    def replayed(first, rested):
        field = AccelerationField.of(model, angle[:, first:], rate[:, first:])
        start = np.zeros((4, 1, 1))
        return replay(
            field, model, friction, np.zeros((2, 1, 1)), start, rested=np.array([rested])
        )[0][:, 0, 0, 0]

    watched = replayed(0, 0.2)
    assert watched[later] == 0  # it still rests
    assert watched[-1] > 0.01
    np.testing.assert_allclose(
        replayed(later, 0.2 + later * STEP), watched[later:], rtol=1e-9, atol=1e-12
    )
    # one that was never seen to come to rest is held longer
    assert np.argmax(replayed(later, np.inf) > 0) > 20 + np.argmax(watched[later:] > 0)


def test_how_long_a_ball_has_rested_is_counted_from_when_it_was_seen_to_stop():
    time = np.arange(0, 20, 0.01)
    # at rest, rolls from 4 s to 8 s, rests, rolls again from 11 s to 15 s, rests
    rolls = ((time > 4) & (time < 8)) | ((time > 11) & (time < 15))
    x = np.cumsum(np.where(rolls, 0.05, 0.0)) * 0.01
    ball = np.stack((x, 0 * x), axis=-1)
    segment = Segment(time, np.zeros((len(time), 2)), None, time, ball)
    at = np.array([2.0, 6.0, 9.0, 10.5, 13.0, 19.0])
    np.testing.assert_allclose(
        rested(segment, at), [np.inf, 0, 1, 2.5, 0, 4], atol=SPEED_SPAN / 2 + 0.02
    )


def test_bootstrap_intervals_of_a_linear_fit_cover_the_truth_as_often_as_they_say():
    rng, truth, covered = np.random.default_rng(5), np.array([1.0, -2.0]), 0
    for _ in range(200):
        slopes = rng.normal(size=(15, 20, 2))
        noise = rng.normal(size=(15, 20)) * rng.uniform(0.5, 2, (15, 1))
        r, normal = noise, np.einsum("wmi,wmj->wij", slopes, slopes)
        step = np.linalg.solve(normal.sum(axis=0), np.einsum("wmi,wm->i", slopes, r))
        left = r - slopes @ step
        fit = estimate(truth + step, normal, np.einsum("wmi,wm->wi", slopes, left))
        covered += int(abs(fit.value[0] - truth[0]) <= fit.half_width[0])
    assert 180 <= covered <= 199
