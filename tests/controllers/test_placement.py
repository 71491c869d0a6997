"""Tests of `controllers.design`."""

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.ballplate import BallPlate
from controllers.design import place_poles, sample

A, B, _ = BallPlate().linear()
CONTINUOUS = A[:4, :4]
STEP = sample(A, B, 0.002)[0][:4, :4]
C = np.eye(4)[::2]
DESIGNS = [
    (-8, -10, -14, -16),
    (-16, -8, -14, -10),
    (-1, -2, -5, -40),
    (-8, -8, -14, -14),
    (-8, -8, -14, -20),
    (-5 + 3j, -5 - 3j, -9, -12),
    (-9, -5 - 3j, -12, -5 + 3j),
    (-4 + 1j, -4 - 1j, -2 + 7j, -2 - 7j),
    (-4 + 1j, -4 - 1j, -4 + 1j, -4 - 1j),
]


@pytest.mark.filterwarnings("ignore:Convergence was not reached")
@pytest.mark.parametrize("poles", DESIGNS)
@pytest.mark.parametrize("sampled", [False, True])
def test_gain_is_that_of_scipy(poles, sampled):
    matrix, p = (STEP, np.exp(np.array(poles) * 0.002)) if sampled else (CONTINUOUS, poles)
    known = scipy.signal.place_poles(matrix.T, C.T, np.sort(p)).gain_matrix
    # Both stop 1e-2 short of the largest volume, where two directions are all but equally good:
    # the search enlarges rounding, which another LAPACK does differently, by up to 1e8.
    found = place_poles(matrix.T, C.T, p)
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-6 * np.abs(known).max())


@settings(max_examples=50)
@given(
    st.lists(st.floats(-60, -0.5), min_size=4, max_size=4, unique_by=lambda p: round(p, 1)),
    st.lists(st.floats(0.1, 30), min_size=2, max_size=2),
    st.integers(0, 2),
)
def test_any_poles_are_placed(real, imaginary, pairs):
    lower = [complex(*parts) for parts in zip(real, imaginary, strict=False)][:pairs]
    poles = [*real[2 * pairs :], *lower, *np.conj(lower)]
    K = place_poles(CONTINUOUS.T, C.T, poles)
    placed = np.poly(CONTINUOUS - K.T @ C)
    np.testing.assert_allclose(placed, np.poly(poles), rtol=1e-7)
