"""Tests of `controllers.ballplate`."""

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from controllers.interfaces import Measurement
from controllers.observers import DisturbanceObserver
from controllers.observers.disturbance import gains

MODEL = BallPlate()
T = 0.002
PUSH = np.array([0.03, -0.02])


def followed(observer, ticks, every=1, rigs=1, older=0.0):
    """Estimates of balls on level plates under a constant force, measured late, in closed form.

    Args:
        observer: What estimates.
        ticks: How long.
        every: Control periods from one sample to the next.
        rigs: How many.
        older: Age in s that a sample has when it is handed over.
    """
    found = []
    observer.start(np.zeros((rigs, 8)))
    back = round(observer.delay / T)
    for tick in range(ticks):
        seen = tick - tick % every
        t, late = tick * T, max((seen - back) * T - older, 0.0)
        y = np.zeros((rigs, 4))
        y[:, 0::2] = PUSH * late**2 / 2
        age = np.full(rigs, (tick - seen) * T + older)
        x = observer.correct(Measurement(t, y, age, np.ones(rigs, bool)))
        observer.predict(np.zeros((rigs, 2)))
        found.append((t, x.copy(), observer.further.copy(), observer.equivalent.copy()))
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("every", "rigs", "older"), [(1, 3, 0.0), (9, 1, 0.0), (9, 1, 0.004), (9, 3, 0.004)]
)
def test_a_constant_disturbance_is_found_and_the_ball_of_now_with_it(every, rigs, older):
    found = followed(DisturbanceObserver(delay=0.042, pole=6.0), 2000, every, rigs, older)
    t, x, d, equivalent = found[-1]
    np.testing.assert_allclose(d, np.tile(PUSH, (rigs, 1)), rtol=1e-4)
    np.testing.assert_allclose(x[:, 0::4], np.tile(PUSH * t**2 / 2, (rigs, 1)), rtol=1e-4)
    np.testing.assert_allclose(x[:, 1::4], np.tile(PUSH * t, (rigs, 1)), rtol=1e-4)
    np.testing.assert_allclose(equivalent[:, 2] * MODEL.k1, PUSH[0], rtol=1e-4)
    np.testing.assert_allclose(-equivalent[:, 6] * MODEL.k1, PUSH[1], rtol=1e-4)


@pytest.mark.parametrize(("every", "within"), [(1, 0.02), (9, 0.06)])
def test_what_is_wrong_dies_out_with_the_pole_that_was_asked_for(every, within):
    pole = 6.0
    found = followed(DisturbanceObserver(delay=0.0, pole=pole), 900, every)
    t = np.array([each[0] for each in found])
    wrong = np.array([each[2][0, 0] for each in found]) / PUSH[0] - 1
    # the answer to a step of three equal poles
    expected = -(1 + pole * t + (pole * t) ** 2 / 2) * np.exp(-pole * t)
    np.testing.assert_allclose(wrong, expected, atol=within)


@pytest.mark.parametrize("T", [0.002, 0.017, 0.1])
def test_the_gains_give_three_equal_poles(T):
    A = np.array([[1, T, T * T / 2], [0, 1, T], [0, 0, 1]])
    closed = A @ (np.eye(3) - np.outer(gains(6.0, T), [1, 0, 0]))
    np.testing.assert_allclose(np.poly(closed), np.poly([np.exp(-6.0 * T)] * 3), atol=1e-12)
