"""`controllers.arrays`: Quick questions to few numbers answer as numpy does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.arrays import every, finite, some

NUMBERS = (0.0, -0.0, 5e-324, 1.0, -1e308, math.inf, -math.inf, math.nan)


@pytest.mark.parametrize("count", [1, 2, 3, 40])
def test_of_masks_any_and_all_are_numpys(count):
    for held in range(count + 1):
        mask = np.arange(count) < held
        for each in (mask, np.repeat(mask, 2)[::2], mask.reshape(-1, 1)):
            assert (every(each), some(each)) == (each.all(), each.any())


@pytest.mark.parametrize("count", [1, 2, 3, 40])
@pytest.mark.parametrize("number", NUMBERS)
def test_one_number_among_others_decides_as_numpy_says(number, count):
    for usual in (0.0, -0.0, 1e308):
        for place in {0, count - 1}:
            values = np.full((count, 2), usual)
            values[place, 1] = number
            for each in (values, values[:, ::-1], values[:, 1:]):
                assert some(each) == each.any()
                assert finite(each) == np.isfinite(each).all()
