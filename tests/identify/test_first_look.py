"""`twin.identify.first_look`, and the searches of `twin.identify.plain_model` that it precedes."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from docs.identify_errors import Rig, simulate_log
from twin.base.errors import LogError
from twin.identify import command_model, first_look
from twin.identify.any_rig import _describe_work, _tell_rest, identify_axes
from twin.identify.axis_fitting import AXIS_FITTING
from twin.identify.axis_logs import AnyLog, AxisLog
from twin.identify.axis_problem import AxisProblem
from twin.identify.axis_selection import AXIS_SELECTION
from twin.identify.axis_verdicts import assess_axis
from twin.identify.command_model import TiltHistory
from twin.identify.drive_effects import profile, profile_contenders
from twin.identify.fallback import PLAIN_WHY
from twin.identify.first_look import (
    TriedLinkages,
    find_misfits,
    find_possible_linkages,
    join_looks,
    look_at_any_motion,
    look_at_rolling_in_several_ways,
    look_first,
    look_linearly,
    look_plainly,
    look_with_linkages,
)
from twin.identify.further_terms import find_significance, find_term
from twin.identify.least_squares import StepControl, fit_starts_from_scratch, minimise
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.plain_model import AxisFit, fit_axis
from twin.identify.weak_form import WEAK_FORM, Linkage, WeakWindows, make_grids
from twin.identify.windows import axis_windows, spans

TRUTH = {"gain": 6.0, "dead_time": 0.1, "lag": 0.08, "level": 0.05, "friction": 0.03}


@pytest.fixture(scope="module")
def log(axis_log):
    time, ball, command = axis_log(3, seconds=25, rate=60.0, pixel=0.0, noise=3e-4, **TRUTH)
    return AxisLog(time, command, True, time, ball)


@pytest.fixture(scope="module")
def fit(log):
    """The fit of the true model, begun at the truth."""
    windows = axis_windows(log, *spans(log, 2.5))
    windows = replace(windows, weight=windows.weight / 3e-4)
    problem = AxisProblem(windows, tuple(TRUTH), TiltHistory(log), 2.52, (0.0, 0.5))
    theta = np.array([[*TRUTH.values()]])
    theta[0, 0] *= problem.tilt.scale
    found = minimise(problem, theta, fit_starts_from_scratch(problem, theta, 4), 15)
    return AxisFit(problem, found, log, 3e-4, 3e-4)


def test_a_first_look_finds_gain_delay_and_level_of_a_rig(log):
    found = look_first(log)
    assert found.gain == pytest.approx(TRUTH["gain"], rel=0.04)
    assert found.gain == pytest.approx(TRUTH["gain"], abs=3 * found.gain_std)
    assert found.delay == pytest.approx(TRUTH["dead_time"] + TRUTH["lag"], abs=0.015)
    assert found.level == pytest.approx(TRUTH["level"], abs=0.01)
    assert found.at_ends == 0.0
    told = found.describe("x", "rad")
    assert told.startswith("first look, x: gain ")
    assert "end stop" not in told


def test_a_first_look_states_intervals_that_hold_its_variants_and_the_terms_it_has(log):
    found = look_first(log)
    assert found.variants
    low, high = found.interval("gain")
    for each in (found, *found.variants):
        assert low <= each.gain - 2 * each.gain_std
        assert each.gain + 2 * each.gain_std <= high
    assert low < TRUTH["gain"] < high
    far = replace(found.variants[0], gain=20.0, gain_std=0.5)
    wider = replace(found, variants=(*found.variants, far))
    assert wider.interval("gain") == (low, 21.0)
    assert "to 21 m/s^2 by rad" in wider.describe("x", "rad")
    assert "+-" not in found.describe("x", "rad")
    # what a look lacks is what its terms lack, whatever its windows are
    for plain in (True, False):
        rubbed, smooth = (
            replace(found, plain=plain, terms=terms).describe("x", "rad")
            for terms in (("friction", "camber"), ("damping",))
        )
        assert "without friction" not in rubbed
        assert "without friction" in smooth


def test_a_first_look_leaves_out_where_the_ball_is_at_an_end_stop():
    """A tube: without friction, its ends take the ball's speed."""
    h, stop, rng = 1e-3, 0.03, np.random.default_rng(0)
    time = h * np.arange(40_000)
    tilt = 0.04 * np.interp(time, np.arange(0, 41, 0.4), rng.uniform(-1, 1, 103)[:103])
    x, v, places = 0.0, 0.0, np.empty_like(time)
    for k, push in enumerate(6.0 * tilt):
        v += h * push
        x += h * v
        if abs(x) > stop:
            x, v = np.copysign(stop, x), 0.0
        places[k] = x
    seen = slice(None, None, 10)
    ball = places[seen] + 1e-4 * rng.standard_normal(len(time[seen]))
    log = AxisLog(time[seen], tilt[seen], False, time[seen], ball)
    found = look_first(log)
    assert found.at_ends > 0.2
    assert "% at an end stop" in found.describe("x", "rad")
    assert found.gain == pytest.approx(6.0, rel=0.05)
    whole = look_first(log, replace(WEAK_FORM, min_end_share=1.0, min_speed_m_s=-1.0))
    assert whole is None or abs(whole.gain - 6.0) > 3 * abs(found.gain - 6.0)


