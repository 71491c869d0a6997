"""What a fit is made of: servo, replay, intervals and verdicts."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.identify.bootstrap import Estimate, estimate
from twin.identify.plate_motion import servo_response
from twin.identify.prepare import Segment
from twin.identify.replay import PACE, STEP, AccelerationField, replay
from twin.identify.rests import paces, rests, speed
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


def test_a_replay_from_rest_goes_on_as_one_that_has_seen_the_ball_come_to_rest():
    model = BallPlate()
    friction = Friction(rolling=2e-4, breakaway_ratio=2.0, dwell_time=1.0, stribeck_speed=0.005)
    time = STEP * np.arange(1000)
    holds = friction.rolling / model.radius  # the tilt that a rolling ball just goes on at
    # rolls out, rests, and is tilted away: the longer it has rested, the later it goes
    tilt = holds * np.clip(2.0 * (time - 1.2), 0.0, 2.5)
    angle = np.stack((np.zeros_like(tilt), -tilt), axis=-1)[None]
    rate = np.gradient(angle, STEP, axis=1)
    field = AccelerationField.of(model, angle, rate)
    start = np.array([0.0, 0.0, 0.05, 0.0])[:, None, None]
    level = np.zeros((2, 1, 1))
    places, speeds = replay(field, model, friction, level, start)
    speed = np.hypot(*speeds[:, :, 0, 0].T)
    at = round(1.4 / STEP)
    assert speed[:10].min() > 0.04
    assert speed[round(1.25 / STEP) : at + 1].max() == 0
    assert speed[-1] > 0.01
    rest = AccelerationField.of(model, angle[:, at:], rate[:, at:])
    begun = np.concatenate((places[at], speeds[at]))
    paces = np.interp(1.4 - PACE * np.arange(200, 0, -1), time, speed)[None]
    told, untold = (
        replay(rest, model, friction, level, begun, paces=each)[0][:, :, 0, 0]
        for each in (paces, None)
    )
    way = np.hypot(*(places[-1] - places[at])[:, 0, 0])
    assert np.abs(told - places[at:, :, 0, 0]).max() < 0.02 * way
    assert np.abs(untold - places[at:, :, 0, 0]).max() > 0.1 * way


def test_how_a_ball_went_before_a_window_is_measured_but_for_its_rests():
    rng, time = np.random.default_rng(2), 0.002 * np.arange(4000)
    x = 0.06 * (np.minimum(time, 3.0) + np.maximum(time - 4.0, 0.0))
    ball = np.stack((x, np.zeros_like(x)), axis=-1) + 3e-4 * rng.standard_normal((len(x), 2))
    segment = Segment(time, np.zeros_like(ball), None, time, ball)
    found = paces(segment, np.array([3.5, 7.0]))
    assert found.shape == (2, 200)
    before = 3.5 - PACE * np.arange(200, 0, -1)
    assert found[0, before < 2.8] == pytest.approx(0.06, abs=0.01)
    assert (found[0, before > 3.3] == 0.0).all()  # not what noise makes of a rest
    since = 7.0 - PACE * np.arange(200, 0, -1)
    assert (found[1, (since > 3.3) & (since < 3.7)] == 0.0).all()
    assert found[1, since > 4.2] == pytest.approx(0.06, abs=0.01)


@pytest.mark.parametrize(("creep", "count"), [(0.0, 1), (0.002, 0)])
def test_a_ball_that_creeps_does_not_rest(creep, count):
    rng, time = np.random.default_rng(2), 0.002 * np.arange(3000)
    x = 0.06 * (np.minimum(time, 3.0) + np.maximum(time - 4.0, 0.0))
    x = x + creep * np.clip(time - 3.0, 0.0, 1.0)
    ball = np.stack((x, np.zeros_like(x)), axis=-1) + 3e-4 * rng.standard_normal((len(x), 2))
    found = rests(time, ball, speed(time, ball))
    assert len(found) == count
    for first, last in found:
        assert 2.9 < first < 3.2
        assert 3.8 < last < 4.1


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
