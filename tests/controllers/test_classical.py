"""`controllers.classical`: The laws of the thesis, each against its own equations."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import solve_continuous_lyapunov

from controllers.analysis import linear_law
from controllers.ballplate import BallPlate
from controllers.classical import (
    AFL,
    LQR,
    AFLIntegral,
    Backstepping,
    Feedforward,
    Pid,
    PolePlacement,
    SlidingMode,
)
from controllers.references import Circle, Hold, Lissajous, Sine

MODEL = BallPlate()
A, B, _ = MODEL.linear()
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


FAST = Lissajous(amplitude=(0.2, 0.12), omega=(3.0, 2.0), start=2.0)


@pytest.mark.parametrize("path", [FAST, Circle(omega=1.0)], ids=["lissajous", "circle"])
def test_the_trajectory_is_one_of_the_flat_model(path):
    law, h = Feedforward(), 1e-4
    # None of the times is where the polynomial start ends: the derivative of u* jumps there.
    t = 0.113 + 0.05 * np.arange(197)
    x, u = law.trajectory(path(t))
    rate = (law.trajectory(path(t + h))[0] - law.trajectory(path(t - h))[0]) / (2 * h)
    np.testing.assert_allclose(rate, MODEL.flat(x, u), atol=1e-5)


def test_the_feedback_acts_on_the_way_from_the_trajectory():
    law, t = Feedforward(rho=100, kappa=0.1), 0.7
    x = np.random.default_rng(5).normal(size=8) * 0.1
    desired, u = law.trajectory(FAST(t))
    expected = u - LQR(rho=100, kappa=0.1).K @ (x - desired)
    np.testing.assert_allclose(law.control(t, x, FAST, NOTHING), expected)


def test_poles_make_the_feedback_of_pole_placement():
    np.testing.assert_array_equal(
        Feedforward(poles=(-2, -3, -4, -5)).K, PolePlacement(poles=(-2, -3, -4, -5)).K
    )


def test_a_reference_beyond_gravity_still_gives_a_finite_input():
    u = Feedforward().control(0.1, np.zeros(8), Sine(amplitude=0.1, omega=20.0), NOTHING)
    assert np.isfinite(u).all()


PATH = Sine(amplitude=(0.1, 0.15), omega=(1.1, 0.7), wave=("sin", "cos"))
states = arrays(float, 8, elements=st.floats(-0.8, 0.8))
times = st.floats(0, 20)


def flat_outputs(x):
    """y and three derivatives of the flat model for both axes (6.51), shape (4, 2)."""
    k = MODEL.k1
    return np.array(
        (
            (x[0], x[4]),
            (x[1], x[5]),
            (k * np.sin(x[2]), -k * np.sin(x[6])),
            (k * np.cos(x[2]) * x[3], -k * np.cos(x[6]) * x[7]),
        )
    )


def fourth_derivative(x, u):
    """Rate of y''' along the flat model, by a complex step."""
    rate = MODEL.flat(x, u)
    return flat_outputs(x + 1e-30j * rate)[3].imag / 1e-30


@settings(max_examples=50)
@given(x=states, t=times)
def test_the_error_follows_the_chosen_linear_equation_on_the_flat_model(x, t):
    law = AFL(poles=(-1, -2 + 3j, -2 - 3j, -5))
    u = law.control(t, x, PATH, NOTHING)
    r = PATH(t)
    e = np.array((*flat_outputs(x), fourth_derivative(x, u))) - r
    # (s + 1) (s^2 + 4 s + 13) (s + 5) written out.
    np.testing.assert_allclose(e[4] + 10 * e[3] + 42 * e[2] + 98 * e[1] + 65 * e[0], 0, atol=1e-9)


@settings(max_examples=50)
@given(x=states, t=times, q=arrays(float, 2, elements=st.floats(-1, 1)))
def test_the_integral_of_the_error_enters_the_equation_with_its_gain(x, t, q):
    p0, p1, p2, p3, p_I = 200.0, 132.0, 51.0, 12.0, 4.0
    law = AFLIntegral(gains=(p0, p1, p2, p3, p_I))
    u = law.control(t, x, PATH, q)
    e = np.array((*flat_outputs(x), fourth_derivative(x, u))) - PATH(t)
    left = e[4] + p3 * e[3] + p2 * e[2] + p1 * e[1] + p0 * e[0] + p_I * q
    np.testing.assert_allclose(left, 0, atol=1e-9)


@settings(max_examples=50)
@given(x=states, t=times)
def test_the_memory_gathers_the_error_of_the_ball(x, t):
    rate = AFLIntegral().memory_rate(t, x, PATH, np.array((0.0, 1e6)))  # without a limit
    np.testing.assert_allclose(rate, x[[0, 4]] - PATH(t)[0])


def test_gains_and_the_poles_they_give_make_the_same_law():
    law = AFLIntegral(poles=(-1, -1, -2, -2, -3))
    # (s + 1)^2 (s + 2)^2 (s + 3) = s^5 + 9 s^4 + 31 s^3 + 51 s^2 + 40 s + 12.
    np.testing.assert_allclose(law.p, (40, 51, 31, 9, 12))
    np.testing.assert_allclose(AFLIntegral(gains=(40, 51, 31, 9, 12)).p, law.p)


def test_the_integral_stops_at_its_limit_and_comes_back():
    law, x = AFLIntegral(integral_limit=0.1), np.zeros(8)
    beyond, short = Hold(x=-0.05, y=0.05), Hold(x=0.05, y=-0.05)
    q = np.array((0.1, -0.1))
    np.testing.assert_array_equal(law.memory_rate(0.0, x, beyond, q), (0, 0))
    np.testing.assert_allclose(law.memory_rate(0.0, x, short, q), (-0.05, 0.05))
    np.testing.assert_allclose(law.memory_rate(0.0, x, beyond, q / 2), (0.05, -0.05))


@cache
def recursion():
    """The errors of one axis and the input, derived anew: alpha' by the chain rule each time.

    The axis is p' = v, v' = k sin(a), a' = w, w' = u, with k of either sign.
    """
    p, v, a, w, k, u = (ca.SX.sym(name) for name in "pvawku")
    c, r = ca.SX.sym("c", 4), ca.SX.sym("r", 5)
    known, flow = ca.vertcat(p, v, a, w, r), ca.vertcat(v, k * ca.sin(a), w, u, r[1:], 0)

    def rate(expression):
        return ca.jtimes(expression, known, flow)

    e1 = p - r[0]
    alpha1 = r[1] - c[0] * e1
    e2 = v - alpha1
    alpha2 = rate(alpha1) - e1 - c[1] * e2
    e3 = k * ca.sin(a) - alpha2
    alpha3 = (rate(alpha2) - e2 - c[2] * e3) / (k * ca.cos(a))
    e = ca.vertcat(e1, e2, e3, w - alpha3)
    given = (p, v, a, w, k, c, r)
    return ca.Function("errors", given, [e]), ca.Function(
        "fall", [*given, u], [rate(ca.sumsqr(e) / 2)]
    )


gains = st.tuples(*[st.floats(0.05, 6.0)] * 4)


def axes(x, r, c):
    """Arguments of the derived functions for x and for y."""
    k = MODEL.k1
    return ((*x[:4], k, c, r[:, 0]), (*x[4:], -k, c, r[:, 1]))


@settings(max_examples=50)
@given(x=states, c=gains, t=times)
def test_the_lyapunov_function_falls_by_the_squares_of_the_errors(x, c, t):
    u = Backstepping(c=c).control(t, x, PATH, NOTHING)
    errors, fall = recursion()
    for axis, own in zip(axes(x, PATH(t), c), u, strict=True):
        squares = np.square(errors(*axis).full()[:, 0])
        scale = 1 + np.abs(own) * np.sqrt(squares.sum()) + squares.sum()
        np.testing.assert_allclose(float(fall(*axis, own)), -np.dot(c, squares), atol=1e-9 * scale)


def psi(s, ds, d2s, d3s, betas, epsilon):
    """(6.101) as printed."""

    def sigmoid(value):
        return value / (abs(value) + epsilon)

    b1, b2, b3 = betas
    psi0 = sigmoid(s)
    psi1 = sigmoid(ds + b1 * abs(s) ** (3 / 4) * psi0)
    psi2 = sigmoid(d2s + b2 * (ds**4 + abs(s) ** 3) ** (1 / 6) * psi1)
    return sigmoid(d3s + b3 * (d2s**6 + ds**4 + abs(s) ** 3) ** (1 / 12) * psi2)


@settings(max_examples=50)
@given(x=states, t=times, betas=st.tuples(*[st.floats(0.1, 5)] * 3), epsilon=st.floats(0.01, 1))
def test_the_input_is_the_nested_sigmoid_with_opposite_signs_for_x_and_y(x, t, betas, epsilon):
    u = SlidingMode(alpha=1.5, betas=betas, epsilon=epsilon).control(t, x, PATH, NOTHING)
    s1, s2 = (flat_outputs(x) - PATH(t)[:4]).T
    expected = -1.5 * psi(*s1, betas, epsilon), 1.5 * psi(*s2, betas, epsilon)
    np.testing.assert_allclose(u, expected, rtol=1e-9, atol=1e-12)


GAINS = {"kp": 5.0, "ki": 2.0, "kd": 3.0, "filter": 0.05, "plate": (90.0, 18.0)}


@pytest.mark.parametrize("s", [0.1j, 1j, 8j, 0.5 + 2j])
def test_from_position_to_effort_it_is_a_pid_with_a_filtered_derivative(s):
    A, B, C, D, _ = linear_law(Pid(**GAINS))
    transfer = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
    pid = 5.0 + 2.0 / s + 3.0 * s / (1 + 0.05 * s)
    expected = np.zeros((2, 8), complex)
    expected[0, [0, 2, 3]] = -90.0 * pid / MODEL.k1, -90.0, -18.0
    expected[1, [4, 6, 7]] = 90.0 * pid / MODEL.k1, -90.0, -18.0
    np.testing.assert_allclose(transfer, expected, rtol=1e-5, atol=1e-5)


def test_its_integral_stops_where_the_angle_is_at_its_limit_and_goes_back_at_once():
    law, x, q = Pid(angle=5.0, kd=0.0), np.zeros((1, 8)), np.zeros((1, 4))
    q[0, 0] = 10.0
    for way, rate in ((0.2, 0.0), (-0.2, -0.2)):
        assert law.memory_rate(0.0, x, Hold(x=way), q)[0, 0] == pytest.approx(rate)
    assert law.memory_rate(0.0, x, Hold(x=0.05), 0 * q)[0, 0] == pytest.approx(0.05)
    u = law.control(0.0, x, Hold(x=0.2), q)
    np.testing.assert_allclose(u, [[144.0 * np.radians(5.0), 0.0]], atol=1e-12)