def linear_motion(gain, damping, delay):
    """Times, an exact solution of x'' = gain u - damping x', and the command a delay before."""
    time = np.arange(0.0, 40.0, 0.01)
    ball, sent = np.zeros_like(time), np.zeros_like(time)
    for size, w in ((0.03, 1.1), (0.02, 2.7), (0.02, 4.9)):
        ball += size / w**2 * np.real(gain * np.exp(1j * w * time) / (-1 + 1j * damping / w))
        sent += size * np.cos(w * (time + delay))
    return time, ball, sent


def test_the_plain_model_is_found_by_windows_of_any_motion():
    gain, damping, delay = 6.0, 0.8, 0.15
    time, ball, sent = linear_motion(gain, damping, delay)
    for damped in (True, False):
        terms = ("damping",) if damped else ()
        found = look_plainly(AxisLog(time, sent, False, time, ball), 0.9, terms=terms)
        assert found.terms == terms
        assert found.plain
        assert (found.gain == pytest.approx(gain, rel=0.01)) == damped
        assert (found.delay == pytest.approx(delay, abs=0.006)) == damped
        assert (found.explained > 0.999) == damped
    found = look_plainly(AxisLog(time, sent, False, time, ball), 0.9)
    assert found.damping == pytest.approx(damping, rel=0.02)
    log = AxisLog(time, sent, False, time, ball)
    for grid in make_grids(log, WEAK_FORM.plain_windows_s):
        both = look_linearly(WeakWindows.of(grid, rolling=False))
        assert both[0].damping == pytest.approx(damping, rel=0.02)
        assert len(both) == 2


def test_all_looks_share_one_tilt_and_none_between_end_stops_is_computed_twice(monkeypatch, log):
    solve, drive, solved, driven = WeakWindows.solve, command_model.drive_path, [], []

    def count_solve(windows, terms, linkage):
        solved.append((windows.grid.half, terms, linkage))
        return solve(windows, terms, linkage)

    def count_drive(*args):
        driven.append(args)
        return drive(*args)

    monkeypatch.setattr(WeakWindows, "solve", count_solve)
    monkeypatch.setattr(command_model, "drive_path", count_drive)
    tried = TriedLinkages((-0.05, 0.0, 0.05), (0.0, 0.1))
    assert look_at_rolling_in_several_ways(log, tried)
    assert len(solved) == len(set(solved)) > 10
    assert len(driven) == 1
    assert look_at_any_motion(log, tried)
    assert len(driven) == 2


