import numpy as np
import pytest
from observing import measured, normalised, within
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from controllers.observers import ExtendedKalman, Kalman

MODEL = BallPlate()
C = np.eye(8)[::2]
T = 0.002
SPREAD = (0.01, 0.05, 0.01, 0.05, 0.01, 0.05, 0.01, 0.05)


def flow(x, u, duration):
    """Exact model after a time, one rig."""
    run = solve_ivp(lambda _, x: MODEL.derivative(x, u), (0, duration), x, rtol=1e-13, atol=1e-15)
    return run.y[:, -1]


def moving(count, seed=0):
    """States and inputs over the operating range, the plate well on the move."""
    rng = np.random.default_rng(seed)
    scale = [0.25, 0.3, 0.17, 0.5, 0.15, 0.3, 0.17, 0.5]
    return rng.uniform(-1, 1, (count, 8)) * scale, rng.uniform(-7, 7, (count, 2))


def predicted(x, u, **settings):
    observer = ExtendedKalman(spread=SPREAD, **settings)
    observer.start(x)
    observer.predict(u)
    return observer


def test_prediction_misses_the_exact_model_by_far_less_than_the_disturbance_moves_it():
    x, u = moving(20)
    expected = [flow(*pair, T) for pair in zip(x, u, strict=True)]
    deviation = np.abs(predicted(x, u).x - expected).max(axis=0)
    disturbance = np.sqrt(np.array(ExtendedKalman.Q) / T)
    moved = np.abs(Kalman().B) @ disturbance
    assert (deviation < 1e-3 * moved).all()


def test_prediction_is_of_second_order():
    x, u = moving(1)

    def error(period):
        return np.abs(predicted(x, u, period=period).x - flow(x[0], u[0], period)).max()

    assert error(0.016) / error(0.008) == pytest.approx(2**3, rel=0.2)


def test_prediction_about_the_level_plate_is_that_of_the_kalman_filter():
    observer, linear = ExtendedKalman(spread=SPREAD), Kalman()
    tiny = 1e-6 * np.random.default_rng(0).normal(size=(5, 10))
    for each in (observer, linear):
        each.start(tiny[:, :8])
        each.predict(tiny[:, 8:])
    np.testing.assert_allclose(observer.x, linear.x, rtol=1e-9, atol=1e-16)
    F, G, P = linear.A, linear.B, np.diag(np.square(SPREAD))
    expected = F @ P @ F.T + G @ np.diag(ExtendedKalman.Q) / T @ G.T
    np.testing.assert_allclose(observer.P[0], expected, rtol=1e-5, atol=1e-7 * expected.max())


def covariance_error(period, **settings):
    """Largest deviation of the predicted P from that of the exact model's flow, relative."""
    x, u = moving(1, seed=3)
    step = 1e-4

    def difference(dx, du):
        ahead, behind = (flow(x[0] + s * dx, u[0] + s * du, period) for s in (step, -step))
        return (ahead - behind) / (2 * step)

    F = np.array([difference(e, 0) for e in np.eye(8)]).T
    G = np.array([difference(0, e) for e in np.eye(2)]).T
    expected = F @ np.diag(np.square(SPREAD)) @ F.T + G @ np.diag(ExtendedKalman.Q) @ G.T / period
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    P = predicted(x, u, period=period, **settings).P[0]
    return (np.abs(P - expected) / scale).max()


def test_covariance_is_carried_by_the_exact_flow_but_for_the_second_order_of_the_period():
    assert covariance_error(T) < 1e-5
    assert covariance_error(4 * T) / covariance_error(2 * T) == pytest.approx(4, rel=0.1)


def test_without_input_terms_the_covariance_is_off_in_the_first_order_already():
    errors = [covariance_error(period, input_terms=False) for period in (2 * T, T)]
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)
    assert errors[1] > 10 * covariance_error(T)


def test_measurements_in_turn_are_the_kalman_update_with_all_at_once():
    x, u = moving(4)
    observer = predicted(x, u)
    x, P = observer.x, observer.P
    y = x @ C.T + np.random.default_rng(1).normal(size=(4, 4)) * 0.01
    observer.correct(measured(y))
    R = np.diag(ExtendedKalman.R) / T
    for rig in range(4):
        L = P[rig] @ C.T @ np.linalg.inv(C @ P[rig] @ C.T + R)
        rest = np.eye(8) - L @ C
        joseph = rest @ P[rig] @ rest.T + L @ R @ L.T
        np.testing.assert_allclose(observer.x[rig], x[rig] + L @ (y[rig] - C @ x[rig]), rtol=1e-9)
        np.testing.assert_allclose(observer.P[rig], joseph, rtol=1e-6, atol=1e-12)


