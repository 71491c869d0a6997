import numpy as np
import pytest
import scipy
from observing import measured, normalised, within

from controllers.ballplate import BallPlate
from controllers.observers import Kalman

A, B, C = BallPlate().linear()
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
