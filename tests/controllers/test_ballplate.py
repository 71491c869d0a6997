"""Tests of `controllers.ballplate`."""

import math

import casadi as ca
import numpy as np
import pytest

from controllers.ballplate import BallPlate

MODEL = BallPlate()
PLAIN = {"mass": 0.024, "radius": 0.02, "inertia": 6.4e-6, "gravity": 9.81, "height": 0.122}


def states(count=200, seed=0):
    """States and inputs far beyond the operating range, where every term matters."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (count, 8)), rng.uniform(-7, 7, (count, 2))


@pytest.fixture(scope="module")
def lagrange():
    """Ball accelerations (x'', y'') from the energies (4.14b), (4.16) and R = Rx(theta) Ry(phi)."""
    state, ball, plate, p = (
        ca.SX.sym(name, n) for name, n in (("x", 8), ("ball", 2), ("plate", 2), ("p", 5))
    )
    m, r, J, g, h = ca.vertsplit(p)
    place, rate = state[0::2], state[1::2]
    slope = ca.vec(ca.horzcat(rate, ca.vertcat(ball[0], plate[0], ball[1], plate[1])).T)

    def derivative(expression):
        return ca.reshape(ca.jtimes(ca.vec(expression), state, slope), expression.shape)

    def turn(axis, angle):
        K = ca.skew(ca.DM.eye(3)[:, axis])
        return ca.DM.eye(3) + ca.sin(angle) * K + (1 - ca.cos(angle)) * K @ K

    R = turn(0, place[3]) @ turn(1, place[1])
    position = R @ ca.vertcat(place[0], place[2], h + r)
    spin = R.T @ derivative(R)
    omega = ca.vertcat(spin[2, 1] - rate[2] / r, spin[0, 2] + rate[0] / r, spin[1, 0])
    L = m * ca.sumsqr(derivative(position)) / 2 + J * ca.sumsqr(omega) / 2 - m * g * position[2]
    by = ca.gradient(L, state)
    forces = derivative(by[[1, 5]]) - by[[0, 4]]
    rest = ca.substitute(forces, ball, ca.DM.zeros(2))
    return ca.Function("lagrange", [state, plate, p], [-ca.solve(ca.jacobian(forces, ball), rest)])


@pytest.mark.parametrize(
    "changes", [{}, {"mass": 0.1, "radius": 0.03, "inertia": 2e-5, "gravity": 3.7, "height": 0.05}]
)
def test_exact_model_is_the_lagrange_equation_of_the_energies(lagrange, changes):
    parameters = PLAIN | changes
    model = BallPlate(**parameters)
    x, u = states(50)
    expected = lagrange(x.T, u.T, [*parameters.values()]).full().T
    np.testing.assert_allclose(model.derivative(x, u)[:, 1::4], expected, rtol=1e-11, atol=1e-12)


def test_rate_of_an_angle_or_position_is_the_next_state_or_the_input():
    x, u = states()
    rate = MODEL.derivative(x, u)
    np.testing.assert_array_equal(rate[:, 0::2], x[:, 1::2])
    np.testing.assert_array_equal(rate[:, 3::4], u)


def test_derivative_is_f_plus_g_u():
    x, u = states()
    expected = MODEL.f(x) + np.einsum("nij,nj->ni", MODEL.g(x), u)
    np.testing.assert_allclose(MODEL.derivative(x, u), expected, rtol=1e-14, atol=1e-14)


def differences(function, x, step=1e-6):
    columns = [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(8)]
    return np.stack(columns, axis=-1)


def test_jacobian_is_the_central_difference_of_f_and_with_input_of_the_whole_right_side():
    x, u = states()
    np.testing.assert_allclose(MODEL.jacobian(x), differences(MODEL.f, x), rtol=1e-8, atol=1e-8)
    expected = differences(lambda x: MODEL.derivative(x, u), x)
    np.testing.assert_allclose(MODEL.jacobian(x, u), expected, rtol=1e-8, atol=1e-8)


def test_linear_model_is_5_35_with_the_sign_of_the_last_input_corrected():
    m, r, J, g, h = PLAIN.values()
    c1 = m * r**2 / (m * r**2 + J)
    c2 = ((h + r) * m * r**2 + J * r) / (m * r**2 + J)
    A = np.zeros((8, 8))
    A[[0, 2, 4, 6], [1, 3, 5, 7]] = 1
    A[1, 2], A[5, 6] = c1 * g, -c1 * g
    B = np.zeros((8, 2))
    B[[1, 3, 5, 7], [0, 0, 1, 1]] = -c2, 1, c2, 1
    C = np.zeros((4, 8))
    C[[0, 1, 2, 3], [0, 2, 4, 6]] = 1
    for ours, theirs in zip(MODEL.linear(), (A, B, C), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-14)


def test_output_is_the_linear_output_matrix_times_the_state():
    x, _ = states()
    np.testing.assert_array_equal(MODEL.output(x), x @ MODEL.linear().C.T)


def test_ball_position_of_the_flat_model_has_the_derivatives_of_6_43_and_6_48():
    x, u = states(20)
    k1 = MODEL.c1 * MODEL.gravity

    def along(function):
        h = 1e-5
        rate = MODEL.flat(x, u)
        return (function(x + h * rate) - function(x - h * rate)) / (2 * h)

    def chain(x):
        z3 = np.stack([k1 * np.sin(x[:, 2]), -k1 * np.sin(x[:, 6])], axis=-1)
        z4 = np.stack([k1 * np.cos(x[:, 2]) * x[:, 3], -k1 * np.cos(x[:, 6]) * x[:, 7]], axis=-1)
        return z3, z4

    z3, z4 = chain(x)
    v1 = -k1 * np.sin(x[:, 2]) * x[:, 3] ** 2 + k1 * np.cos(x[:, 2]) * u[:, 0]
    v2 = k1 * np.sin(x[:, 6]) * x[:, 7] ** 2 - k1 * np.cos(x[:, 6]) * u[:, 1]
    np.testing.assert_allclose(along(lambda x: x[:, 1::4]), z3, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(along(lambda x: chain(x)[0]), z4, rtol=1e-7, atol=1e-7)
    expected = np.stack([v1, v2], axis=-1)
    np.testing.assert_allclose(along(lambda x: chain(x)[1]), expected, rtol=1e-7, atol=1e-7)


FUNCTIONS = {
    "f": lambda x, _: MODEL.f(x),
    "g": lambda x, _: MODEL.g(x),
    "unforced": lambda x, _: MODEL.jacobian(x),
    "output": lambda x, _: MODEL.output(x),
    "derivative": MODEL.derivative,
    "jacobian": MODEL.jacobian,
    "flat": MODEL.flat,
}


@pytest.mark.parametrize("function", FUNCTIONS.values(), ids=FUNCTIONS)
def test_leading_axes_are_rigs(function):
    for shape in ((), (5,), (2, 3)):
        x, u = states(math.prod(shape))
        together = function(x.reshape(*shape, 8), u.reshape(*shape, 2))
        apart = np.stack([function(*pair) for pair in zip(x, u, strict=True)])
        assert together.shape == (*shape, *apart.shape[1:])
        np.testing.assert_allclose(together.reshape(apart.shape), apart, rtol=1e-14, atol=1e-15)


def test_surface_through_the_joint_is_allowed():
    assert BallPlate(height=0).d == MODEL.radius


def test_ball_of_the_thesis_is_a_thin_hollow_sphere():
    assert pytest.approx(2 / 3 * MODEL.mass * MODEL.radius**2, rel=1e-12) == MODEL.inertia
    assert pytest.approx(3 / 5, rel=1e-12) == MODEL.c1
