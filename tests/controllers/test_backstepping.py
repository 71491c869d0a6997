from functools import cache
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from controllers.ballplate import BallPlate
from controllers.classical import Backstepping
from controllers.references import Sine

MODEL = BallPlate()
PATH = Sine(amplitude=(0.1, 0.15), omega=(1.1, 0.7), wave=("sin", "cos"))
NOTHING = np.zeros(0)


@cache
def recursion():
    """The errors of one axis and the input, derived anew: alpha' by the chain rule each time.

    The axis is p' = v, v' = k sin(a), a' = w, w' = u, with k of either sign.
    """
    import sympy as sp

    p, v, a, w, k, u = sp.symbols("p v a w k u")
    c, r = sp.symbols("c1:5"), sp.symbols("r0:6")
    flow = {p: v, v: k * sp.sin(a), a: w, w: u, **dict(pairwise(r))}

    def rate(expression):
        return sum(expression.diff(symbol) * slope for symbol, slope in flow.items())

    e1 = p - r[0]
    alpha1 = r[1] - c[0] * e1
    e2 = v - alpha1
    alpha2 = rate(alpha1) - e1 - c[1] * e2
    e3 = k * sp.sin(a) - alpha2
    alpha3 = (rate(alpha2) - e2 - c[2] * e3) / (k * sp.cos(a))
    e4 = w - alpha3
    law = rate(alpha3) - k * sp.cos(a) * e3 - c[3] * e4
    V = (e1**2 + e2**2 + e3**2 + e4**2) / 2
    given = (p, v, a, w, k, c, r[:5])
    errors = sp.lambdify(given, (e1, e2, e3, e4), cse=True)
    return errors, sp.lambdify(given, law, cse=True), sp.lambdify((*given, u), rate(V), cse=True)


states = arrays(float, 8, elements=st.floats(-0.8, 0.8))
gains = st.tuples(*[st.floats(0.05, 6.0)] * 4)
times = st.floats(0, 20)


def axes(x, r, c):
    """Arguments of the derived functions for x and for y."""
    k = MODEL.k1
    return ((*x[:4], k, c, r[:, 0]), (*x[4:], -k, c, r[:, 1]))


@settings(max_examples=50)
@given(x=states, c=gains, t=times)
def test_the_law_is_what_the_recursion_gives_for_both_axes(x, c, t):
    u = Backstepping(c=c).control(t, x, PATH, NOTHING)
    _, law, _ = recursion()
    expected = [law(*axis) for axis in axes(x, PATH(t), c)]
    np.testing.assert_allclose(u, expected, rtol=1e-9, atol=1e-9)


@settings(max_examples=50)
@given(x=states, c=gains, t=times)
def test_the_lyapunov_function_falls_by_the_squares_of_the_errors(x, c, t):
    u = Backstepping(c=c).control(t, x, PATH, NOTHING)
    errors, _, fall = recursion()
    for axis, own in zip(axes(x, PATH(t), c), u, strict=True):
        squares = np.square(errors(*axis))
        scale = 1 + np.abs(own) * np.sqrt(squares.sum()) + squares.sum()
        np.testing.assert_allclose(fall(*axis, own), -np.dot(c, squares), atol=1e-9 * scale)
