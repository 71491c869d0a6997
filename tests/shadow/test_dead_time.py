"""Another dead time shows as many small signs: they add up, and a few large ones do not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from twin.identify.log import MECHANISM_LAG
from twin.scenario import load
from twin.shadow.belief import PARAMETERS, Belief
from twin.shadow.diagnosis import THRESHOLD, Findings
from twin.shadow.evidence import Evidence
from twin.shadow.monitor import ADDED, CAUSE, added_up, delayed, limited, standing
from twin.shadow.monitor import LATE_THRESHOLD as OWN

LATE = PARAMETERS.index("delay")


@pytest.fixture(scope="module")
def belief():
    return Belief.of(load("excite"), SimpleNamespace(own_lag=MECHANISM_LAG, grips=(0.0,)))


def windows(late, sd=2e-3):
    """One window a second in which a ball stops, each showing a dead time as well as a real one."""
    count = len(late)
    begin = np.arange(count, dtype=float)
    return Evidence.of(
        ("delay",),
        np.stack((begin, begin + 1), axis=-1),
        np.full((count, 1, 1), sd**-2),
        np.asarray(late)[:, None] / sd**2,
        stopping=np.ones(count, bool),
    )


def test_many_small_signs_are_an_alarm_and_a_few_large_ones_are_not(belief):
    some = np.zeros(40)
    some[20:] = 0.005
    few = np.zeros(40)
    few[20:22] = 0.05
    for late, alarms in ((some, True), (few, False), (np.zeros(40), False)):
        ratio = delayed(limited(windows(late), belief), belief)
        assert bool(ratio.max() > OWN) == alarms
        assert ratio[:20].max() < OWN / 3


def test_other_causes_raise_no_dead_time(belief):
    moved = windows(np.zeros(40))
    friction = PARAMETERS.index("rolling")
    A, b = moved.information.copy(), moved.score.copy()
    A[:, friction, friction], b[20:, friction] = 1e12, 1e12 * 5e-5
    other = Evidence(moved.begin, moved.end, A, b, *(getattr(moved, name) for name in REST))
    assert delayed(limited(other, belief), belief).max() < OWN / 3


REST = ("height", "stopping", "dispersion")


def test_windows_added_later_say_what_all_at_once_say(belief):
    rng = np.random.default_rng(4)
    ball = windows(0.002 * rng.standard_normal(30) + 0.004 * (np.arange(30) > 12))
    plate = np.arange(30) % 3 == 1  # these show nothing of the dead time
    every = replace(ball, information=np.where(plate[:, None, None], 0.0, ball.information))
    whole = limited(every, belief)
    assert len(whole) == 20
    first = limited(every.take(np.arange(12)), belief)
    parts = Evidence.join([first, limited(every, belief, after=12)])
    assert parts.score == pytest.approx(whole.score)
    assert delayed(parts, belief, after=12)[12:] == pytest.approx(delayed(whole, belief)[12:])
    ratio = delayed(whole, belief)
    stands = standing(whole, ratio, every.end)
    assert stands[plate] == pytest.approx(stands[np.flatnonzero(plate) - 1])
    assert stands[~plate] == pytest.approx(ratio)


def test_no_window_adds_more_than_it_may_whatever_came_before(belief):
    rng = np.random.default_rng(7)
    found = windows(0.002 * rng.standard_t(1.5, 60))
    ratio = delayed(found, belief)
    assert np.diff(ratio, prepend=0.0).max() <= ADDED + 1e-9
    assert np.diff(added_up(found, belief, 0, CAUSE, np.inf)).max() > 2 * ADDED


def test_without_a_bound_it_is_the_largest_ratio_of_any_change(belief):
    found = windows(np.repeat((0.0, 0.004), 10))
    every = added_up(found, belief, 0, CAUSE, np.inf)
    prior = belief.drift[LATE] ** 2

    def evidence(d, variance, mean):  # of windows with independent errors, by their joint density
        cov = 0.002**2 * np.eye(len(d)) + variance
        return stats.multivariate_normal.logpdf(d, mean=np.full(len(d), mean), cov=cov)

    late = np.repeat((0.0, 0.004), 10)
    best = -np.inf
    for begin in range(20):
        before = 1 / (belief.constant[LATE] ** -2 + begin / 0.002**2)
        mean = before * late[:begin].sum() / 0.002**2
        none = evidence(late[begin:], before + prior, mean)
        best = max(best, evidence(late[begin:], before + prior + 0.006**2, mean) - none)
    assert every[-1] == pytest.approx(best)


@pytest.mark.parametrize(("spread", "alarms"), [(0, True), (20, False)])
def test_on_an_uneven_screen_what_looks_like_dead_time_may_be_the_screen(spread, alarms):
    # found on family rigs: every window of a drive in closed loop shows some ms too much
    log = SimpleNamespace(own_lag=MECHANISM_LAG, grips=(0.0,))
    rig = Belief.of(load("excite", [f"plant.surface.spread_percent={spread}"]), log)
    late = np.repeat((0.0, 0.006), 20)
    assert bool(delayed(limited(windows(late), rig), rig).max() > OWN) == alarms


def test_either_test_raises_an_alarm_and_both_together_one():
    quiet, loud = np.zeros(9), np.r_[0.0, 0, 0, 2, 2, 2, 0, 0, 0]
    for every, late, ratio in (
        (loud * THRESHOLD, quiet, 2 * THRESHOLD),
        (quiet, loud * OWN, 2 * OWN),
        (loud * THRESHOLD, loud * OWN, 2 * THRESHOLD),
    ):
        soft = windows(np.zeros(9))
        found = Findings(soft, np.ones((9, 1)), every, late, None, None, soft)
        assert found.crossings == [3]
        assert found.crossed(3) == ratio
    assert not Findings(soft, np.ones((9, 1)), quiet, quiet, None, None, soft).crossings