def exact_motion(friction, lever=0.0, seconds=40.0, play=0.0, steps=False):
    """A log of x'' = 6 (u - lever u''/g) - friction sign(x') without noise, and how it begins.

    Or of u behind a gap of a width in rad, and of u that jumps between two values.
    """
    h = 1e-3
    time = h * np.arange(round(seconds / h))
    tilt, bend = np.zeros((2, len(time)))
    for size, w in ((0.03, 1.1), (0.02, 2.7), (0.02, 4.9)):
        tilt += size * np.cos(w * time)
        bend -= size * w**2 * np.cos(w * time)
    if steps:
        tilt = 0.03 * np.sign(tilt)
    plate, behind = 0.0, np.zeros_like(tilt)
    for k, each in enumerate(tilt.tolist()):
        behind[k] = plate = min(max(plate, each - play / 2), each + play / 2)
    push = 6.0 * (behind - lever / 9.81 * bend)
    x, v, places = 0.0, 0.0, np.empty_like(time)
    for k, each in enumerate(push):
        v += h * (each - friction * np.sign(v))
        x += h * v
        places[k] = x
    seen = slice(None, None, 10)
    return AxisLog(time[seen], tilt[seen], bool(play), time[seen], places[seen])


def test_no_negative_friction_is_believed():
    """A log with it is that of no rig: the others are then what they are without friction."""
    log = exact_motion(-0.02)
    (grid,) = make_grids(log, (0.4,))
    windows = WeakWindows.of(grid, rolling=True)
    bounded, without = (
        windows.solve(terms, Linkage()) for terms in (("friction", "camber"), ("camber",))
    )
    assert bounded.values[2] == 0.0
    assert np.delete(bounded.values, 2) == pytest.approx(without.values, abs=1e-12)
    assert bounded.explained == without.explained
    assert bounded.stds[2] > 0
    positive = WeakWindows.of(make_grids(exact_motion(0.02), (0.4,))[0], rolling=True)
    assert positive.solve(("friction", "camber"), Linkage()).values[2] == pytest.approx(
        0.02, abs=2e-3
    )


def test_looks_are_compared_at_the_same_windows():
    """A window that only one look explains is evidence for it, not an outlier of both."""
    rng = np.random.default_rng(0)
    first = look_at_any_motion(exact_motion(0.02), TriedLinkages())[0]
    residuals = rng.standard_normal(100)
    every = np.ones(100, bool)
    some = np.arange(100) < 80
    one = replace(first, windows=25, residuals=residuals, kept=every)
    other = replace(first, windows=20, residuals=np.where(some, residuals, 30.0), kept=some)
    misfits = find_misfits((one, None, other))
    assert misfits[1] == np.inf
    assert misfits[0] == pytest.approx(25 * np.log((residuals**2).mean()))
    assert misfits[2] == pytest.approx(25 * np.log((other.residuals**2).mean()))
    # an outlier of both counts for none
    both = find_misfits((replace(one, windows=20, kept=some), other))
    assert both == pytest.approx(np.full(2, 20 * np.log((residuals[some] ** 2).mean())))


@pytest.mark.parametrize("look", [look_at_any_motion, look_at_rolling_in_several_ways])
def test_the_best_look_has_a_lever_only_where_the_log_shows_it(look):
    tried = TriedLinkages((-0.08, 0.0, 0.155))
    with_lever = look(exact_motion(0.02, 0.155), tried)
    assert with_lever[0].gain == pytest.approx(6.0, rel=0.02)
    assert look(exact_motion(0.02), tried)[0].gain == pytest.approx(6.0, rel=0.02)


PLAYS = (0.0, 0.1, 0.3, 0.5)


@pytest.mark.parametrize("look", [look_at_any_motion, look_at_rolling_in_several_ways])
def test_the_best_look_has_the_play_that_the_log_shows(look):
    """The gap is 0.2 swings to each side, between two of those tried next to it."""
    swing = float(np.std(exact_motion(0.02).tilt))
    log = exact_motion(0.02, play=2 * 0.2 * swing)
    (without, *_), looks = (look(log, TriedLinkages((0.0,), each)) for each in ((0.0,), (0, 0.2)))
    assert abs(without.gain - 6.0) > 3 * abs(looks[0].gain - 6.0)
    assert looks[0].gain == pytest.approx(6.0, rel=0.02)
    assert looks[0].linkage.play == 0.2
    several = join_looks(look(log, TriedLinkages((0.0,), PLAYS)))
    low, high = several.interval("gain")
    assert low < 6.0 < high
    tried = {each.linkage.play for each in several.variants}
    assert {0.1, 0.3} <= tried
    assert 0.5 not in tried


