"""`twin.identify.prepare`: What a fit is made of: servo, replay, intervals and verdicts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import lsq_linear
from scipy.signal import butter, lfilter

from controllers.ballplate import BallPlate
from twin.base.errors import LogError
from twin.identify.intervals import Estimate, estimate
from twin.identify.least_squares import Fit, Linearisation, _step_within, fit_starts
from twin.identify.parameters import SERVO_PARAMETER
from twin.identify.plate_motion import Drives, check_motion, fit_drives, servo_response
from twin.identify.prepare import SPEED_INTERVAL_S, PreparedLog, Segment, paces, rests, speed
from twin.identify.report import parameters, sentences
from twin.identify.twin_fit import TwinProblem, _find_creeping
from twin.identify.twin_model import TwinIdentification
from twin.identify.twin_verdicts import _assess_ball, _assess_servo, whiteness
from twin.identify.verdicts import BOUNDED_VERDICT, IDENTIFIED_VERDICT, REJECTED_VERDICT
from twin.identify.windows import (
    MAP_SPACING_M,
    REPLAY_STEP_S,
    AccelerationField,
    Patches,
    Windows,
    replay,
)
from twin.scenario import load
from twin.sim.drives import Hysteresis, Play, Resonance
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction


def told(name, value, spread, moved=0.0, *, rejected=False):
    """What is said of a parameter of the ball of which a fit has such a value and draws of it."""
    problem = SimpleNamespace(names=(name,), windows=SimpleNamespace(resting=np.array([True])))
    draws = value + spread * np.random.default_rng(1).standard_normal((400, 1))
    found = Estimate(np.array([value]), draws, np.array([True]), 20)
    fit = SimpleNamespace(problem=problem)
    return _assess_ball(name, fit, found, np.array([moved]), rejected=rejected)


def paused(rows, creep=0.0):
    """Times, and a ball that goes but from 3 to 4 s, where it creeps, as a screen sees it."""
    time = 0.002 * np.arange(rows)
    x = 0.06 * (np.minimum(time, 3.0) + np.maximum(time - 4.0, 0.0))
    x = x + creep * np.clip(time - 3.0, 0.0, 1.0)
    noise = np.random.default_rng(2).standard_normal((rows, 2))
    return time, np.stack((x, np.zeros_like(x)), axis=-1) + 3e-4 * noise


@pytest.mark.parametrize(("lag", "word"), [(1.5e-4, BOUNDED_VERDICT), (6.0e-4, IDENTIFIED_VERDICT)])
def test_drives_faster_than_a_scenario_takes_are_bounded(lag, word):
    verdict = _assess_servo(Drives(lag, 2e-5, play=0.0))
    assert verdict.word == word
    if verdict.value is not None:
        load("circle", [f"plant.servo.bandwidth_hz={verdict.value}"])


LAG = 0.0159
"""Of a servo of 10 Hz, s."""


def driven(*parts, rows=7500):
    """A log of drives of a lag of LAG behind which there are parts, as encoders count."""
    rng, period = np.random.default_rng(1), 0.002
    b, a = butter(2, 4.0, fs=1 / period)
    command = lfilter(b, a, rng.normal(0, 0.4, (rows, 2)), axis=0)
    # the servo solved in steps of its own, not as the fit does
    turns, many = np.zeros_like(command), 20
    share = period / many / LAG
    rate = lfilter([share], [1, share - 1], np.repeat(command[:-1], many, axis=0), axis=0)
    turns[1:] = period * rate.reshape(-1, many, 2).mean(axis=1)
    for part in parts:
        turns = np.concatenate([part.follow(turn[None]) for turn in turns])
    count = 2 * np.pi / 245760
    plate = np.rint(np.cumsum(turns, axis=0) / count) * count
    time = period * np.arange(len(plate))
    segment = Segment(time, plate, command, time, np.zeros_like(plate))
    return PreparedLog(
        source="drives", segments=(segment,), sigma=np.ones(2), model=BallPlate(), own_lag=0.0,
        grips=(0.0,),
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("width", [0.0, 0.05, 0.3])
def test_a_lag_is_told_from_play_of_any_width(width):
    parts = [Play(np.radians([[width]]))] if width else []
    found = fit_drives(driven(*parts))
    assert found.lag == pytest.approx(LAG, abs=max(found.half_width, 2e-4))
    assert found.half_width < 0.02 * LAG
    assert np.degrees(found.play) == pytest.approx(width, abs=0.002)


@pytest.mark.long
@pytest.mark.parametrize("resonance", [12.5, 19.0])
def test_the_lag_of_a_plate_that_swings_on_its_drive_train_is_right(resonance):
    part = Resonance(np.array([[resonance]]), np.array([[0.05]]), 0.002)
    found = fit_drives(driven(part, rows=15_000))
    assert found.lag == pytest.approx(LAG, abs=max(found.half_width, SERVO_PARAMETER.floor))
    assert found.half_width < 0.1 * LAG


@pytest.mark.long
def test_of_drives_of_another_kind_the_interval_of_the_lag_is_wide_and_holds_the_truth():
    found = fit_drives(driven(Hysteresis(np.radians([[0.3]]))))
    assert found.lag == pytest.approx(LAG, abs=found.half_width)
    assert _assess_servo(found).word != IDENTIFIED_VERDICT


def stroked(slopes, signs=(1, 1), strokes=8):
    """A log of strokes from side to side, with rests, on a screen of such slopes along x and y.

    The way of each, and the tilt that makes it against friction and slope, are in closed form.
    """
    model, period, lasts, pause, dead_time = BallPlate(), 0.005, 2.4, 0.3, 0.04
    part = np.arange(0, lasts, period)[:, None] / lasts
    ends = np.array((0.08, 0.05))
    way = ends * (part**3 * (10 - 15 * part + 6 * part**2) - 0.5)
    push = ends * (60 * part - 180 * part**2 + 120 * part**3) / lasts**2
    friction = 0.1 * ends / np.hypot(*ends)
    rest, places, tilts = np.ones((round(pause / period), 1)), [], []
    for side in (1, -1) * (strokes // 2):
        places += [side * way, side * way[-1] * rest]
        tilts += [side * (push + friction), side * friction * rest]
    tilt = np.arcsin((np.concatenate(tilts) + model.k1 * np.sin(np.radians(slopes))) / model.k1)
    ball = np.concatenate(places) - model.c2 * tilt
    ball += 5e-5 * np.random.default_rng(3).standard_normal(ball.shape)
    time = period * np.arange(len(ball))
    segment = Segment(time, tilt * (1, -1) * signs, None, time + dead_time, ball)
    return PreparedLog(
        source="strokes", segments=(segment,), sigma=np.full(2, 5e-5), model=model, own_lag=0.0,
        grips=(0.0,),
    )  # fmt: skip


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.4, -0.6), (-0.8, 0.8)])
def test_a_ball_that_its_tilt_holds_against_friction_and_slope_is_not_called_wrong(slopes):
    check_motion(stroked(slopes))


@pytest.mark.parametrize(
    ("signs", "says"),
    [
        ((-1, 1), "measured_x accelerates -[0-9.]+ times as much as measured_phi"),
        ((1, -1), "measured_y accelerates -[0-9.]+ times as much as measured_theta"),
        ((1, 10), "measured_y accelerates [0-9.]+ times as much as measured_theta"),
    ],
)
def test_a_wrong_sign_or_unit_is_found_on_a_slope_too(signs, says):
    with pytest.raises(LogError, match=says):
        check_motion(stroked((0.4, -0.6), signs))


def test_an_interval_holds_what_unexplained_motion_may_have_moved_its_parameter_by():
    plain, wide = (told("rolling", 2e-4, 1e-6, moved) for moved in (0.0, 6e-6))
    assert (plain.word, wide.word) == (IDENTIFIED_VERDICT, IDENTIFIED_VERDICT)
    assert wide.high - wide.low > 2 * 6e-3  # mm
    ratio = told("breakaway", 1.6, 0.05, 0.7)  # the truth is 1
    assert ratio.word != IDENTIFIED_VERDICT
    assert ratio.low <= 1.0


@pytest.mark.parametrize("size", [0.02, 0.1, 0.25])
def test_motion_that_is_unexplained_moves_a_fit_by_no_more_than_is_claimed_and_at_worst_by_it(size):
    rng = np.random.default_rng(7)
    J = rng.normal(size=(20, 100, 2)) @ np.array([[1.0, 0.6], [0.0, 2e-3]])
    every, information = J.reshape(-1, 2), np.einsum("wmi,wmj->ij", J, J)
    line = SimpleNamespace(
        r=np.zeros((1, 20, 100)),
        eliminate_starts=lambda: (np.concatenate((np.zeros((20, 100, 1)), J), -1)[None], None),
    )
    problem = SimpleNamespace(
        windows=SimpleNamespace(size=np.full(20, 100)),
        weights=lambda r: np.ones(r.shape[:2]),
        known=(np.zeros(2), np.zeros(2)),
    )
    claimed = Fit(problem, SimpleNamespace(linearisation=line)).bound_bias(size)
    worst = np.zeros(2)
    for k in range(2):
        alike = every @ np.linalg.inv(information)[:, k]  # looks like a change of this parameter
        for shape in (alike, *rng.normal(size=(30, 2000))):
            motion = np.sqrt(size * 2000) * shape / np.linalg.norm(shape)
            worst = np.maximum(worst, np.abs(np.linalg.solve(information, every.T @ motion)))
    assert claimed == pytest.approx(worst, rel=1e-6)


@pytest.mark.parametrize(
    ("correlated", "swing", "white", "rejected"),
    [
        (0.0, 0.0, True, False),
        (0.5, 0.0, False, True),
        (0.0, 0.35, True, False),
        (0.0, 0.5, False, False),
        (0.0, 1.0, False, True),
    ],
)
def test_a_model_is_rejected_by_how_much_moves_together_in_its_residuals_and_not_by_a_trace_of_it(
    correlated, swing, white, rejected
):
    rng, windows, bins = np.random.default_rng(4), 25, 60
    t = np.linspace(0, 1, bins)
    slope = np.zeros((bins, 2, 4))
    for axis in (0, 1):
        slope[:, axis, axis], slope[:, axis, axis + 2] = 1e4, 1e4 * t
    Z = slope.reshape(-1, 4)
    r = rng.normal(size=(windows, bins, 2))
    r = r + correlated * np.roll(r, 1, axis=1)
    phase = rng.uniform(0, 2 * np.pi, (windows, 1, 2))
    r = r + swing * np.sin(2 * np.pi * np.arange(bins)[:, None] / 20 + phase)
    r = r.reshape(windows, -1)
    r = r - r @ Z @ np.linalg.solve(Z.T @ Z, Z.T)
    by_start = np.broadcast_to(Z, (1, windows, *Z.shape))
    line = Linearisation(r[None], by_start, np.zeros((1, *r.shape, 0)))
    seen = SimpleNamespace(weight=np.ones((windows, bins, 2)), axes=2)
    problem = SimpleNamespace(windows=seen, misfit=lambda r: (r**2).mean(axis=-1))
    fit = SimpleNamespace(problem=problem, found=SimpleNamespace(linearisation=line))
    found = whiteness(fit)
    assert found.white == white
    assert found.rejected == rejected
    assert not white or found.unexplained == 0
    assert white or found.unexplained >= 0.9 * swing**2 / 2 / (1 + swing**2 / 2)
    if swing:
        assert found.outside > 3  # either is seen


def test_windows_that_no_replay_explains_do_not_pull_the_fit_to_where_it_explains_none():
    # misfits of the windows of a log of 40 s: of the truth, and of what the windows pulled it to
    truth = [1.1, 1.1, 93.9, 1.1, 1, 1, 195.6, 78, 1.1, 1.2, 1.3, 1, 0.9, 1, 76.6, 1.1, 1]
    pulled = [1.6, 2.3, 42, 1.4, 1.7, 1.3, 1.4, 14.4, 1.1, 3.9, 1.9, 11, 0.9, 1.9, 53, 1.3, 1.3]
    seen = SimpleNamespace(size=np.full(17, 300))
    problem = TwinProblem(seen, (), BallPlate())
    each = [problem.cost(np.sqrt(300 * np.array(m))[None, :, None])[0] for m in (truth, pulled)]
    assert each[0] < each[1]
    # the weight is the slope of the cost, as steps of least squares take it
    r = np.sqrt(300 * np.linspace(0.5, 9, 17))[None, :, None]
    rise = (problem.cost(r * (1 + 1e-6)) - problem.cost(r))[0] / 2e-6
    assert rise == pytest.approx((problem.weights(r) * r[..., 0] ** 2).sum(), rel=1e-4)


@pytest.mark.long
def test_a_window_in_which_the_ball_creeps_at_first_is_told_from_one_in_which_it_rests():
    model, names = BallPlate(), ("rolling", "breakaway", "delay", "level_phi", "level_theta")
    rng, bins = np.random.default_rng(3), 60
    holds = 2e-4 / model.radius  # the tilt at which a ball that rolls goes on
    tilt = np.zeros((2, round(1.2 / REPLAY_STEP_S), 2))
    tilt[..., 1] = -1.02 * holds
    seen = np.tile(0.15 + 0.016 * np.arange(bins), (2, 1))
    windows = Windows(
        np.array([0.0, 2.0]), seen, np.zeros((2, bins, 2)), np.full((2, bins, 2), 1 / 2e-4),
        np.array([True, True]), np.zeros((2, 200)),
        AccelerationField.of(model, tilt, np.zeros_like(tilt)),
    )  # fmt: skip
    problem = TwinProblem(windows, names, model)
    theta, starts = np.array([[2e-4, 1.1, 0.04, 0.0, 0.0]]), np.zeros((4, 1, 2))
    starts[3, 0, 1] = 0.008 * np.sign(windows.field.push[0, 1, 0, 1])
    ball = windows.at_samples(*problem.replay(theta, starts), np.full((1, 1), 0.04))[0][0]
    assert np.ptp(ball, axis=1)[:, 1] == pytest.approx([0.0, 0.008], abs=0.002)
    ball = ball + 2e-4 * rng.standard_normal(ball.shape)
    problem = replace(problem, windows=replace(windows, ball=ball))
    rested = fit_starts(problem, theta, problem.initial_starts(), 8)
    assert _find_creeping(problem, theta, rested).tolist() == [False, True]


def test_windows_that_agree_by_chance_give_no_interval_narrower_than_noise_does():
    information = np.full((10, 1, 1), 4.0)
    score = 1e-3 * np.random.default_rng(1).standard_normal((10, 1))
    known = estimate(np.array([1.0]), information, score, np.array([[40.0]]))
    assert known.half_width[0] == pytest.approx(1.96 / np.sqrt(40), rel=1e-3)
    assert estimate(np.array([1.0]), information, score).half_width[0] < 1e-3


def test_an_interval_that_two_of_many_windows_decide_knows_of_two():
    score = np.random.default_rng(1).standard_normal((12, 1))
    equal, few = (
        estimate(np.array([1.0]), part[:, None, None], score).degrees_of_freedom[0]
        for part in (np.ones(12), np.array([100.0, 100.0, *np.ones(10)]))
    )
    assert equal == pytest.approx(11)
    assert few == pytest.approx(2.2, abs=0.05)


def test_of_a_model_that_the_log_rejects_there_is_no_interval():
    good, bad = (told("rolling", 2e-4, 1e-6, rejected=each) for each in (False, True))
    assert (good.word, bad.word) == (IDENTIFIED_VERDICT, REJECTED_VERDICT)
    assert bad.value == good.value == pytest.approx(0.2)
    assert good.low < 0.2 < good.high
    assert (bad.low, bad.high) == (None, None)
    found = TwinIdentification(
        source="log", seconds=0.0, verdicts=(bad,), scores=(), predictions={}, notes=(),
        extent="", remarks=(), log=None, fit=None, whiteness=None,
    )  # fmt: skip
    words = sentences(found)
    assert words[-1].startswith("Best fit only, as the log rejects the model")
    assert words[0].startswith("Nothing was held out")  # what it predicts comes first
    assert "rolling" not in parameters(found)
    assert "rolling_mm = 0.2" in parameters(found, (REJECTED_VERDICT,))


@pytest.mark.parametrize("seed", range(20))
def test_a_step_that_meets_a_bound_is_the_best_within_it(seed):
    rng = np.random.default_rng(seed)
    root, target = rng.normal(size=(6, 4)), rng.normal(size=6)
    normal, slope = root.T @ root, -root.T @ target
    free = np.linalg.lstsq(root, target)[0]
    least, most = np.full(4, -10.0), np.full(4, 10.0)
    k = rng.integers(4)
    (most if free[k] > 0 else least)[k] = free[k] / 3
    found = _step_within(normal[None], slope[None], least[None], most[None])[0]
    best = lsq_linear(root, target, (least, most), tol=1e-14).x
    assert found == pytest.approx(best, abs=1e-7)
    assert found[k] == pytest.approx(free[k] / 3)
    assert np.abs(np.delete(found - free, k)).max() > 1e-3


def test_a_servo_solves_its_first_order_equation():
    period, lag, parts = 0.002, 0.02, 2000
    command = np.random.default_rng(0).normal(0, 0.2, (50, 1))
    angle, speed = servo_response(command, period, lag)
    truth, step = np.zeros(2), period / parts
    for k in range(50):
        assert angle[k, 0] == pytest.approx(truth[0], abs=1e-7)
        assert speed[k, 0] == pytest.approx(truth[1], abs=1e-5)
        for _ in range(parts):
            truth = truth + step * np.array([truth[1], (command[k, 0] - truth[1]) / lag])


@pytest.mark.long
def test_a_replay_rolls_as_the_exact_plant_does():
    model, friction = BallPlate(), Friction(rolling=2e-4, breakaway_ratio=1.5)
    plant = ExactPlant(model, rigs=1, step=0.001, friction=friction)
    plant.start(np.array([[0.02, 0.0, -0.03, 0.0]]))
    states, rng = [plant.state.copy()], np.random.default_rng(3)
    swing = rng.uniform(0.5, 1.5, 2)
    for k in range(500):
        t = 0.004 * (k + 1)
        plant.advance(np.array([[0.05 * np.sin(swing[0] * t), 0.04 * np.sin(swing[1] * t)]]), 4)
        states.append(plant.state.copy())
    states = np.array(states)[:, 0]
    field = AccelerationField.of(model, states[None, :, 2::4], states[None, :, 3::4])
    start = states[0, [0, 4, 1, 5]][:, None, None]
    places, _ = replay(field, model, friction, np.zeros((2, 1, 1)), start)
    assert REPLAY_STEP_S == 0.004
    way = np.abs(np.diff(states[:, 0::4], axis=0)).sum()
    assert way > 0.1
    assert np.abs(places[:, :, 0, 0] - states[:, 0::4]).max() < 0.005 * way


def test_a_replay_from_rest_goes_on_as_one_that_has_seen_the_ball_come_to_rest():
    model = BallPlate()
    friction = Friction(rolling=2e-4, breakaway_ratio=2.0, dwell_time=1.0, stribeck_speed=0.005)
    time = REPLAY_STEP_S * np.arange(1000)
    holds = friction.rolling / model.radius  # the tilt that a rolling ball just goes on at
    # rolls out, rests, and is tilted away: the longer it has rested, the later it goes
    tilt = holds * np.clip(2.0 * (time - 1.2), 0.0, 2.5)
    angle = np.stack((np.zeros_like(tilt), -tilt), axis=-1)[None]
    rate = np.gradient(angle, REPLAY_STEP_S, axis=1)
    field = AccelerationField.of(model, angle, rate)
    start = np.array([0.0, 0.0, 0.05, 0.0])[:, None, None]
    level = np.zeros((2, 1, 1))
    places, speeds = replay(field, model, friction, level, start)
    speed = np.hypot(*speeds[:, :, 0, 0].T)
    at = round(1.4 / REPLAY_STEP_S)
    assert speed[:10].min() > 0.04
    assert speed[round(1.25 / REPLAY_STEP_S) : at + 1].max() == 0
    assert speed[-1] > 0.01
    rest = AccelerationField.of(model, angle[:, at:], rate[:, at:])
    begun = np.concatenate((places[at], speeds[at]))
    paces = np.interp(1.4 - SPEED_INTERVAL_S * np.arange(200, 0, -1), time, speed)[None]
    told, untold = (
        replay(rest, model, friction, level, begun, paces=each)[0][:, :, 0, 0]
        for each in (paces, None)
    )
    way = np.hypot(*(places[-1] - places[at])[:, 0, 0])
    assert np.abs(told - places[at:, :, 0, 0]).max() < 0.02 * way
    assert np.abs(untold - places[at:, :, 0, 0]).max() > 0.1 * way


ROLLING_M, STRIBECK_M_S = 2.4e-4, 0.02


def slowing(model):
    """Times in s and a field in which a ball of 0.06 m/s along x slows to 0.015 and goes on."""
    time = REPLAY_STEP_S * np.arange(400)
    tilt = 0.009 + 0.04 * np.clip(time - 0.95, 0.0, 0.6)
    angle = np.stack((tilt, np.zeros_like(tilt)), axis=-1)[None]
    return time, AccelerationField.of(model, angle, np.gradient(angle, REPLAY_STEP_S, axis=1))


def replays(dwells, paces=None):
    """Speeds along x in m/s of candidates with dwell times in s, replayed together, (N, C)."""
    model, dwell = BallPlate(), np.array(dwells, float)[:, None]
    friction = Friction(
        rolling=np.full_like(dwell, ROLLING_M),
        breakaway_ratio=np.full_like(dwell, 2.0),
        stribeck_speed=np.full_like(dwell, STRIBECK_M_S),
        dwell_time=dwell,
    )
    start = np.array([0.0, 0.0, 0.06, 0.0])[:, None, None].repeat(len(dwell), axis=1)
    level = np.zeros((2, len(dwell), 1))
    return replay(slowing(model)[1], model, friction, level, start, paces=paces)[1][:, 0, :, 0]


@pytest.mark.parametrize("paces", [None, np.full((1, 5), 0.01)])
def test_a_replay_does_not_depend_on_the_candidates_beside_it(paces):
    alone, beside = replays([0.0], paces)[:, 0], replays([0.0, 0.3], paces)
    assert np.abs(beside[:, 0] - alone).max() < 1e-12
    assert np.abs(beside[:, 1] - alone).max() > 1e-3


def test_a_replay_of_hardly_any_dwell_is_that_of_none():
    none, hardly = replays([0.0, 1e-7]).T
    assert np.abs(none - hardly).max() < 1e-8


@pytest.mark.parametrize("dwell", [0.0, 0.02, 0.3])
def test_an_ageing_contact_slows_a_ball_as_its_equations_say(dwell):
    model = BallPlate()
    time, field = slowing(model)
    push, own, normal = field.push[:, 0, 0, 0], field.own[:, 0, 0, 0], field.normal[:, 0, 0]

    def slope(t, state):
        place, speed, age = state
        settled = 1 / (1 + (speed / STRIBECK_M_S) ** 2)
        arm = ROLLING_M * (1 + (age if dwell else settled))
        free = np.interp(t, time, push) + np.interp(t, time, own) * place
        slowed = model.c1 * arm / model.radius * np.interp(t, time, normal)
        return speed, free - slowed, (1 - age / settled) / dwell if dwell else 0.0

    begun = [0.0, 0.06, 1 / (1 + (0.06 / STRIBECK_M_S) ** 2)]
    ends = (0.0, time[-1])
    truth = solve_ivp(slope, ends, begun, t_eval=time, rtol=1e-9, atol=1e-12, max_step=0.004)
    found = replays([dwell])[:, 0]
    assert 0.01 < found.min() < 0.03  # Stribeck friction acts
    assert np.abs(found - truth.y[1]).max() < 2e-6


def test_how_a_ball_went_before_a_window_is_measured_but_for_its_rests():
    time, ball = paused(4000)
    segment = Segment(time, np.zeros_like(ball), None, time, ball)
    found = paces(segment, np.array([3.5, 7.0]))
    assert found.shape == (2, 200)
    before = 3.5 - SPEED_INTERVAL_S * np.arange(200, 0, -1)
    assert found[0, before < 2.8] == pytest.approx(0.06, abs=0.01)
    assert (found[0, before > 3.3] == 0.0).all()  # not what noise makes of a rest
    since = 7.0 - SPEED_INTERVAL_S * np.arange(200, 0, -1)
    assert (found[1, (since > 3.3) & (since < 3.7)] == 0.0).all()
    assert found[1, since > 4.2] == pytest.approx(0.06, abs=0.01)


@pytest.mark.parametrize(("creep", "count"), [(0.0, 1), (0.002, 0)])
def test_a_ball_that_creeps_does_not_rest(creep, count):
    time, ball = paused(3000, creep)
    found = rests(time, ball, speed(time, ball))
    assert len(found) == count
    for first, last in found:
        assert 2.9 < first < 3.2
        assert 3.8 < last < 4.1


@pytest.mark.long
def test_bootstrap_intervals_of_a_linear_fit_cover_the_truth_as_often_as_they_say():
    rng, truth, covered = np.random.default_rng(5), np.array([1.0, -2.0]), 0
    for _ in range(200):
        slopes = rng.normal(size=(15, 20, 2))
        noise = rng.normal(size=(15, 20)) * rng.uniform(0.5, 2, (15, 1))
        r, normal = noise, np.einsum("wmi,wmj->wij", slopes, slopes)
        step = np.linalg.solve(normal.sum(axis=0), np.einsum("wmi,wm->i", slopes, r))
        left = r - slopes @ step
        fit = estimate(truth + step, normal, np.einsum("wmi,wm->wi", slopes, left))
        covered += int(abs(fit.value[0] - truth[0]) <= fit.half_width[0])
    assert 180 <= covered <= 199


@pytest.mark.short("False-*")
@pytest.mark.parametrize(("white", "least", "most"), [(False, 0.3, 0.7), (True, 0.85, 1.0)])
def test_white_residuals_give_widths_that_two_logs_agree_in_and_that_hold(white, least, most):
    slopes = np.random.default_rng(7).normal(size=(10, 40, 5))
    slopes *= np.linspace(0.4, 2, 10)[:, None, None]  # windows that show more than others
    normal = np.einsum("wmi,wmj->wij", slopes, slopes)
    total, rng, halves, covered = normal.sum(axis=0), np.random.default_rng(5), [], []
    for _ in range(80):
        noise = rng.normal(size=(10, 40))
        step = np.linalg.solve(total, np.einsum("wmi,wm->i", slopes, noise))
        score = np.einsum("wmi,wm->wi", slopes, noise - slopes @ step)
        fit = estimate(step, normal, score, total, residual=1.0 if white else None)
        halves.append(fit.half_width)
        covered.append(np.abs(step) <= fit.half_width)
    ratios = np.log(np.array(halves[::2]) / halves[1::2])
    assert least < np.mean(np.abs(ratios) < np.log(1.3)) < most
    assert 0.92 < np.mean(covered) < 0.99
    usual = 1.96 * np.sqrt(np.diagonal(np.linalg.inv(total)))  # linear regression, noise known
    assert 0.95 < np.mean(halves / usual) < 1.5


def test_a_dead_time_at_its_bound_is_not_identified():
    found = told("delay", 0.1395, 5e-4)
    assert found.word == BOUNDED_VERDICT
    assert "--columns" in found.why
    assert found.high is None


def test_patches_of_a_screen_are_about_points_and_raise_the_friction_everywhere_together():
    way = np.random.default_rng(2).uniform(-0.1, 0.1, (30, 2))
    spots = Patches.near(way, 0.1)
    many = len(spots.points)
    there = spots(np.broadcast_to(way, (many, 30, 2)))[0]
    assert (there - 1).sum(axis=0) == pytest.approx(np.full(30, 0.1))
    own = spots(np.repeat(spots.points[:, None], 2, axis=1))[0]
    assert own == pytest.approx(np.full((many, 2), 1.1))
    beside = spots(np.repeat(spots.points[:, None], 2, axis=1) + np.array([MAP_SPACING_M, 0.0]))[0]
    assert beside == pytest.approx(np.ones((many, 2)))


def test_unknown_motion_is_left_out_as_generalised_least_squares_does_it():
    rng, samples = np.random.default_rng(6), 12
    line = Linearisation(
        rng.normal(size=(1, 2, samples)), 1e3 * rng.normal(size=(1, 2, samples, 4)),
        rng.normal(size=(1, 2, samples, 3)),
    )  # fmt: skip
    moved = rng.normal(size=(2, samples, 5))
    left, _ = line.without_starts(moved)
    for w in range(2):
        Z, N = line.by_start[0, w], moved[w]
        spread = np.eye(samples) + N @ N.T + Z @ np.linalg.inv(line.prior) @ Z.T
        both = np.concatenate((line.r[0, w, :, None], line.by_parameter[0, w]), axis=-1)
        assert left[w] == pytest.approx(both.T @ np.linalg.inv(spread) @ both, rel=1e-6)
