"""Tests of `twin.study.paired`."""

import math

import numpy as np
import pytest
from scipy import stats

import ballplate as bp
from twin.study.paired import paired_differences

NAN = math.nan
SHORT = ("plant.kind=lagrange", "baseline=false", "duration=0.5", "metrics.start=0")


def differences(one, other, points=None, method="montecarlo", per_block=3):
    one, other = np.array(one, float), np.array(other, float)
    points = np.arange(len(one)) if points is None else np.array(points)
    (found,) = paired_differences([("A", one), ("B", other)], points, method, per_block)
    return found


def test_the_interval_of_independent_points_is_that_of_a_paired_t_test():
    rng = np.random.default_rng(3)
    one = rng.normal(size=20)
    other = one + rng.normal(0.3, 0.1, size=20)
    found = differences(one, other)
    low, high = stats.ttest_rel(one, other).confidence_interval(0.95)
    assert (found.mean - found.half, found.mean + found.half) == pytest.approx((low, high))
    assert (found.first, found.second) == ("A", "B")
    assert found.better + found.worse == 20
    assert found.better == np.count_nonzero(one < other)


def test_noises_at_one_point_are_no_points_of_their_own():
    one, other = [1.0, 3.0, 2.0, 4.0], [0.0, 0.0, 0.0, 0.0]
    found = differences(one, other, points=[0, 0, 1, 1])
    means = np.array([2.0, 3.0])
    assert found.mean == 2.5
    assert found.half == pytest.approx(stats.t.ppf(0.975, 1) * means.std(ddof=1) / math.sqrt(2))


def test_of_a_grid_the_noises_are_independent_and_not_its_points():
    one, other = [1.0, 3.0, 101.0, 103.0], [0.0] * 4
    found = differences(one, other, points=[0, 0, 1, 1], method="grid")
    means = np.array([51.0, 53.0])  # over the points, by noise
    assert found.half == pytest.approx(stats.t.ppf(0.975, 1) * means.std(ddof=1) / math.sqrt(2))
    assert math.isnan(differences([1.0, 2.0], [0.0, 0.0], [0, 1], "grid").half)  # one noise


def test_of_a_sobol_design_the_two_points_drawn_for_each_block_are_independent():
    one = [1.0, 50.0, 2.0, 3.0, 50.0, 4.0]
    found = differences(one, [0.0] * 6, method="sobol")
    drawn = np.array([1.0, 2.0, 3.0, 4.0])
    half = stats.t.ppf(0.975, 3) * drawn.std(ddof=1) / math.sqrt(4)
    assert found.half == pytest.approx(half)


def test_a_failed_run_is_worse_than_any_other_and_in_no_mean():
    found = differences([1.0, NAN, 2.0, NAN, 5.0], [2.0, 1.0, NAN, NAN, 4.0])
    assert (found.better, found.worse, found.both_failed) == (2, 2, 1)
    assert found.mean == 0.0
    nothing = differences([NAN, 1.0], [1.0, NAN])
    assert math.isnan(nothing.mean)
    assert math.isnan(nothing.half)


def test_the_interval_holds_the_true_difference_in_95_of_100_studies():
    rng = np.random.default_rng(11)
    held = 0
    for _ in range(600):
        rig = np.repeat(rng.normal(0, 5, size=12), 2)  # two noises a rig
        own = np.repeat(rng.normal(0, 1, size=12), 2)
        one, other = (rig + rng.normal(0, 0.3, size=24) for _ in "AB")
        found = differences(one + own + 0.7, other, points=np.repeat(np.arange(12), 2))
        held += abs(found.mean - 0.7) <= found.half
    assert 0.92 <= held / 600 <= 0.98


@pytest.mark.long
def test_a_study_has_its_pairs_in_report_and_table(tmp_path):
    friction = {
        "title": "Two laws",
        "scenario": "circle",
        "set": [*SHORT, "plant.start.x_rate=0.05"],
        "method": "montecarlo",
        "samples": 6,
        "metrics": ["rms_distance"],
        "parameters": {"plant.friction.rolling_mm": {"uniform": [0.05, 0.3], "unit": "mm"}},
        "variants": [
            {"name": "slow", "set": ["controller.kind=lqr"]},
            {"name": "quick", "set": ["controller.kind=afl"]},
        ],
    }
    found = bp.study(friction, seeds=1, processes=1, out=tmp_path / "out")
    (pair,) = found.pairs().to_dict("records")
    rows = found.to_pandas().pivot(index="point", columns="variant", values="rms_distance")
    difference = rows[pair["first"]] - rows[pair["second"]]
    assert pair["mean"] == pytest.approx(difference.mean())
    assert pair["better"] == (difference < 0).sum()
    page = (tmp_path / "out" / "report.html").read_text()
    assert f"{pair['first']} minus {pair['second']}" in page
    assert (tmp_path / "out" / "figures" / "scatter.svg").is_file()
