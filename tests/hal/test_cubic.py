"""Cubic pieces against scipy's spline with the same ends, and against what they must reproduce."""

from math import factorial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline

from twin.hal.cams import cubic


@settings(max_examples=25)
@given(n=st.integers(4, 40), seed=st.integers(0, 2**32 - 1))
def test_pieces_are_those_of_scipys_spline(n, seed):
    random = np.random.default_rng(seed)
    grid = np.cumsum(random.uniform(0.3, 2.0, n))
    values = random.normal(size=(n, 2, 3))
    spline = make_interp_spline(grid, values, k=3)
    expected = [spline(grid[:-1], nu=power) / factorial(power) for power in range(4)]
    assert cubic(grid, values) == pytest.approx(np.array(expected), rel=1e-9, abs=1e-9)


def test_points_of_one_cubic_give_back_that_cubic():
    grid = np.array([-1.0, -0.4, 0.3, 0.5, 1.7, 2.0])
    pieces = cubic(grid, 2 - grid + 0.5 * grid**2 - 3 * grid**3)
    assert pieces[3] == pytest.approx(np.full(5, -3.0))
    assert pieces[0] == pytest.approx((2 - grid + 0.5 * grid**2 - 3 * grid**3)[:-1])
