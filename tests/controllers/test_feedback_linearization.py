import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from controllers.ballplate import BallPlate
from controllers.classical import AFL, AFLIntegral
from controllers.references import Hold, Sine

MODEL = BallPlate()
PATH = Sine(amplitude=(0.1, 0.15), omega=(1.1, 0.7), wave=("sin", "cos"))
NOTHING = np.zeros(0)

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
