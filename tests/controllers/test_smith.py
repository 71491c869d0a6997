"""Tests of `controllers.smith`."""

import numpy as np
import pytest
from observing import measured

from controllers.observers import ExtendedKalman, Kalman, Luenberger, NonlinearLuenberger
from controllers.smith import Smith

T = 0.002
MODELS = [Luenberger, Kalman, NonlinearLuenberger, ExtendedKalman]
DELAYS = [0.0, 0.0007, 0.002, 0.042, 0.04256]


class Plant:
    """What an observer takes for the truth, seen late: the ball as it was, the plate as it is."""

    def __init__(self, model, x):
        self.model = model
        model.start(x)
        self.past = [model.x]

    def advance(self, u):
        self.model.predict(u)
        self.past.append(self.model.x)

    @property
    def x(self):
        return self.past[-1]

    def ball(self, ago):
        """Ball position some seconds ago, on a straight line between two ticks."""
        whole = int(ago / T + 1e-9)
        share = ago / T - whole
        newer, older = (self.past[max(len(self.past) - 1 - n, 0)] for n in (whole, whole + 1))
        return ((1 - share) * newer + share * older)[..., 0::4]

    def measure(self, delay, age=0.0, touched=True):
        y = self.x[..., 0::2].copy()
        age = np.broadcast_to(age, y.shape[:-1])
        for rig in np.ndindex(age.shape):
            y[rig][0::2] = self.ball(delay + age[rig])[rig]
        return measured(y, touched)._replace(age=age)


def swing(tick, rigs=2):
    """Accelerations that swing the plate to and fro, each rig in its own phase."""
    return 3 * np.cos(3 * np.pi * tick * T + np.arange(2.0 * rigs).reshape(rigs, 2))


def follow(observer, plant, delay, ticks, age=lambda tick: 0.0):
    """Largest error of the estimates after each tick's measurement."""
    errors = []
    for tick in range(ticks):
        x = observer.correct(plant.measure(delay, age(tick)))
        errors.append(np.abs(x - plant.x).max())
        u = swing(tick, len(plant.x))
        observer.predict(u)
        plant.advance(u)
    return np.array(errors)


def start(rigs=2, seed=0):
    """States at rest: before the start the ball has always been where it is."""
    x = np.random.default_rng(seed).uniform(-0.1, 0.1, (rigs, 8))
    x[:, 1::2] = 0
    return x


@pytest.mark.long
@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("delay", DELAYS)
def test_perfect_model_without_noise_takes_the_dead_time_away_entirely(kind, delay):
    observer, plant = Smith(observer=kind(), delay=delay), Plant(kind(), start())
    observer.start(plant.x)
    assert follow(observer, plant, delay, 150).max() < 1e-12


@pytest.mark.parametrize("rigs", [1, 3])
def test_position_waiting_for_the_next_frame_is_taken_for_as_old_as_it_is(rigs):
    observer, plant = Smith(observer=Luenberger()), Plant(Luenberger(), start(rigs))
    observer.start(plant.x)

    def age(tick):
        return (np.array([0.0, 0.003, 0.0123])[:rigs] + tick * T) % (1 / 58)

    assert follow(observer, plant, 0.042, 300, age).max() < 1e-12


@pytest.mark.parametrize("kind", [Luenberger, Kalman])
def test_no_dead_time_leaves_the_observer_as_it_is(kind):
    rng = np.random.default_rng(1)
    bare, wrapped = kind(), Smith(observer=kind(), delay=0)
    for observer in (bare, wrapped):
        observer.start(np.zeros((3, 8)))
    for _ in range(20):
        y = rng.normal(size=(3, 4))
        expected, found = (observer.correct(measured(y)) for observer in (bare, wrapped))
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
        for observer in (bare, wrapped):
            observer.predict(y[:, :2])


def delayed_error_step(observer, ticks):
    """Step of the stacked errors of now and the past when the ball's innovation comes late.

    The error is e[k] = (I - L_p C_p) A e[k-1] - L_b C_b e[k - ticks], with plate p and ball b.
    """
    C = np.eye(8)[::2]
    ball = observer.L[:, 0::2] @ C[0::2]
    plate = observer.L[:, 1::2] @ C[1::2]
    step = np.eye(8 * (ticks + 1), k=-8)
    step[:8] = 0
    step[:8, :8] = (np.eye(8) - plate) @ observer.A
    step[:8, 8 * (ticks - 1) : 8 * ticks] -= ball
    return step


@pytest.mark.parametrize("delay", [0.042, 0.05, 0.06])
def test_error_from_a_wrong_start_runs_through_a_loop_with_the_dead_time_in_it(delay):
    inner = Luenberger()
    plant = Plant(Luenberger(), start())
    observer = Smith(observer=inner, delay=delay)
    observer.start(plant.x + 0.01)
    envelope = follow(observer, plant, delay, 2000).reshape(10, 200).max(axis=1)
    rate = np.log(envelope[-1] / envelope[-4]) / (600 * T)
    modes = np.linalg.eigvals(delayed_error_step(inner, round(delay / T)))
    slowest = np.log(np.abs(modes).max()) / T
    np.testing.assert_allclose(rate, slowest, rtol=0.1, atol=0.02)


@pytest.mark.parametrize(("age", "touched"), [(0.0, False), (0.2, True)])
def test_ball_not_felt_or_too_long_ago_corrects_nothing_but_the_plate_still_does(age, touched):
    inner = Luenberger()
    observer = Smith(observer=inner)
    observer.start(np.zeros((1, 8)))
    y = np.array([[0.1, 0.01, 0.1, -0.02]])
    x = observer.correct(measured(y, touched)._replace(age=np.full(1, age)))
    np.testing.assert_allclose(x[0], inner.L @ [0, 0.01, 0, -0.02], rtol=1e-13)


def test_ball_that_comes_back_is_compared_with_the_estimate_of_then():
    observer, plant = Smith(observer=Luenberger()), Plant(Luenberger(), start())
    observer.start(plant.x)
    for tick in range(200):
        x = observer.correct(plant.measure(0.042, touched=not 50 < tick < 120))
        assert np.abs(x - plant.x).max() < 1e-12
        observer.predict(swing(tick))
        plant.advance(swing(tick))
