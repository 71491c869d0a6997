import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from controllers.classical import SlidingMode
from controllers.references import Hold, Sine

MODEL = BallPlate()
PATH = Sine(amplitude=(0.1, 0.15), omega=(1.1, 0.7), wave=("sin", "cos"))
NOTHING = np.zeros(0)

states = arrays(float, 8, elements=st.floats(-0.8, 0.8))
times = st.floats(0, 20)


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
    k = MODEL.k1
    z1 = (x[0], x[1], k * math.sin(x[2]), k * math.cos(x[2]) * x[3])
    z2 = (x[4], x[5], -k * math.sin(x[6]), -k * math.cos(x[6]) * x[7])
    s1, s2 = z1 - PATH(t)[:4, 0], z2 - PATH(t)[:4, 1]
    expected = -1.5 * psi(*s1, betas, epsilon), 1.5 * psi(*s2, betas, epsilon)
    np.testing.assert_allclose(u, expected, rtol=1e-9, atol=1e-12)


@settings(max_examples=25)
@given(x=states, t=times, alpha=st.floats(0.1, 7))
def test_the_input_never_exceeds_alpha(x, t, alpha):
    assert (np.abs(SlidingMode(alpha=alpha).control(t, x, PATH, NOTHING)) < alpha).all()


@pytest.mark.parametrize("start", [(0.1, 0.0), (0.0, 0.1)], ids=["x", "y"])
def test_each_axis_of_the_flat_model_comes_to_its_point(start):
    law, goal = SlidingMode(), Hold()

    def rate(t, x):
        return MODEL.flat(x, law.control(t, x, goal, NOTHING))

    x0 = np.zeros(8)
    x0[[0, 4]] = start
    x = solve_ivp(rate, (0, 25), x0, t_eval=np.linspace(15, 25, 101), rtol=1e-6, atol=1e-9).y
    # The sigmoid leaves no finite time to zero, but a neighbourhood well inside a tenth.
    assert np.abs(x[[0, 4]]).max() < 0.01
