"""`twin.study.fidelity`.

Statistics of functions known in closed form, from few points of these and many of others."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from controllers.arrays import Array
from twin.study.fidelity import (
    Estimate,
    Points,
    combine,
    estimate_mean,
    estimate_quantile,
    index_parts,
)
from twin.study.schema import Study
from twin.study.screen import MIN_TAIL_POINTS, QUANTILE_SHARES
from twin.study.work import SOBOL_DESIGNS, quantiles

REPLICATIONS, POINTS, TIMES = 200, 100, 10


def holds(estimate: Estimate, truth: float) -> bool:
    return estimate.low <= truth <= estimate.high


def single(values: Array) -> Points:
    """Points that were drawn one by one."""
    return Points(values, np.arange(len(values)))


def biased(true: Array, other: Array) -> Array:
    """A cheap function of the same point: of another mean and scale, and not quite of one mind."""
    return 2 * true + 0.5 * other + 3


def draw_functions(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """The dear function, normal with mean 0 and variance 1, and the cheap one."""
    true, other = rng.standard_normal((2, count))
    return true, biased(true, other)


def replications(
    count: int = REPLICATIONS, points: int = POINTS
) -> list[tuple[Points, Array, Points]]:
    """Points on both, and further ones on the cheap function."""
    found = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        (own, paired), (_, wide) = draw_functions(rng, points), draw_functions(rng, TIMES * points)
        found.append((single(own), paired, single(wide)))
    return found


def test_intervals_of_a_mean_hold_the_truth_in_95_percent_whatever_the_bias():
    both = [combine(*each) for each in replications()]
    alone = [estimate_mean(own) for own, _, _ in replications()]
    for estimates in (both, alone):
        assert 0.92 <= np.mean([holds(each, 0.0) for each in estimates]) <= 0.98
    # of no bias, and as narrow as the variances of rest and cheap function have it
    values = np.array([each.value for each in both])
    assert abs(values.mean()) < 4 * values.std() / math.sqrt(REPLICATIONS)
    unexplained = 0.25 / 4.25
    expected = math.sqrt(unexplained + (1 - unexplained) / (1 + TIMES))
    ratio = np.median([each.width for each in both]) / np.median([each.width for each in alone])
    assert ratio == pytest.approx(expected, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("share", QUANTILE_SHARES.values())
def test_intervals_of_a_quantile_hold_the_truth_in_95_percent(share):
    held, widths = [], []
    for own, paired, wide in replications(800, round(MIN_TAIL_POINTS / 0.05)):
        both = estimate_quantile(share, own, paired, wide)
        alone = estimate_quantile(share, own)
        held.append([holds(each, stats.norm.ppf(share)) for each in (both, alone)])
        widths.append(both.width / alone.width)
    assert all(0.92 <= each <= 0.98 for each in np.mean(held, axis=0))
    assert np.median(widths) < 0.7


def test_a_quantile_is_where_the_distribution_reaches_the_share():
    own = single(np.random.default_rng(4).permutation(np.arange(1.0, 101.0)))
    found = estimate_quantile(0.25, own)
    assert found.value == 25
    # Woodruff: 25 +- t sqrt(25 * 75 / 99) places
    half = stats.t.ppf(0.975, 99) * math.sqrt(25 * 75 / 99)
    assert (found.low, found.high) == (math.ceil(25 - half), math.ceil(25 + half))
    few = estimate_quantile(0.02, own)
    assert few.low == -math.inf
    assert estimate_quantile(0.999, own).high == math.inf


def test_a_cheap_function_that_knows_nothing_costs_nothing_but_a_degree_of_freedom():
    rng = np.random.default_rng(1)
    own, paired, wide = (rng.standard_normal(count) for count in (POINTS, POINTS, TIMES * POINTS))
    both, alone = combine(single(own), paired, single(wide)), estimate_mean(single(own))
    assert both.width == pytest.approx(alone.width, rel=0.05)
    constant = combine(single(own), np.ones(POINTS), single(np.ones(3)))
    assert constant.value == pytest.approx(alone.value)


def test_a_perfect_cheap_function_gives_the_mean_of_all_points():
    own, wide = np.random.default_rng(2).standard_normal((2, POINTS))
    both = combine(single(own), own + 7, single(wide + 7))
    assert both.value == pytest.approx(np.concatenate((own, wide)).mean())


def test_points_of_one_unit_count_once():
    values = np.repeat(np.random.default_rng(3).standard_normal(20), 50)
    together = estimate_mean(Points(values, np.repeat(np.arange(20), 50)))
    alone = estimate_mean(single(values[::50]))
    assert together == pytest.approx(alone)
    assert math.isinf(estimate_mean(Points(values, np.zeros(1000, int))).high)


def ishigami(points: Array) -> Array:
    a, b, c = 2 * np.pi * points.T - np.pi
    return np.asarray(np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a))


def crude(points: Array) -> Array:
    """Ishigami's function but for its scale and with some of its own."""
    a, b, _ = 2 * np.pi * points.T - np.pi
    return np.asarray(1.2 * ishigami(points) + 0.8 * np.cos(a) * b + 5)


@pytest.mark.long
def test_intervals_of_sobol_indices_hold_the_truth_in_95_percent(monkeypatch):
    parts = 0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49 / 8, 0.01 * np.pi**8 * 8 / 225
    truth = np.array([parts[0] + parts[2], parts[1], parts[2]]) / sum(parts)
    uniform = {f"plant.start.{key}": {"uniform": (0, 1)} for key in ("x", "y", "spin")}
    about = {"title": "t", "scenario": "hold", "method": "sobol", "samples": 256}
    study, times = Study.model_validate({**about, "parameters": uniform}), 4
    units = np.repeat(np.arange(times * SOBOL_DESIGNS), 256 // SOBOL_DESIGNS)
    held, widths = [], []
    for seed in range(REPLICATIONS):
        monkeypatch.setattr("twin.study.work.DESIGN_SEED", seed)
        near, far = quantiles(study), quantiles(study, times)
        own, paired, wide = (
            index_parts(each.reshape(-1, 5)) for each in (ishigami(near), crude(near), crude(far))
        )
        for k in range(3):
            points, others = Points(own[:, k], units[: len(own)]), Points(wide[:, k], units)
            both, alone = combine(points, paired[:, k], others), estimate_mean(points)
            held.append(holds(both, truth[k]))
            widths.append(both.width / alone.width)
    assert all(0.92 <= share <= 0.98 for share in np.reshape(held, (-1, 3)).mean(axis=0))
    assert np.median(widths) < 0.8
