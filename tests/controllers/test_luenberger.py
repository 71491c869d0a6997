import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import null_space

from controllers.interfaces import Measurement
from controllers.observers import Luenberger

C = np.eye(8)[::2]
T = 0.002


def measured(y, touched=True, time=0.0):
    shape = y.shape[:-1]
    return Measurement(time, y, np.zeros(shape), np.full(shape, touched))


def errors(observer, start, ticks):
    """Predicted errors of an observer that follows the linear plant it is designed on."""
    x = np.zeros_like(start)
    observer.start(start)
    found = []
    for tick in range(ticks):
        found.append(observer.x - x)
        observer.correct(measured(x @ C.T))
        u = np.sin(0.01 * tick + np.arange(2.0)) * np.ones((*x.shape[:-1], 2))
        observer.predict(u)
        x = x @ observer.A.T + u @ observer.B.T
    return np.array(found)


def continuous(step):
    """Poles in 1/s of one subsystem's step of the error."""
    poles = np.log(np.linalg.eigvals(step).astype(complex)) / T
    return np.sort_complex(np.round(poles, 5))


@pytest.mark.parametrize(
    "poles",
    [
        (-8, -10, -14, -16),
        (-8, -10, -14, -16, -3, -4, -5, -6),
        (-5 + 3j, -5 - 3j, -9, -12),
        (-4 + 1j, -4 - 1j, -2 + 7j, -2 - 7j),
    ],
)
def test_error_goes_from_tick_to_tick_with_the_poles_asked_for(poles):
    found = errors(Luenberger(poles=poles), np.eye(8), 2)
    step = np.linalg.solve(found[0], found[1])
    np.testing.assert_allclose(continuous(step[:4, :4]), np.sort_complex(poles[:4]), rtol=1e-5)
    np.testing.assert_allclose(continuous(step[4:, 4:]), np.sort_complex(poles[-4:]), rtol=1e-5)


def test_poles_may_coincide_in_pairs():
    observer = Luenberger(poles=(-9, -9, -12, -12))
    step = observer.A @ (np.eye(8) - observer.L @ C)
    # A double pole is only as exact as the square root of rounding.
    np.testing.assert_allclose(continuous(step[:4, :4]), (-12, -12, -9, -9), rtol=1e-4)


@settings(max_examples=30)
@given(st.lists(st.floats(-60, -0.5), min_size=4, max_size=4, unique_by=lambda p: round(p, 1)))
def test_any_four_poles_are_placed(poles):
    observer = Luenberger(poles=tuple(poles))
    step = observer.A @ (np.eye(8) - observer.L @ C)
    np.testing.assert_allclose(continuous(step[:4, :4]), np.sort(poles), rtol=1e-4)


def test_error_dies_out_at_the_rate_of_the_slowest_pole():
    start = np.random.default_rng(0).normal(size=(4, 8))
    found = np.linalg.norm(errors(Luenberger(), start, 1001), axis=-1)
    rate = np.log(found[1000] / found[800]) / (200 * T)
    np.testing.assert_allclose(rate, -8, rtol=0.06)


def test_linear_plant_is_followed_without_bias():
    start = np.random.default_rng(1).normal(size=(3, 8))
    assert np.abs(errors(Luenberger(), start, 3000)[-1]).max() < 1e-12


def test_prediction_is_the_solution_of_the_linear_model_with_held_input():
    observer = Luenberger()
    A, B, _ = observer.model.linear()
    x, u = np.random.default_rng(2).normal(size=8), np.array([3.0, -5.0])
    observer.start(x)
    observer.predict(u)
    run = solve_ivp(lambda _, x: A @ x + B @ u, (0, T), x, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(observer.x, run.y[:, -1], rtol=1e-11, atol=1e-13)


def test_gain_over_the_period_tends_to_one_that_places_the_poles_in_continuous_time():
    A = Luenberger().model.linear().A

    def deviation(period):
        L = Luenberger(period=period).L / period
        return np.sort(np.linalg.eigvals(A - L @ C).real) - np.repeat([-16, -14, -10, -8], 2)

    assert np.abs(deviation(1e-4)).max() < 0.1
    np.testing.assert_allclose(deviation(1e-4) / deviation(5e-5), 2, rtol=0.02)


def test_no_other_gain_with_these_poles_has_eigenvectors_nearer_to_orthogonal():
    observer = Luenberger()
    A, outputs = observer.A[:4, :4], C[:2, :4]
    error = A @ (np.eye(4) - observer.L[:4, :2] @ outputs)
    poles, left = np.linalg.eig(error.T)
    # With two outputs a left eigenvector may be any of a plane: where the gain does not reach.
    planes = [null_space((A.T - pole * np.eye(4))[1::2]) for pole in poles]
    pairs = np.random.default_rng(4).normal(size=(4, 5000, 2))
    others = np.stack([p @ plane.T for p, plane in zip(pairs, planes, strict=True)], axis=-1)
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    assert np.abs(np.linalg.det(others)).max() < np.abs(np.linalg.det(left)) * 1.001


def test_axes_do_not_touch_each_other():
    L = Luenberger().L
    assert not L[:4, 2:].any()
    assert not L[4:, :2].any()


def test_ball_that_is_not_felt_corrects_nothing_but_the_plate_still_does():
    observer = Luenberger()
    rigs = np.zeros((2, 8))
    y = np.array([[np.nan, 0.1, np.nan, -0.1], [0.2, 0.1, 0.3, -0.1]])
    observer.start(rigs)
    lost = Measurement(0.0, y, np.zeros(2), np.array([False, True]))
    x = observer.correct(lost)
    plate = np.array([0, 0.1, 0, -0.1])
    np.testing.assert_allclose(x[0], observer.L @ plate, rtol=1e-14)
    np.testing.assert_allclose(x[1], observer.L @ y[1], rtol=1e-14)


@pytest.mark.parametrize(
    ("poles", "message"),
    [
        ((-8, -10, -14), "poles must be 4 or 8 numbers, got 3"),
        ((-8, -10, -14, 1), "negative real part"),
        ((-8, -10, -14, np.nan), "negative real part"),
        ((-8, -10, -14, -16 + 1j), "conjugate pairs"),
        ((-8, -8, -8, -16), "coincide in pairs, no more"),
    ],
)
def test_poles_that_cannot_be_placed_are_refused(poles, message):
    with pytest.raises(ValueError, match=message):
        Luenberger(poles=poles)
