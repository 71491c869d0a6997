"""`controllers.piecewise`.

Joins and piecewise polynomials are scipy's, which takes long to import."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import BPoly, PPoly

from controllers.piecewise import in_turn, join

numbers = st.floats(-10, 10)
motions = arrays(float, (5, 2), elements=numbers)


@settings(max_examples=40)
@given(start=motions, end=motions, duration=st.floats(0.05, 50))
def test_a_join_has_the_coefficients_that_scipy_finds(start, end, duration):
    rest = np.zeros_like(start)
    rest[0] = start[0]
    bernstein = BPoly.from_derivatives([0.0, duration], np.array((start, end)) - rest)
    expected = PPoly.from_bernstein_basis(bernstein).c[:, 0]
    expected[-1] += start[0]
    scale = np.abs(expected * duration ** np.arange(9, -1, -1)[:, None]).max()
    found = join(start, end, duration) - expected
    assert np.abs(found * duration ** np.arange(9, -1, -1)[:, None]).max() <= 1e-12 * scale


ORIGINS = (1.0, 1.0, 2.5, 4.0)
PIECES = np.random.default_rng(1).normal(size=(4, 10, 2))


@pytest.mark.parametrize("t", [-1.0, 1.0, 1.7, 2.5, 9.0, [[0.3, 2.4], [4.0, 7.0]], [np.nan]])
def test_value_and_derivatives_are_those_of_scipys_pieces(t):
    theirs = PPoly(np.stack(PIECES, axis=1), np.array((*ORIGINS, 4.0)))
    expected = np.array([theirs(t, nu=k) for k in range(5)])
    found = in_turn(ORIGINS, PIECES)(t if np.isscalar(t) else np.array(t))
    np.testing.assert_allclose(found, expected, rtol=1e-12)
