"""`twin.shadow.alarms`.

The sequential tests: what is learned, what adds up to an alarm, and what is none.

Another dead time shows as many small signs: they add up, and a few large ones do not.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from twin.identify.logs import MECHANISM_LAG
from twin.identify.plate_motion import servo_response
from twin.identify.prepare import Segment
from twin.scenario import load
from twin.shadow.alarms import (
    CHANGE_TEST,
    DEAD_TIME_CAUSES,
    DEAD_TIME_TEST,
    SCATTER_ESTIMATE,
    ChangeTest,
    DeadTimeTest,
    SequentialTests,
    added_up,
    bound_evidence,
    dead_time_ratio,
    limit_dead_time_evidence,
    resolution,
    scatter,
    statistic,
    statistic_at,
)
from twin.shadow.belief import WATCHED_PARAMETERS, Belief
from twin.shadow.evidence import Evidence
from twin.shadow.plate import plate_evidence
from twin.sim.drives import Play

ALARM_LLR, LATE_LLR = CHANGE_TEST.threshold_llr, DEAD_TIME_TEST.threshold_llr
MAX_INCREMENT = DEAD_TIME_TEST.max_llr_increment

LATE = WATCHED_PARAMETERS.index("delay")


def belief_of(*settings):
    return Belief.of(load("excite", settings), SimpleNamespace(own_lag=MECHANISM_LAG, grips=(0.0,)))


@pytest.fixture(scope="module")
def belief():
    return belief_of()


def make_evidence(name, values, sd, *, stopping=False):
    """One window a second, each of which shows a deviation of one parameter."""
    count = len(values)
    begin = np.arange(count, dtype=float)
    return Evidence.of(
        (name,),
        np.stack((begin, begin + 1), axis=-1),
        np.full((count, 1, 1), sd**-2),
        np.asarray(values)[:, None] / sd**2,
        stopping=np.full(count, stopping),
    )


def windows(late):
    """Windows in which a ball stops, each showing a dead time as well as a real one."""
    return make_evidence("delay", late, 2e-3, stopping=True)


def rolled(rolling):
    """One window a second that shows rolling friction alone, in relative deviations, well."""
    unit = belief_of().values["rolling"]
    return make_evidence("rolling", np.asarray(rolling) * unit, 1e-3 * unit)


def test_many_small_signs_are_an_alarm_and_a_few_large_ones_are_not(belief):
    some = np.zeros(40)
    few = np.zeros(40)
    few[20:22] = 0.05
    some[20:] = 0.006
    for late, alarms in ((some, True), (few, False), (np.zeros(40), False)):
        ratio = dead_time_ratio(limit_dead_time_evidence(windows(late), belief), belief)
        assert bool(ratio.max() > LATE_LLR) == alarms
        assert ratio[:20].max() < LATE_LLR / 3


@pytest.mark.long
def test_healthy_windows_raise_no_dead_time_alarm_and_the_old_threshold_did(belief):
    # windows of rigs with even screens scatter as they say, and each by itself
    rng = np.random.default_rng(12)
    found = windows(2e-3 * rng.standard_normal(DEAD_TIME_TEST.windows_per_hour // 4))
    ratio = dead_time_ratio(limit_dead_time_evidence(found, belief), belief)
    assert ratio.max() < LATE_LLR
    assert ratio.max() > 3.4  # what was an alarm before
    # 24 hours of windows, each of which may begin a change that is none
    assert np.exp(-LATE_LLR) * 24 * DEAD_TIME_TEST.windows_per_hour == pytest.approx(1)


@pytest.mark.short("gain-0.002")
@pytest.mark.parametrize(("name", "sd"), [("lag", 1e-4), ("rolling", 2e-6), ("gain", 2e-3)])
def test_a_change_beyond_the_resolution_is_an_alarm_and_one_within_it_is_none(belief, name, sd):
    cause = {"lag": "servo lag", "rolling": "rolling friction", "gain": "tilt gain"}[name]
    tests = SequentialTests(belief)
    tests.add(make_evidence(name, np.zeros(60), sd))
    least = resolution(tests)[cause]
    for share, alarms in ((0.7, False), (1.3, True)):
        tests = SequentialTests(belief)
        tests.add(make_evidence(name, np.repeat((0.0, share * least), (60, 50)), sd))
        assert bool(tests.crossings) == alarms


def test_four_ms_of_delay_of_the_drives_are_within_what_is_called_indistinguishable(belief):
    # well as the plate shows a lag, it drifts on healthy rigs by some ms
    tests = SequentialTests(belief)
    tests.add(make_evidence("lag", np.zeros(60), 2e-5))
    assert 0.004 < resolution(tests)["servo lag"] < 0.008
    assert "dead time" not in resolution(tests)  # no window showed it


def test_what_is_short_of_an_alarm_is_called_possible(belief):
    for share, possible in ((0.9, True), (0.5, False)):
        tests = SequentialTests(belief, delayed=np.array([0.0, share * LATE_LLR]))
        assert tests.suspected == possible


def test_other_causes_raise_no_dead_time(belief):
    moved = windows(np.zeros(40))
    friction = WATCHED_PARAMETERS.index("rolling")
    A, b = moved.information.copy(), moved.score.copy()
    A[:, friction, friction], b[20:, friction] = 1e12, 1e12 * 5e-5
    other = Evidence(moved.begin, moved.end, A, b, *(getattr(moved, name) for name in REST))
    assert dead_time_ratio(limit_dead_time_evidence(other, belief), belief).max() < LATE_LLR / 3


REST = ("height", "stopping", "dispersion")


def mixed(seed, late, off, count=60):
    """Windows that show breakaway, tilt gain and dead time only in sums of the three.

    In one of 15 breakaway and gain are further off than the belief expects between windows.
    """
    rng = np.random.default_rng(seed)
    names, room = ("breakaway", "gain", "delay"), np.array([0.03, 0.0015])
    slopes = rng.standard_normal((count, 3, 3)) / (0.05, 0.01, 0.004)
    true = np.zeros((count, 3))
    true[:, :2] = room * rng.standard_normal((count, 2))
    true[rng.random(count) < 1 / 15, :2] += off * room * rng.standard_normal(2)
    true[count // 2 :, 2] = late
    seen = slopes @ true[..., None] + rng.standard_normal((count, 3, 1))
    turned = np.swapaxes(slopes, 1, 2)
    begin = np.arange(count, dtype=float)
    spans = np.stack((begin, begin + 1), axis=-1)
    stopping = np.ones(count, bool)
    return Evidence.of(names, spans, turned @ slopes, (turned @ seen)[..., 0], stopping=stopping)


@pytest.mark.short("20")
@pytest.mark.parametrize("off", [0, 20])
def test_windows_in_which_friction_seems_far_off_are_no_dead_time_and_hide_none(belief, off):
    # found on a healthy rig: alone such windows say little of the dead time, with others much
    for late, alarms in ((0.0, False), (0.005, True)):
        for seed in (8, 9, 10):
            found = limit_dead_time_evidence(mixed(seed, late, off), belief)
            assert bool(dead_time_ratio(found, belief).max() > LATE_LLR) == alarms


def test_windows_added_later_say_what_all_at_once_say(belief):
    rng = np.random.default_rng(4)
    ball = windows(0.002 * rng.standard_normal(30) + 0.004 * (np.arange(30) > 12))
    plate = np.arange(30) % 3 == 1  # these show nothing of the dead time
    every = replace(ball, information=np.where(plate[:, None, None], 0.0, ball.information))
    whole = limit_dead_time_evidence(every, belief)
    assert len(whole) == 20
    first = limit_dead_time_evidence(every.take(np.arange(12)), belief)
    parts = Evidence.join([first, limit_dead_time_evidence(every, belief, after=12)])
    assert parts.score == pytest.approx(whole.score)
    assert dead_time_ratio(parts, belief, after=12)[12:] == pytest.approx(
        dead_time_ratio(whole, belief)[12:]
    )
    ratio = dead_time_ratio(whole, belief)
    stands = statistic_at(whole, ratio, every.end)
    assert stands[plate] == pytest.approx(stands[np.flatnonzero(plate) - 1])
    assert stands[~plate] == pytest.approx(ratio)


def test_no_window_adds_more_than_it_may_whatever_came_before(belief):
    rng = np.random.default_rng(7)
    found = windows(0.002 * rng.standard_t(1.5, 60))
    ratio = dead_time_ratio(found, belief)
    assert np.diff(ratio, prepend=0.0).max() <= MAX_INCREMENT + 1e-9
    assert np.diff(added_up(found, belief, 0, DEAD_TIME_CAUSES, np.inf)).max() > 1.5 * MAX_INCREMENT


def test_without_a_bound_it_is_the_largest_ratio_of_any_change(belief):
    found = windows(np.repeat((0.0, 0.004), 10))
    every = added_up(found, belief, 0, DEAD_TIME_CAUSES, np.inf)
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
    rig = belief_of(f"plant.surface.spread_percent={spread}")
    late = np.repeat((0.0, 0.006), 20)
    assert (
        bool(dead_time_ratio(limit_dead_time_evidence(windows(late), rig), rig).max() > LATE_LLR)
        == alarms
    )


def test_either_test_raises_an_alarm_and_both_together_one():
    quiet, loud = np.zeros(9), np.r_[0.0, 0, 0, 2, 2, 2, 0, 0, 0]
    for every, late, ratio in (
        (loud * ALARM_LLR, quiet, 2 * ALARM_LLR),
        (quiet, loud * LATE_LLR, 2 * LATE_LLR),
        (
            loud * ALARM_LLR,
            loud * LATE_LLR,
            2 * ALARM_LLR,
        ),
    ):
        found = SequentialTests(None, ratio=every, delayed=late)
        assert found.crossings == [3]
        assert found.crossed(3) == ratio
    assert not SequentialTests(None, ratio=quiet, delayed=quiet).crossings


ROLLING = WATCHED_PARAMETERS.index("rolling")


def test_scatter_between_windows_is_learned_and_an_offset_is_not():
    rng = np.random.default_rng(3)
    belief = belief_of()
    expected = belief.changing[0, ROLLING] / belief.values["rolling"]
    for times, offset in ((1.0, 0.0), (5.0, 0.0), (1.0, 0.05), (5.0, 0.05)):
        off = offset + times * expected * rng.standard_normal(400)
        factor = scatter(rolled(off), belief)[-1, ROLLING]
        assert factor == pytest.approx(times, abs=0.25 * times)
    wild = scatter(rolled(100 * expected * rng.standard_normal(400)), belief)
    assert wild.max() == SCATTER_ESTIMATE.max_factor


def test_a_change_widens_nothing_while_it_may_still_be_one():
    off = np.concatenate((np.zeros(40), np.full(20, 0.3)))
    factor = scatter(rolled(off), belief_of())[:, ROLLING]
    assert factor[46] <= factor[39]
    assert factor[59] > 2 * factor[39]


def test_one_window_is_no_alarm_and_five_are():
    belief = belief_of()
    for wrong, alarms in ((1, False), (5, True)):
        off = np.zeros(40)
        off[20 : 20 + wrong] = 0.3
        soft = rolled(off).softened(belief.changing)
        assert statistic(soft, belief).max() > 2 * ALARM_LLR
        assert bool(statistic(bound_evidence(soft, belief), belief).max() > ALARM_LLR) == alarms


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

    which = [WATCHED_PARAMETERS.index(name) for name in ("wide_play", "transmission")]
    exact = "plant.kind=lagrange"  # with the lag of the log, and no plate on wheels
    known = pull(exact, "plant.servo.backlash_deg=0.2", "rig.cam_error_percent=[3.0, 3.0]")
    assert (known < 1e-6 * pull(exact)).all()


@pytest.mark.parametrize(("largest_deg", "shows"), [(3.0, True), (9.0, False)])
def test_a_plate_that_tilts_too_far_to_be_linear_is_no_evidence_of_lost_motion(largest_deg, shows):
    # found under internal_model: a start near the end of the plate's reach
    period, largest = 0.002, np.radians(largest_deg)
    time = period * np.arange(3000)
    rate = 2 * largest * np.cos(2 * time)[:, None] * (1.0, -1.0)
    shaft = servo_response(rate, period, 0.0)[0]
    angle = np.arctan(shaft)  # as far from linear as a lever
    segment = Segment(time, angle, rate, time, np.zeros_like(rate))
    log = SimpleNamespace(segments=(segment,), period=period)
    found = plate_evidence(log, belief_of("plant.kind=lagrange"), np.zeros((0, 2)))
    assert len(found)
    assert found.information.any() == shows


def test_the_same_evidence_weakened_says_the_same_less_loudly():
    soft = rolled(np.full(3, 0.3)).softened(belief_of().changing)
    weak = bound_evidence(soft, belief_of())
    ratio = weak.score[:, ROLLING] / weak.information[:, ROLLING, ROLLING]
    before = soft.score[:, ROLLING] / soft.information[:, ROLLING, ROLLING]
    assert ratio == pytest.approx(before)
    assert weak.information[0, ROLLING, ROLLING] < soft.information[0, ROLLING, ROLLING] / 5
    assert replace(weak, information=soft.information, score=soft.score).end.tolist() == [1, 2, 3]


def test_another_test_is_passed_in_and_raises_another_alarm(belief):
    found = rolled(np.repeat((0.0, 0.3), 20))
    usual = SequentialTests(belief)
    usual.add(found)
    assert usual.crossings
    deaf = SequentialTests(
        belief,
        ChangeTest(threshold_llr=2 * usual.ratio.max()),
        DeadTimeTest(windows_per_hour=10**15),
    )
    deaf.add(found)
    assert not deaf.crossings
    assert np.array_equal(deaf.ratio, usual.ratio)
    weak = SequentialTests(belief, ChangeTest(max_llr_per_window=0.1))
    weak.add(found)
    assert weak.ratio.max() < usual.ratio.max() / 3
