"""What a healthy rig scatters is learned; one window alone is no alarm; play is believed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from twin.identify.log import MECHANISM_LAG
from twin.identify.plate_motion import servo_response
from twin.identify.prepare import Segment
from twin.scenario import load
from twin.shadow.belief import PARAMETERS, Belief
from twin.shadow.diagnosis import THRESHOLD
from twin.shadow.evidence import Evidence
from twin.shadow.monitor import MOST, bounded, scatter, statistic
from twin.shadow.plate import plate_evidence
from twin.sim.drives import Play

ROLLING = PARAMETERS.index("rolling")


def belief_of(*settings):
    return Belief.of(load("excite", settings), SimpleNamespace(own_lag=MECHANISM_LAG, grips=(0.0,)))


def windows(rolling):
    """One window a second that shows rolling friction alone, in relative deviations, well."""
    count, belief = len(rolling), belief_of()
    sd = 1e-3 * belief.values["rolling"]
    begin = np.arange(count, dtype=float)
    return Evidence.of(
        ("rolling",),
        np.stack((begin, begin + 1), axis=-1),
        np.full((count, 1, 1), sd**-2),
        np.asarray(rolling)[:, None] * belief.values["rolling"] / sd**2,
    )


def test_scatter_between_windows_is_learned_and_an_offset_is_not():
    rng = np.random.default_rng(3)
    belief = belief_of()
    expected = belief.changing[0, ROLLING] / belief.values["rolling"]
    for times, offset in ((1.0, 0.0), (5.0, 0.0), (1.0, 0.05), (5.0, 0.05)):
        off = offset + times * expected * rng.standard_normal(400)
        factor = scatter(windows(off), belief)[-1, ROLLING]
        assert factor == pytest.approx(times, abs=0.25 * times)
    wild = scatter(windows(100 * expected * rng.standard_normal(400)), belief)
    assert wild.max() == MOST


def test_a_change_widens_nothing_while_it_may_still_be_one():
    off = np.concatenate((np.zeros(40), np.full(20, 0.3)))
    factor = scatter(windows(off), belief_of())[:, ROLLING]
    assert factor[46] <= factor[39]
    assert factor[59] > 2 * factor[39]


def test_one_window_is_no_alarm_and_five_are():
    belief = belief_of()
    for wrong, alarms in ((1, False), (5, True)):
        off = np.zeros(40)
        off[20 : 20 + wrong] = 0.3
        soft = windows(off).softened(belief.changing)
        assert statistic(soft, belief).max() > 2 * THRESHOLD
        assert bool(statistic(bounded(soft, belief), belief).max() > THRESHOLD) == alarms


def test_play_and_cams_that_are_believed_are_no_evidence_of_a_change():
    period, width = 0.002, np.radians(0.2)
    time = period * np.arange(6000)
    rate = np.radians(3.0) * np.stack((np.cos(2 * time), np.sin(3 * time)), axis=-1)
    shaft = 1.03 * servo_response(rate, period, 0.0)[0]
    gap = Play(np.full((1, 1), width))
    turns = np.diff(shaft, axis=0, prepend=shaft[:1])
    behind = np.cumsum([gap.follow(turn[None])[0] for turn in turns], axis=0)
    late = time - MECHANISM_LAG
    angle = np.stack([np.interp(late, time, behind[:, axis]) for axis in (0, 1)], axis=-1)
    segment = Segment(time, angle, rate, time, np.zeros_like(rate))
    log = SimpleNamespace(segments=(segment,), period=period)

    def pull(*settings):
        found = plate_evidence(log, belief_of(*settings), np.zeros((0, 2)))
        return np.abs(found.score[:, which]).sum(axis=0)

    which = [PARAMETERS.index(name) for name in ("wide_play", "transmission")]
    exact = "plant.kind=lagrange"  # with the lag of the log, and no plate on wheels
    known = pull(exact, "plant.servo.backlash_deg=0.2", "rig.cam_error_percent=[3.0, 3.0]")
    assert (known < 1e-6 * pull(exact)).all()


def test_the_same_evidence_weakened_says_the_same_less_loudly():
    soft = windows(np.full(3, 0.3)).softened(belief_of().changing)
    weak = bounded(soft, belief_of())
    ratio = weak.score[:, ROLLING] / weak.information[:, ROLLING, ROLLING]
    before = soft.score[:, ROLLING] / soft.information[:, ROLLING, ROLLING]
    assert ratio == pytest.approx(before)
    assert weak.information[0, ROLLING, ROLLING] < soft.information[0, ROLLING, ROLLING] / 5
    assert replace(weak, information=soft.information, score=soft.score).end.tolist() == [1, 2, 3]
