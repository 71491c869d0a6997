"""The interaction plot, on functions of which it is known whether their arguments interact."""

import numpy as np
import pytest

from twin.study.interaction import BINS, lines


@pytest.fixture
def points():
    return np.random.default_rng(3).uniform(-1, 1, (2, 6000))


def slopes(found):
    return np.array([np.polyfit(line.x, line.mean, 1)[0] for line in found])


def test_a_sum_gives_parallel_lines_one_above_the_other(points):
    a, b = points
    found = lines(a, b, 2 * a + 3 * b)
    assert slopes(found) == pytest.approx([2, 2, 2], abs=0.15)
    # the thirds of b have the means -2/3, 0 and 2/3
    assert np.diff([line.mean.mean() for line in found]) == pytest.approx([2, 2], abs=0.15)


def test_a_product_gives_lines_that_cross_with_the_slopes_of_the_thirds(points):
    a, b = points
    assert slopes(lines(a, b, a * b)) == pytest.approx([-2 / 3, 0, 2 / 3], abs=0.08)


def test_the_error_is_that_of_a_mean(points):
    a, b = points
    noise = np.random.default_rng(4).normal(0, 0.3, len(a))
    (_, line, _) = lines(a, b, noise)
    assert line.error == pytest.approx(0.3 / np.sqrt(len(a) / 3 / BINS), rel=0.2)


def test_failed_runs_are_left_out_and_too_few_give_no_number(points):
    a, b = points[:, :60]
    values = a + b
    values[a > 0] = np.nan
    found = lines(a, b, values)
    assert max(line.x.max() for line in found) < 0
    few = lines(a[:3], b[:3], np.ones(3))
    assert all(np.isnan(line.mean).all() for line in few)
