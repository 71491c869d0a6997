import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import eigvals

from controllers.ballplate import BallPlate
from twin.thesis.claims import check_claims
from twin.thesis.claims.normal_form import (
    decoupling_determinant,
    equilibrium,
    input_bracket,
    input_jacobians,
    internal,
    relative_degree,
    zero_dynamics,
    zeros,
)

MODEL = BallPlate()
STATES = arrays(float, 8, elements=st.floats(-1, 1))
FEW = settings(max_examples=20)


def test_the_zeros_of_the_linear_plant_are_the_eigenvalues_of_the_zero_dynamics():
    A, B, _ = MODEL.linear()
    C = np.eye(8)[[0, 4]]
    pencil = np.block([[A, B], [C, np.zeros((2, 2))]])
    mass = np.diag([1.0] * 8 + [0.0] * 2)
    invariant = eigvals(pencil, mass)
    finite = np.sort(invariant[np.abs(invariant) < 1e3].real)[::-1]
    assert np.allclose(zeros(MODEL).found, finite, rtol=1e-5)


def test_the_eigenvalues_are_those_of_6_39():
    found, formula, _ = zeros(MODEL)
    assert np.allclose(found, formula, rtol=1e-7)


@given(arrays(float, 4, elements=st.floats(-0.5, 0.5)))
def test_the_zero_dynamics_are_6_36(eta):
    phi, phi_rate, theta, theta_rate = eta
    m = MODEL
    gravity = m.gravity * np.sin(phi) * np.cos(theta)
    u1 = m.c1 / m.c2 * (-m.d / 2 * theta_rate**2 * np.sin(2 * phi) + gravity)
    pull = m.c3 * phi_rate * theta_rate * np.sin(phi) + m.gravity * np.sin(theta)
    u2 = pull / (m.c4 * np.cos(phi))
    expected = [phi_rate, u1, theta_rate, u2]
    assert np.allclose(zero_dynamics(MODEL, eta), expected, rtol=1e-12, atol=1e-12)


@given(STATES)
def test_the_zero_dynamics_hold_the_ball_still(x):
    eta = x[:4]
    state = np.array([0, 0, eta[0], eta[1], 0, 0, eta[2], eta[3]])
    u = zero_dynamics(MODEL, eta)[[1, 3]]
    assert np.allclose(MODEL.derivative(state, u)[[1, 5]], 0, atol=1e-12)


@given(STATES)
def test_no_input_moves_the_internal_coordinates(x):
    step = 1e-6
    for g in MODEL.g(x).T:
        rate = (internal(MODEL, x + step * g) - internal(MODEL, x - step * g)) / (2 * step)
        assert np.allclose(rate, 0, atol=1e-8)


@FEW
@given(STATES)
def test_input_jacobians_agree_with_finite_differences(x):
    ahead = 1e-6 * np.eye(8)
    numeric = (MODEL.g(x + ahead) - MODEL.g(x - ahead)).T / 2e-6
    for found, expected in zip(input_jacobians(MODEL, x), numeric, strict=True):
        assert np.allclose(found, expected, atol=1e-8)


@FEW
@given(STATES)
def test_the_input_fields_commute(x):
    assert np.allclose(input_bracket(MODEL, x), 0, atol=1e-12)


@FEW
@given(STATES)
def test_the_relative_degree_is_two_and_two(x):
    assert relative_degree(MODEL, x) == (2, 2)


def test_the_decoupling_matrix_is_singular_where_the_tangent_of_phi_is_c4_over_x():
    x = np.zeros(8)
    x[[0, 4]] = 0.25, 0.1
    x[2] = np.arctan(MODEL.c4 / 0.25)
    assert abs(decoupling_determinant(MODEL, x)) < 1e-15
    x[2] += 0.1
    assert abs(decoupling_determinant(MODEL, x)) > 1e-4


@given(st.floats(-0.25, 0.25), st.floats(-0.15, 0.15), st.integers(-2, 2), st.integers(-2, 2))
def test_the_ball_rests_anywhere_on_a_plate_turned_by_multiples_of_pi(x, y, k, n):
    rest = equilibrium(x, y, (k, n))
    assert np.allclose(MODEL.derivative(rest, np.zeros(2)), 0, atol=1e-14)


@pytest.fixture(scope="module")
def checked():
    return check_claims()


@pytest.mark.parametrize(
    ("equation", "disagreements"),
    [("5.21", 0), ("5.29", 4), ("5.33", 0), ("5.35b", 1), ("6.16", 0), ("6.38", 1), ("6.39", 0)],
)
def test_the_claims_disagree_with_the_thesis_where_the_errata_and_the_ranks_say(
    equation, disagreements, checked
):
    rows = [row for row in checked if row.equation == equation]
    assert sum(row.agrees is False for row in rows) == disagreements