def test_a_command_of_two_values_leaves_the_play_open_and_the_gain_with_it():
    """A gap takes the same from every step, so that no position tells it from a smaller gain."""
    log = exact_motion(0.02, play=0.006, steps=True)
    looks = look_at_any_motion(log, TriedLinkages((0.0,), PLAYS))
    assert looks[0].gain == pytest.approx(0.9 * 6.0, rel=0.02)
    low, high = join_looks(looks).interval("gain")
    assert low < 0.9 * 6.0
    assert high > 0.9 * 6.0 / 0.6
    assert PLAIN_PARAMETERS["play"].tried == find_possible_linkages(log).plays
    assert find_possible_linkages(replace(log, held=False)).plays == (0.0,)


def test_levers_and_plays_are_sought_together(monkeypatch, log):
    """Along a valley aslant, in which neither lever nor play alone leads to the least misfit."""
    tried = find_possible_linkages(log)
    windows = WeakWindows.of(make_grids(log, (0.4,))[0], rolling=True)

    def misfit(each):
        lever, play = each.lever / 0.2, each.play / 0.4
        return 60 * (lever + play - 1.0) ** 2 + 12 * (play - 1.0) ** 2

    monkeypatch.setattr(first_look, "_look_at", lambda _, __, linkage: linkage)
    monkeypatch.setattr(
        first_look, "find_misfits", lambda looks: np.array([misfit(each) for each in looks])
    )
    every = [Linkage(lever, play) for lever in tried.levers for play in tried.plays]
    good = {each for each in every if misfit(each) < min(map(misfit, every)) + 3.84}
    assert Linkage(0.0, 0.4) in good
    assert not {each.lever for each in good if each.play > 0} <= {0.0}
    found = look_with_linkages(windows, tried)
    assert misfit(found[0]) == min(map(misfit, every))
    assert good < set(found)
    assert len(found) < len(every) / 4


def test_a_play_that_takes_most_of_the_motion_is_found():
    """The gap is 0.7 swings to each side; up to half a swing the gain is too small."""
    swing = float(np.std(exact_motion(0.02).tilt))
    log = exact_motion(0.02, play=2 * 0.7 * swing)
    windows = WeakWindows.of(make_grids(log, (0.9,))[0], rolling=False)
    plays = find_possible_linkages(log).plays
    found = join_looks(look_with_linkages(windows, TriedLinkages((0.0,), plays)))
    low, high = found.interval("gain")
    assert low < 6.0 < high
    small = [each for each in plays if each <= 0.5]
    least = join_looks(look_with_linkages(windows, TriedLinkages((0.0,), small)))
    assert least.interval("gain")[1] < 6.0


def test_a_damping_is_part_of_what_a_rolling_ball_leaves_open():
    """Friction and camber take up a damping of 0.6 1/s as a delay that is too small."""
    rig = Rig(seconds=24.0, viscous=0.6, friction=0.02)
    time, sampled, ball, command, _ = simulate_log(3, rig)
    log = AxisLog(time, command, True, sampled, ball)
    looks = look_at_rolling_in_several_ways(log, TriedLinkages())
    undamped = [each for each in looks if "damping" not in each.terms]
    truth = {"delay": rig.dead_time + rig.lag, "friction": rig.friction}
    for name, value in truth.items():
        low, high = join_looks(looks).interval(name)
        assert low < value < high
    low, high = join_looks(undamped).interval("delay")
    assert not low < truth["delay"] < high


def test_no_negative_damping_is_believed():
    time, ball, sent = linear_motion(6.0, -0.8, 0.15)
    log = AxisLog(time, sent, False, time, ball)
    looks = look_linearly(WeakWindows.of(make_grids(log, (0.9,))[0], rolling=False))
    rolling = look_at_rolling_in_several_ways(log, TriedLinkages())
    assert looks
    assert rolling
    assert all(each.damping == 0 for each in (*looks, *rolling))


