import numpy as np
import pytest
from observing import measured
from scipy.integrate import solve_ivp
from scipy.linalg import null_space

from controllers.observers import Luenberger

C = np.eye(8)[::2]
T = 0.002


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
    np.testing.assert_allclose([step[:4, 4:], step[4:, :4]], 0, atol=1e-12)
    np.testing.assert_allclose(continuous(step[:4, :4]), np.sort_complex(poles[:4]), rtol=1e-5)
    np.testing.assert_allclose(continuous(step[4:, 4:]), np.sort_complex(poles[-4:]), rtol=1e-5)


def test_prediction_is_the_solution_of_the_linear_model_with_held_input():
    observer = Luenberger()
    A, B, _ = observer.model.linear()
    x, u = np.random.default_rng(2).normal(size=8), np.array([3.0, -5.0])
    observer.start(x)
    observer.predict(u)
    run = solve_ivp(lambda _, x: A @ x + B @ u, (0, T), x, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(observer.x, run.y[:, -1], rtol=1e-11, atol=1e-13)


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
