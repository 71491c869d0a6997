"""Another dead time shows as many small signs: they add up, and a few large ones do not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from twin.identify.log import MECHANISM_LAG
from twin.scenario import load
from twin.shadow.alarms import THRESHOLD, Findings
from twin.shadow.belief import PARAMETERS, Belief
from twin.shadow.dead_time import THRESHOLD as OWN
from twin.shadow.dead_time import delayed, limited, narrowed
from twin.shadow.evidence import Evidence

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
        np.zeros((count, 2)),
        stopping=np.ones(count, bool),
    )


def test_many_small_signs_are_an_alarm_and_a_few_large_ones_are_not(belief):
    some = np.zeros(40)
    some[20:] = 0.005
    few = np.zeros(40)
    few[20:22] = 0.05
    for late, alarms in ((some, True), (few, False), (np.zeros(40), False)):
        ratio = delayed(limited(narrowed(windows(late), belief), belief), belief)
        assert bool(ratio.max() > OWN) == alarms
        assert ratio[:20].max() < OWN / 3


def test_other_causes_raise_no_dead_time(belief):
    moved = windows(np.zeros(40))
    friction = PARAMETERS.index("rolling")
    A, b = moved.information.copy(), moved.score.copy()
    A[:, friction, friction], b[20:, friction] = 1e12, 1e12 * 5e-5
    other = Evidence(moved.begin, moved.end, A, b, *(getattr(moved, name) for name in REST))
    assert delayed(limited(narrowed(other, belief), belief), belief).max() < OWN / 3


REST = ("place", "height", "stopping", "dispersion")


def test_windows_added_later_say_what_all_at_once_say(belief):
    rng = np.random.default_rng(4)
    every = narrowed(windows(0.004 * rng.standard_normal(30)), belief)
    whole = limited(every, belief)
    first = limited(every.take(np.arange(12)), belief)
    parts = Evidence.join([first, limited(every, belief, after=12)])
    assert parts.score == pytest.approx(whole.score)
    assert delayed(parts, belief, after=12)[12:] == pytest.approx(delayed(whole, belief)[12:])


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