def test_a_ball_that_turns_at_the_same_places_is_at_no_end_stop():
    time = np.arange(0.0, 30.0, 0.02)
    slow, fast = 0.04 * np.sin(2.0 * time), 0.03 * np.sin(6.0 * time)
    ball = -6.0 * (slow / 2.0**2 + fast / 6.0**2)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(time))
    found = look_first(AxisLog(time, slow + fast, False, time, ball + noise))
    assert found.at_ends == 0.0
    assert found.gain == pytest.approx(6.0, rel=0.05)


@pytest.mark.parametrize("kind", ["still", "noisy", "short", "another command"])
def test_a_first_look_says_nothing_of_a_log_that_shows_nothing(log, kind):
    rng = np.random.default_rng(1)
    ball, tilt, some = log.ball, log.tilt, slice(None)
    if kind == "still":
        ball = 1e-4 * rng.standard_normal(len(ball))
    if kind == "noisy":
        ball = ball + 0.06 * rng.standard_normal(len(ball))
    if kind == "short":
        some = slice(30)
    if kind == "another command":
        tilt = 0.05 * rng.standard_normal(len(tilt))
    assert look_first(AxisLog(log.time, tilt, True, log.sampled[some], ball[some])) is None


def test_identify_says_what_it_does_and_a_first_look_before_it_fits(log):
    said, unmoved = [], replace(log, tilt=0 * log.tilt)
    with pytest.raises(LogError, match="this axis does not move"):
        identify_axes([AnyLog("rig.csv", {"x": unmoved}, {"x": "rad"}, ())], 0.3, say=said.append)
    assert len(said) == 1
    assert said[0].startswith("rig.csv: fitting 17 s along x: about ")
    brief = replace(log.between(0.0, 12.0), time=log.time)
    found = identify_axes(
        [AnyLog("rig.csv", {"x": brief}, {"x": "rad"}, ())],
        0.0,
        say=said.append,
        selection=replace(AXIS_SELECTION, window_s=40.0, min_windows=0),
    )
    assert said[2].startswith("first look, x: gain ")
    assert not any("first fits" in line for line in said)
    # the windows of the full model are refused: the plain one answers
    assert any("stretches" in note for note in found.notes)
    told = {each.name: each for each in found.verdicts}
    assert told["gain_x"].low < TRUTH["gain"] < told["gain_x"].high
    assert told["gain_x"].why == PLAIN_WHY
    assert told["delay_x"].value == pytest.approx(TRUTH["dead_time"] + TRUTH["lag"], abs=0.02)
    assert told["friction_x"].low < TRUTH["friction"] < told["friction_x"].high
    assert told["lag_x"].value is None
    assert found.scores == ()


def test_the_stated_time_is_that_of_what_the_first_fits_leave_to_do(log, fit):
    wave = 1.5 * np.sin(np.arange(fit.found.linearisation.r.shape[-1]) / 8.0)
    line = fit.found.linearisation
    bent = replace(fit, found=fit.found._replace(linearisation=line._replace(r=line.r + wave)))
    logs, said = {"x": log, "y": log.between(0.0, 10.0)}, []
    for usual in ({"x": fit, "y": fit}, {"x": fit, "y": bent}, {"x": bent, "y": bent}, {}):
        _tell_rest(logs, usual, said.append)
    assert said[0].startswith("the first fits explain the log: about ")
    assert said[1].startswith("the first fits do not explain y: more models are tried: about ")
    assert "do not explain x and y" in said[2]
    least, some, most = (int(re.search(r"(\d+) s of processor time in all", e)[1]) for e in said)
    assert 0 < least < some < most
    first = _describe_work(logs, "rig.csv")
    assert first.startswith("rig.csv: fitting 25 s along x and y: ")
    assert f"about {least} s of processor time if the model explains the log" in first
    assert first.endswith(f"else about {most} s")


