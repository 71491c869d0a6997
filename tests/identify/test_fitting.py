"""What a fit is made of: servo, replay, intervals and verdicts."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.identify.bootstrap import Estimate, estimate
from twin.identify.plate_motion import servo_response
from twin.identify.replay import STEP, AccelerationField, replay
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
