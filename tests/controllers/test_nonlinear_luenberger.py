import numpy as np
import pytest
from observing import measured
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from controllers.observers import NonlinearLuenberger

MODEL = BallPlate()
T = 0.002
POLES = (-8, -10, -14, -16)


def flat_flow(x, u, duration):
    run = solve_ivp(lambda _, x: MODEL.flat(x, u), (0, duration), x, rtol=1e-12, atol=1e-14)
    return run.y[:, -1]


def swing(tick):
    """Plate angles, rates and accelerations of a swing by some 9 degrees."""
    size, pace = np.array([0.17, 0.15]), 3.0
    phase = pace * tick * T + np.array([0.0, 2.0])
    return size * np.sin(phase), size * pace * np.cos(phase), -size * pace**2 * np.sin(phase)


def errors(observer, wrong, ticks):
    """Errors of an observer that starts beside the flat model and follows it."""
    angle, rate, _ = swing(0)
    x = np.array([0.1, 0.0, angle[0], rate[0], -0.05, 0.0, angle[1], rate[1]])
    observer.start(x + wrong)
    found = [wrong]
    for tick in range(ticks):
        observer.correct(measured(x[::2]))
        u = swing(tick)[2]
        observer.predict(u)
        x = flat_flow(x, u, T)
        found.append(observer.x - x)
    return np.array(found)


@pytest.mark.parametrize("poles", [POLES, (-5 + 3j, -5 - 3j, -9, -12), (*POLES, -3, -4, -5, -6)])
def test_small_error_at_the_level_plate_goes_from_tick_to_tick_with_the_poles_asked_for(poles):
    observer = NonlinearLuenberger(poles=poles)
    observer.start(1e-7 * np.eye(8))
    observer.correct(measured(np.zeros((8, 4))))
    observer.predict(np.zeros((8, 2)))
    step = observer.x / 1e-7
    for axis, mine in enumerate((poles[:4], poles[-4:])):
        own = slice(4 * axis, 4 * axis + 4)
        found = np.log(np.linalg.eigvals(step[own, own]).astype(complex)) / T
        np.testing.assert_allclose(
            np.sort_complex(np.round(found, 4)), np.sort_complex(mine), rtol=1e-4
        )


def test_it_is_the_observer_7_11_with_the_gain_of_7_12_and_7_13():
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.3, 0.3, 8)
    u, y = rng.uniform(-5, 5, 2), x[::2] + rng.uniform(-1e-3, 1e-3, 4)
    k1 = MODEL.c1 * MODEL.gravity
    gauge = np.eye(8)
    gauge[2, 2] = gauge[3, 3] = k1 * np.cos(x[2])
    gauge[3, 2] = -k1 * np.sin(x[2]) * x[3]
    gauge[6, 6] = gauge[7, 7] = -k1 * np.cos(x[6])
    gauge[7, 6] = k1 * np.sin(x[6]) * x[7]
    G = np.zeros((8, 2))
    G[:4, 0] = G[4:, 1] = np.poly(POLES)[1:]
    expected = MODEL.flat(x, u) + np.linalg.solve(gauge, G @ (y - x[::2])[0::2])

    def deviation(period):
        observer = NonlinearLuenberger(poles=POLES, period=period)
        observer.start(x)
        observer.correct(measured(y))
        observer.predict(u)
        return np.abs((observer.x - x) / period - expected).max() / np.abs(expected).max()

    assert deviation(1e-5) < 1e-3
    assert deviation(2e-5) / deviation(1e-5) == pytest.approx(2, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("plate_observer", [False, True])
def test_flat_model_is_followed_from_a_wrong_start(plate_observer):
    wrong = np.array([0.003, 0.01, 0.01, -0.02, -0.002, 0.02, 0.01, 0.03])
    found = errors(NonlinearLuenberger(poles=POLES, plate_observer=plate_observer), wrong, 1500)
    assert np.abs(found[-1]).max() < 1e-5 * np.abs(wrong).max()


def test_plate_angles_are_not_looked_at_without_a_plate_observer():
    observers = NonlinearLuenberger(), NonlinearLuenberger()
    for observer, plate in zip(observers, (0.1, np.nan), strict=True):
        observer.start(np.zeros(8))
        observer.correct(measured(np.array([0.01, plate, 0.02, plate])))
        observer.predict(np.ones(2))
    np.testing.assert_array_equal(observers[0].x, observers[1].x)


def test_plate_observer_takes_the_plate_from_the_measured_angles_with_poles_of_its_own():
    observer = NonlinearLuenberger(plate_observer=True, plate_poles=(-20, -30))
    wrong = np.zeros((2, 8))
    wrong[0, [2, 6]] = wrong[1, [3, 7]] = 0.1
    observer.start(wrong)
    observer.correct(measured(np.zeros((2, 4))))
    observer.predict(np.zeros(2))
    for first in (2, 6):
        step = observer.x[:, first : first + 2] / 0.1
        found = np.sort(np.log(np.linalg.eigvals(step)) / T)
        np.testing.assert_allclose(found, (-30, -20), rtol=1e-9)


def test_start_far_from_the_ball_stays_finite_and_arrives():
    observer = NonlinearLuenberger(poles=POLES)
    observer.start(np.zeros(8))
    y = np.array([0.15, 0.0, -0.1, 0.0])
    steepest = 0.0
    for _ in range(2000):
        x = observer.correct(measured(y))
        steepest = max(steepest, np.abs(x[[2, 6]]).max())
        observer.predict(np.zeros(2))
    assert steepest < np.radians(60.001)
    np.testing.assert_allclose(x, [0.15, 0, 0, 0, -0.1, 0, 0, 0], atol=1e-4)
