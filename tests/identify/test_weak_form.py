"""`twin.identify.weak_form`: what windows of several lengths, kinds and linkages share."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from twin.identify import weak_form
from twin.identify.command_model import TiltHistory
from twin.identify.weak_form import WEAK_FORM, Linkage, WeakWindows, _find_delay, make_grids


def test_the_integrals_of_a_tilt_are_those_of_the_tilt_behind_its_whole_linkage(log):
    """Windows of other lengths and other levers share the tilts: each by a sum of its own."""
    grids, h = make_grids(log, (0.4, 0.9)), WEAK_FORM.step_s
    assert len(grids) == 2
    history, delays = TiltHistory(replace(log, lever=None)), (-h, 0.0, 39 * h, 0.5 + h)
    for grid, lag, play, lever in product(grids, (0.0, 0.04), (0.0, 0.4), (0.0, 0.08, -0.05)):
        drive, linkage = (lag, 0.0, play, 0.0, lever), Linkage(lever, play)
        rows = np.array([grid.half, 1000, len(grid.time) - grid.half - 1])
        found, around = grid.push(rows, lag, linkage), h * np.arange(-grid.half, grid.half + 1)
        for k, delay in zip((0, 1, 40, len(found) - 1), delays, strict=True):
            at = grid.time[rows][:, None] + around - delay
            assert found[k] == pytest.approx(history.at(at, *drive) @ grid.weight, abs=1e-9)
        expected = history.at(grid.time - 0.17, *drive)
        assert grid.delayed_tilt(0.17, lag, linkage) == pytest.approx(expected, abs=1e-9)


def test_the_delay_is_that_with_the_least_residual_of_all_least_squares():
    rng = np.random.default_rng(2)
    for _ in range(5):
        pushed = {lag: 5 + rng.normal(size=(23, 60)).cumsum(axis=1) for lag in (0.0, 0.04)}
        others = np.column_stack((np.ones(60), rng.normal(size=(60, 2))))
        left, kept = rng.normal(size=60).cumsum(), rng.random(60) > 0.2
        residuals = {
            (lag, k): np.linalg.lstsq(
                np.column_stack((every[k], others))[kept], left[kept], rcond=None
            )[1][0]
            for lag, every in pushed.items()
            for k in range(1, 22)
        }
        with_squares = {lag: (every, every[1:-1] ** 2) for lag, every in pushed.items()}
        found = _find_delay(with_squares, others, left, kept)
        assert found == min(residuals, key=residuals.__getitem__)


def test_windows_that_are_the_same_are_solved_once_and_others_anew(log, monkeypatch):
    solved, solve = [], weak_form._solve
    monkeypatch.setattr(weak_form, "_solve", lambda *about: solved.append(about) or solve(*about))
    (grid,), (fresh,) = (make_grids(log, (0.9,)) for _ in range(2))
    every, again = (WeakWindows.of(grid, rolling=False) for _ in range(2))
    first = every.solve(("damping",), Linkage())
    assert again.solve(("damping",), Linkage()) is first
    assert len(solved) == 1
    fewer = WeakWindows.of(grid, rolling=False, max_slow_share=0.15)
    assert 0 < len(fewer.rows) < len(every.rows)
    alone = WeakWindows.of(fresh, rolling=False, max_slow_share=0.15)
    for terms, linkage in ((("damping",), Linkage()), (("camber",), Linkage(0.08))):
        found, expected = (each.solve(terms, linkage) for each in (fewer, alone))
        assert found.values.tolist() == expected.values.tolist()
        assert len(found.residuals) == len(fewer.rows)
    assert len(solved) == 5
