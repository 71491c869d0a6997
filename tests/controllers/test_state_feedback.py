import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_lyapunov

from controllers.ballplate import BallPlate
from controllers.classical import LQR, PolePlacement
from controllers.references import Sine

A, B, _ = BallPlate().linear()
NOTHING = np.zeros(0)

real = st.floats(-8.0, -0.3)
pair = st.builds(lambda re, im: (complex(re, im), complex(re, -im)), real, st.floats(0.1, 5.0))
four_poles = st.one_of(
    st.tuples(real, real, real, real),
    st.builds(lambda p, a, b: (*p, a, b), pair, real, real),
    st.builds(lambda p, q: (*p, *q), pair, pair),
)
weight = st.floats(0.1, 1000.0)


def polynomial(matrix):
    return np.poly(np.linalg.eigvals(matrix))


@settings(max_examples=80)
@given(x=four_poles, y=four_poles)
def test_placement_puts_the_poles_of_each_axis_where_they_are_requested(x, y):
    K = PolePlacement(poles=(*x, *y)).K
    closed = A - B @ K
    for axis, poles in ((slice(0, 4), x), (slice(4, 8), y)):
        desired = np.poly(poles)
        np.testing.assert_allclose(polynomial(closed[axis, axis]), desired, rtol=1e-7, atol=1e-9)


def test_a_pole_may_be_repeated():
    closed = A - B @ PolePlacement(poles=(-3, -3, -3, -3)).K
    np.testing.assert_allclose(polynomial(closed[:4, :4]), np.poly((-3,) * 4), rtol=1e-9)


def test_a_pole_may_be_written_as_text():
    text = PolePlacement(poles=("-2+1j", "-2-1j", -3, -4))
    np.testing.assert_array_equal(text.K, PolePlacement(poles=(-2 + 1j, -2 - 1j, -3, -4)).K)


@settings(max_examples=60)
@given(Q=st.tuples(*[weight] * 8), R=st.tuples(weight, weight))
def test_the_lqr_gain_is_the_best_answer_to_its_own_cost(Q, R):
    K = LQR(Q=Q, R=R).K
    closed = A - B @ K
    # The cost of this gain is x'Px; the gain that is best for that P is K itself (6.12), so P
    # solves the Riccati equation (6.13).
    P = solve_continuous_lyapunov(closed.T, -(np.diag(Q) + K.T @ np.diag(R) @ K))
    riccati = A.T @ P + P @ A - P @ B @ np.diag(1 / np.array(R)) @ B.T @ P + np.diag(Q)
    np.testing.assert_allclose(np.diag(1 / np.array(R)) @ B.T @ P, K, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(riccati, 0, atol=1e-6 * np.abs(P).max() * np.abs(A).max())


@settings(max_examples=40)
@given(rho=weight, kappa=st.floats(0.0, 10.0))
def test_rho_and_kappa_are_the_weights_of_the_thesis(rho, kappa):
    Q = (rho, rho * kappa) * 4
    np.testing.assert_allclose(LQR(rho=rho, kappa=kappa).K, LQR(Q=Q).K, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("law", [PolePlacement(), LQR()], ids=["pole_placement", "lqr"])
def test_the_axes_do_not_act_on_each_other(law):
    np.testing.assert_allclose(law.K[0, 4:], 0, atol=1e-9)
    np.testing.assert_allclose(law.K[1, :4], 0, atol=1e-9)


@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_the_reference_state_is_the_one_asked_for(kind):
    law, path, t = LQR(reference=kind), Sine(amplitude=(0.1, 0.05), omega=(1, 2)), 0.7
    r = path(t)
    desired = np.zeros(8)
    desired[[0, 4]] = r[0]
    if kind == "velocity":
        desired[[1, 5]] = r[1]
    x = np.random.default_rng(3).normal(size=8)
    np.testing.assert_allclose(law.control(t, x, path, NOTHING), -law.K @ (x - desired))
