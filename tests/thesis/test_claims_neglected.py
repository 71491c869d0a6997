import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from controllers.ballplate import BallPlate
from twin.thesis.chapter8 import terms

MODEL = BallPlate()
STATES = arrays(float, (3, 8), elements=st.floats(-1, 1))
INPUTS = arrays(float, (3, 2), elements=st.floats(-7, 7))


@given(STATES, INPUTS)
def test_main_and_neglected_terms_are_those_of_6_42_and_all_are_the_exact_acceleration(x, u):
    x1, x2, x3, x4, x5, x6, x7, x8 = x.T
    m, s, c, (u1, u2) = MODEL, np.sin(x3), np.cos(x3), u.T
    main = m.gravity * s, -m.gravity * np.sin(x7)
    neglected = (
        -m.d / 2 * x8**2 * np.sin(2 * x3) + x1 * x8**2 * s**2 + 2 * x6 * x8 * s + x1 * x4**2,
        -m.c3 * x4 * x8 * s - 2 * x1 * x4 * x8 * c - 2 * x2 * x8 * s + x5 * x8**2,
    )
    unlisted = (
        m.gravity * s * (np.cos(x7) - 1) - m.c4 * u1 + x5 * s * u2,
        (-x1 * s + m.c4 * c) * u2,
    )
    found = terms(m, x, u)
    for part, expected in zip(found, (main, neglected, unlisted), strict=True):
        assert np.allclose(part, np.transpose(expected), atol=1e-12)
    assert np.allclose(sum(found), m.derivative(x, u)[:, [1, 5]] / m.c1, atol=1e-12)