def test_covariance_at_the_level_plate_settles_in_that_of_the_kalman_filter():
    settings = {"Q": (0.1, 0.2), "R": (1e-6, 1e-6, 1e-6, 1e-6)}
    observer = ExtendedKalman(spread=SPREAD, **settings)
    observer.start(np.zeros(8))
    for _ in range(3000):
        observer.correct(measured(np.zeros(4)))
        observer.predict(np.zeros(2))
    S = Kalman(**settings).S
    np.testing.assert_allclose(observer.P, S, rtol=1e-6, atol=1e-9 * S.max())


def test_covariance_starts_in_that_of_the_kalman_filter():
    observer = ExtendedKalman()
    observer.start(np.zeros((3, 8)))
    np.testing.assert_array_equal(observer.P, np.broadcast_to(Kalman().S, (3, 8, 8)))


PERIODIC = 20 * np.pi
"""Period in s of the motion of ``swung``."""


def swung(ticks, **settings):
    """Least eigenvalue and largest asymmetry of P, relative, while plate and ball swing; P."""
    observer = ExtendedKalman(**settings)
    amplitude, rate = np.array([0.15, 0.13, 0.12, 0.13]), np.array([1.0, 2.0, 1.3, 1.7])
    noise = np.sqrt(np.array(observer.R) / T)
    rng = np.random.default_rng(0)
    observer.start(np.zeros(8))
    least, asymmetry = np.inf, 0.0
    for tick in range(ticks):
        truth = amplitude * np.sin(rate * tick * T)
        observer.correct(measured(truth + noise * rng.standard_normal(4), tick % 500 < 480))
        if tick % 97 == 0:
            scale = 1 / np.sqrt(np.diag(observer.P))
            P = observer.P * np.outer(scale, scale)
            least = min(least, np.linalg.eigvalsh(P)[0])
            asymmetry = max(asymmetry, np.abs(P - P.T).max())
        observer.predict(-(rate[1::2] ** 2) * truth[1::2])
    return least, asymmetry, observer.P


def test_an_asymmetry_of_the_covariance_is_gone_after_a_period():
    observer = ExtendedKalman()
    observer.start(np.zeros(8))
    observer.P = observer.P + 0.1 * np.triu(np.sqrt(np.outer(*2 * [np.diag(observer.P)])), 1)
    observer.correct(measured(np.zeros(4)))
    observer.predict(np.zeros(2))
    scale = 1 / np.sqrt(np.diag(observer.P))
    assert (np.abs(observer.P - observer.P.T) * np.outer(scale, scale)).max() < 1e-15


@pytest.mark.long
def test_covariance_stays_symmetric_positive_definite_and_forgets_its_past():
    # What it forgets within two periods of the motion cannot add up in hours.
    found = [swung(int(2 * PERIODIC / T), spread=spread) for spread in (None, (1.0,) * 8)]
    for least, asymmetry, _ in found:
        assert least > 1e-6
        assert asymmetry < 1e-12
    one, other = (P for *_, P in found)
    scale = 1 / np.sqrt(np.diag(one))
    assert (np.abs(one - other) * np.outer(scale, scale)).max() < 1e-6


def runge_kutta(x, u, steps=2):
    h = T / steps
    for _ in range(steps):
        k1 = MODEL.derivative(x, u)
        k2 = MODEL.derivative(x + h / 2 * k1, u)
        k3 = MODEL.derivative(x + h / 2 * k2, u)
        k4 = MODEL.derivative(x + h * k3, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


@pytest.mark.long
def test_errors_and_innovations_are_as_large_as_their_covariances_say():
    """Of 1,000 filters after 0.6 s on swinging plates."""
    observer = ExtendedKalman(
        Q=(0.01, 0.02), R=(2e-9, 2e-10, 2e-9, 2e-10), spread=(0.002, 0.01, 0.001, 0.01) * 2
    )
    rigs = 1000
    rng = np.random.default_rng(11)
    x, _ = moving(rigs, seed=5)
    phase = rng.uniform(0, 2 * np.pi, (rigs, 2))
    observer.start(x + rng.standard_normal((rigs, 8)) * observer.spread)
    held, noise = np.sqrt(np.array(observer.Q) / T), np.sqrt(np.array(observer.R) / T)
    for tick in range(300):
        u = 5 * np.sin(2 * np.pi * 2 * tick * T + phase) - 8 * observer.x[:, 3::4]
        observer.predict(u)
        x = runge_kutta(x, u + held * rng.standard_normal((rigs, 2)))
        y = x @ C.T + noise * rng.standard_normal((rigs, 4))
        innovation, spread = y - observer.x @ C.T, C @ observer.P @ C.T + np.diag(noise**2)
        observer.correct(measured(y))
    assert within(normalised(observer.x - x, observer.P), 8)
    assert within(normalised(innovation, spread), 4)