def test_residuals_of_the_true_model_are_white_and_those_of_another_are_not(fit):
    assert fit.explained
    line = fit.found.linearisation
    wave = 1.5 * np.sin(np.arange(line.r.shape[-1]) / 8.0)
    moved = fit.found._replace(linearisation=line._replace(r=line.r + wave))
    assert not replace(fit, found=moved).explained


def test_a_bracket_of_a_profile_gives_the_draws_of_the_whole_profile(fit):
    values = [0.0, 0.02, 0.04, 0.08, 0.2, 0.4]
    whole, part = profile(fit, "dead_band", values), profile_contenders(fit, "dead_band", values)
    assert len(part.theta) < len(whole.theta)
    for name in ("gain", "dead_band"):
        ends = (np.quantile(each.deviations[name], (0.05, 0.95)) for each in (whole, part))
        low, high = zip(*ends, strict=True)
        assert low[0] == pytest.approx(low[1], abs=0.02 * abs(fit.value("gain")))
        assert high[0] == pytest.approx(high[1], abs=0.02 * abs(fit.value("gain")))


@pytest.mark.long
def test_a_parameter_that_acts_is_significant_and_one_that_does_not_is_not(axis_log, log, fit):
    assert find_significance(fit, "camber") < 3.5
    bent = axis_log(3, seconds=25, rate=60.0, pixel=0.0, camber=0.8, **TRUTH)
    other = AxisLog(bent[0], bent[2], True, bent[0], bent[1])
    names = ("gain", "dead_time", "lag", "level", "friction")
    cambered = fit.refit(other, names, 2.5)
    assert find_significance(cambered, "camber") > 10


@pytest.mark.long
def test_intervals_include_what_a_term_that_is_left_out_would_change(axis_log):
    """The next step of a fit by one term more is what a fit with that term finds."""
    bent = axis_log(3, seconds=25, rate=60.0, pixel=0.0, camber=0.1, **TRUTH)
    log = AxisLog(bent[0], bent[2], True, bent[0], bent[1])
    names = ("gain", "dead_time", "lag", "level", "friction")
    without = fit_axis(log, names, 2.5, (0.0, 0.5))
    changes, _ = find_term(without, "camber")
    within = without.refit(log, (*names, "camber"), 2.5)
    assert changes[-1] == pytest.approx(0.1, abs=0.02)
    moved = within.value("gain") - without.value("gain")
    assert changes[0] == pytest.approx(moved, rel=0.3)
    # a fit that is at no minimum, as one to predictions, is not moved to one
    theta = without.found.theta * np.where(np.array(names) == "gain", 1.1, 1.0)
    elsewhere = replace(without, found=without.found._replace(theta=theta))
    assert find_term(elsewhere, "camber")[0][0] == pytest.approx(changes[0], rel=0.3)
    told = {each.name: each for each in assess_axis(without, "x", "rad")}
    scale, half = without.problem.tilt.scale, without.estimate().half_width[0]
    ends = (without.value("gain") + np.array([min(changes[0], 0), max(changes[0], 0)])) / scale
    assert told["gain_x"].low <= ends[0] - half / scale
    assert told["gain_x"].high >= ends[1] + half / scale
    cheaper = replace(AXIS_SELECTION, optional_parameters=())
    plain = {each.name: each for each in assess_axis(without, "x", "rad", cheaper)}
    assert plain["gain_x"].high - plain["gain_x"].low < told["gain_x"].high - told["gain_x"].low


def test_candidates_that_have_converged_are_left_and_the_best_is_the_same(fit):
    theta = fit.found.theta * np.array([[1.0], [1.3], [0.7]])
    starts = fit_starts_from_scratch(fit.problem, theta, 3)
    whole, part = (
        minimise(fit.problem, theta, starts, 40, control=StepControl(drops_idle=each))
        for each in (False, True)
    )
    assert part.cost.min() == pytest.approx(whole.cost.min(), rel=1e-3)
    assert part.termination.reason == "converged"
    assert AXIS_FITTING.search.control.drops_idle
