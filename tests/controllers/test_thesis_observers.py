"""`controllers.observers`: The observers of the thesis, each against its own equations."""

import numpy as np
import pytest
import scipy
from observing import measured, normalised, within
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from controllers.observers import ExtendedKalman, Ideal, Kalman, Luenberger, NonlinearLuenberger

A, B, _ = BallPlate().linear()
C = np.eye(8)[::2]
T = 0.002


def test_prediction_is_the_solution_of_the_linear_model_with_held_input():
    observer = Luenberger()
    x, u = np.random.default_rng(2).normal(size=8), np.array([3.0, -5.0])
    observer.start(x)
    observer.predict(u)
    run = solve_ivp(lambda _, x: A @ x + B @ u, (0, T), x, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(observer.x, run.y[:, -1], rtol=1e-11, atol=1e-13)


TABLE_B1 = {"x": 7.2538e-07, "y": 1.7721e-07, "phi": 1.5433e-10, "theta": 1.1580e-10}
MISPLACED = (0.7254e-6, 0.1772e-6, 0.0002e-6, 0.0001e-6)
BOTH = pytest.mark.parametrize("R", [Kalman.R, MISPLACED], ids=["table_b1", "8.2"])


def bucy_covariance(A, B, C, Q, R):
    """Steady covariance S of (7.7) in continuous time; S C' R^-1 is the gain (7.8)."""
    C = C / np.sqrt(np.diag(R))[:, np.newaxis]
    S = scipy.linalg.solve_continuous_are(A.T, C.T, B @ Q @ B.T, np.eye(len(C)))
    return (S + S.T) / 2


def sampled(observer):
    T = observer.period
    return np.diag(observer.Q) / T, np.diag(observer.R) / T


@BOTH
@pytest.mark.parametrize("period", [0.0005, 0.002, 0.01])
def test_covariance_solves_its_riccati_equation(R, period):
    observer = Kalman(R=R, period=period)
    Q, R = sampled(observer)
    F, G, S = observer.A, observer.B, observer.S
    gain = F @ S @ C.T @ np.linalg.inv(C @ S @ C.T + R)
    residual = F @ S @ F.T - gain @ C @ S @ F.T + G @ Q @ G.T - S
    assert np.abs(residual).max() < 1e-9 * np.abs(G @ Q @ G.T).max()


@BOTH
def test_gain_over_the_period_tends_to_7_8(R):
    expected = bucy_covariance(A, B, C, np.diag(Kalman.Q), np.diag(R)) @ C.T / np.array(R)

    def deviation(period):
        gain = Kalman(R=R, period=period).L / period
        return np.abs(gain - expected).max() / np.abs(expected).max()

    assert deviation(1e-4) < 0.003
    assert deviation(2e-4) / deviation(1e-4) == pytest.approx(2, rel=0.02)


def test_default_noise_is_table_b1_in_the_order_of_the_measurement():
    assert list(Kalman.R) == [TABLE_B1[name] for name in ("x", "phi", "y", "theta")]


def test_errors_and_innovations_are_as_large_as_their_covariances_say():
    """Of 2,000 filters under the noise they assume, after 300 ticks."""
    observer = Kalman(Q=(0.05, 0.02), R=(1e-7, 1e-8, 2e-7, 3e-8))
    Q, R = sampled(observer)
    rng = np.random.default_rng(7)
    rigs = 2000
    x = rng.normal(size=(rigs, 8))
    observer.start(x + rng.multivariate_normal(np.zeros(8), observer.S, rigs))
    for _ in range(300):
        u = rng.normal(size=(rigs, 2))
        observer.predict(u)
        x = x @ observer.A.T + (u + rng.multivariate_normal(np.zeros(2), Q, rigs)) @ observer.B.T
        y = x @ C.T + rng.multivariate_normal(np.zeros(4), R, rigs)
        error, innovation = observer.x - x, y - observer.x @ C.T
        observer.correct(measured(y))
    assert within(normalised(error, observer.S), 8)
    assert within(normalised(innovation, C @ observer.S @ C.T + R), 4)


MODEL = BallPlate()
SPREAD = (0.01, 0.05, 0.01, 0.05, 0.01, 0.05, 0.01, 0.05)


def flow(x, u, duration, model=MODEL.derivative):
    """Exact model, or another one, after a time, one rig."""
    run = solve_ivp(lambda _, x: model(x, u), (0, duration), x, rtol=1e-13, atol=1e-15)
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


@pytest.mark.long
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


@pytest.mark.long
def test_errors_and_innovations_are_as_large_as_their_covariances_say_of_the_extended_filter():
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
        u = u + held * rng.standard_normal((rigs, 2))
        x = x + T * MODEL.derivative(x + T / 2 * MODEL.derivative(x, u), u)
        y = x @ C.T + noise * rng.standard_normal((rigs, 4))
        innovation, spread = y - observer.x @ C.T, C @ observer.P @ C.T + np.diag(noise**2)
        observer.correct(measured(y))
    assert within(normalised(observer.x - x, observer.P), 8)
    assert within(normalised(innovation, spread), 4)


POLES = (-8, -10, -14, -16)


@pytest.mark.parametrize("period", [T, 0.005])
@pytest.mark.parametrize("kind", [Luenberger, NonlinearLuenberger])
@pytest.mark.parametrize(
    "poles",
    [
        POLES,
        (*POLES, -3, -4, -5, -6),
        (-5 + 3j, -5 - 3j, -9, -12),
        (-4 + 1j, -4 - 1j, -2 + 7j, -2 - 7j),
    ],
)
def test_small_error_at_the_level_plate_goes_from_tick_to_tick_with_the_poles_asked_for(
    kind, poles, period
):
    observer = kind(poles=poles, period=period)
    observer.start(1e-7 * np.eye(8))
    observer.correct(measured(np.zeros((8, 4))))
    observer.predict(np.zeros((8, 2)))
    step = observer.x / 1e-7
    np.testing.assert_allclose([step[:4, 4:], step[4:, :4]], 0, atol=1e-12)
    for axis, mine in enumerate((poles[:4], poles[-4:])):
        own = slice(4 * axis, 4 * axis + 4)
        found = np.log(np.linalg.eigvals(step[own, own]).astype(complex)) / period
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
    """While the plate swings by some 9 degrees."""
    observer = NonlinearLuenberger(poles=POLES, plate_observer=plate_observer)
    size, pace, begin = np.array([0.17, 0.15]), 3.0, np.array([0.0, 2.0])
    wrong = np.array([0.003, 0.01, 0.01, -0.02, -0.002, 0.02, 0.01, 0.03])
    x = np.array([0.1, 0.0, 0.0, 0.0, -0.05, 0.0, 0.0, 0.0])
    x[2::4], x[3::4] = size * np.sin(begin), size * pace * np.cos(begin)
    observer.start(x + wrong)
    for tick in range(1500):
        observer.correct(measured(x[::2]))
        u = -size * pace**2 * np.sin(pace * tick * T + begin)
        observer.predict(u)
        x = flow(x, u, T, MODEL.flat)
    assert np.abs(observer.x - x).max() < 1e-5 * np.abs(wrong).max()


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


def measurement_of(state):
    return measured(state[..., ::2])._replace(state=state)


def test_state_is_handed_on_but_for_the_plate_rates_and_not_written_to():
    observer = Ideal()
    observer.start(np.zeros((3, 8)))
    state = np.random.default_rng(0).normal(size=(3, 8))
    true = state.copy()
    x = observer.correct(measurement_of(true))
    np.testing.assert_array_equal(x, state * ([1, 1, 1, 0] * 2))
    observer.predict(np.ones((3, 2)))
    np.testing.assert_array_equal(true, state)


def test_plate_rates_are_the_integral_of_the_applied_input():
    observer = Ideal(period=0.01)
    rng = np.random.default_rng(1)
    start, inputs = rng.normal(size=8), rng.normal(size=(20, 2))
    observer.start(start)
    for u in inputs:
        observer.correct(measurement_of(rng.normal(size=8)))
        observer.predict(u)
    x = observer.correct(measurement_of(np.zeros(8)))
    np.testing.assert_allclose(x[3::4], start[3::4] + 0.01 * inputs.sum(axis=0), rtol=1e-12)


def test_rig_that_keeps_its_state_to_itself_is_refused():
    observer = Ideal()
    observer.start(np.zeros(8))
    with pytest.raises(ValueError, match="'ideal' needs a simulated rig with ideal sensors"):
        observer.correct(measured(np.zeros(4)))
