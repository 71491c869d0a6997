"""`twin.identify.plain_model`: what simulations of windows share, against those that share none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from docs.identify_errors import Rig, simulate_log
from twin.identify.axis_logs import AxisLog, EndStops
from twin.identify.axis_problem import AxisProblem
from twin.identify.command_model import TiltHistory
from twin.identify.least_squares import FitProblem, fit_starts
from twin.identify.plain_model import fit_axis
from twin.identify.windows import axis_windows

NAMES = ("gain", "dead_time", "lag", "level", "friction", "play")
THETA = np.array([[6.0, 0.1, 0.05, 0.03, 0.05, 0.1], [5.0, 0.08, 0.0, 0.0, 0.08, 0.3]])


def problem_of(names=NAMES, stops=None):
    time = np.arange(0.0, 12.0, 0.01)
    tilt = 0.05 * np.sign(np.sin(4 * time)) + 0.02 * np.sin(9 * time)
    ball = 0.02 * np.sin(1.7 * time)
    log = AxisLog(time, tilt, True, time, ball)
    begin = np.arange(1.0, 9.0, 2.0)
    windows = axis_windows(log, begin, begin + 2.0)
    return AxisProblem(windows, names, TiltHistory(log), 2.1, (0.0, 0.5), stops=stops)


def starts_of(problem, candidates=2):
    speeds = np.linspace(-0.06, 0.07, candidates * len(problem.windows))
    each = np.stack((np.full_like(speeds, 0.01), speeds))
    return each.reshape(2, candidates, len(problem.windows))


def test_some_windows_are_simulated_as_all_of_them_are():
    problem = problem_of()
    starts = starts_of(problem)
    every = problem.simulate(THETA, starts)
    which = np.array([False, True, False, True])
    some = problem.take(which)
    assert (some.simulate(THETA, starts[..., which]) == every[..., which]).all()
    other = np.add(THETA, [0.0, 0.0, 0.0, 0.0, 0.0, 0.2])
    found = some.simulate(other, starts[..., which])
    assert (found == problem_of().simulate(other, starts)[..., which]).all()
    assert np.abs(found - every[..., which]).max() > 1e-4


def test_starts_of_the_first_part_are_those_of_a_whole_simulation_with_no_weight_after_it():
    problem, seconds = problem_of(), 0.4
    whole = FitProblem.first_part(problem, seconds)
    part = problem.first_part(seconds)
    assert part.windows.time.shape[1] < whole.windows.time.shape[1] / 3
    assert part.longest < problem.longest / 3
    assert (part.windows.weight > 0).sum() == (whole.windows.weight > 0).sum()
    guess = np.repeat(whole.initial_starts(), 2, axis=1)
    assert part.initial_starts() == pytest.approx(whole.initial_starts(), abs=1e-12)
    found = fit_starts(part, THETA, guess, 6)
    assert found == pytest.approx(fit_starts(whole, THETA, guess, 6), abs=1e-9)
    assert np.abs(found - guess).max() > 1e-4


def test_windows_begin_with_the_straight_line_through_their_first_samples():
    problem = problem_of()
    for w, found in enumerate(problem.initial_starts()[:, 0].T):
        time, ball = problem.windows.time[w], problem.windows.ball[w, :, 0]
        first = time < 0.3
        rise, place = np.polyfit(time[first], ball[first], 1)
        assert found == pytest.approx((place, rise), abs=1e-9)


@pytest.mark.parametrize(
    ("more", "stops"),
    [
        ((), None),
        (("camber",), None),
        ((), EndStops(low=-0.02, high=0.02, restitution=0.3, touches=np.zeros((2, 0)))),
    ],
)
def test_slopes_by_a_start_are_those_of_simulations_from_places_on_both_sides_of_it(more, stops):
    problem = problem_of((*NAMES, *more), stops)
    theta = np.column_stack((THETA, *([[0.4], [0.4]] for _ in more)))
    starts, shift = starts_of(problem), np.array([[[1e-6]], [[0.0]]])
    after, before = (problem.simulate_samples(theta, starts + k * shift)[0] for k in (1, -1))
    slope = (after - before)[..., 0] / 2e-6 * problem.windows.weight[..., 0]
    found = problem.linearise(theta, starts, slopes=False).by_start[..., 0]
    near = np.abs(found - slope) < 2e-2 * np.abs(slope).max()
    assert near.mean() > 0.9
    if not more and stops is None:
        assert near.all()
        assert problem.rigid_starts == 1
    else:
        assert problem.rigid_starts == 0


def test_a_plate_that_is_measured_to_turn_fast_pushes_the_ball_outwards():
    """Against x'' = 0.66 (x phi'^2 - g phi), integrated by scipy."""
    time = np.arange(0.0, 12.0, 0.005)
    swing, rate = 0.08, 2 * np.pi * 1.7
    log = AxisLog(time, swing * np.sin(rate * time), False, time, 0.02 * np.sin(1.7 * time))
    begin = np.arange(1.0, 9.0, 2.0)
    tilt = TiltHistory(log)
    names = ("gain", "dead_time")
    problem = AxisProblem(axis_windows(log, begin, begin + 2.0), names, tilt, 2.1, (0.0, 0.5))
    assert problem.turns_fast
    gain = -0.66 * BallPlate.gravity
    starts = np.stack((np.full((1, 4), 0.1), np.array([[-0.05, 0.0, 0.02, 0.05]])))
    found = problem.simulate(np.array([[gain * tilt.scale, 0.03]]), starts)[:, 0]
    steps = problem.step * np.arange(len(found))
    for w, at in enumerate(begin):

        def move(t, state, at=at):
            angle = rate * (at + t - 0.03)
            tilted, turned = swing * np.sin(angle), swing * rate * np.cos(angle)
            return state[1], 0.66 * state[0] * turned**2 + gain * tilted

        whole = solve_ivp(move, (0.0, 2.2), starts[:, 0, w], t_eval=steps, rtol=1e-9, atol=1e-9)
        assert found[:, w] == pytest.approx(whole.y[0], abs=5e-4)
    slow = AxisLog(time, 0.05 * log.tilt, False, time, log.ball)
    assert not replace(problem, tilt=TiltHistory(slow)).turns_fast
    assert not replace(problem, tilt=TiltHistory(replace(log, held=True))).turns_fast


def test_a_ball_that_comes_back_from_beyond_a_wall_is_not_turned():
    stops = EndStops(low=-0.02, high=0.02, restitution=0.5, touches=np.zeros((2, 0)))
    problem = problem_of(("gain", "dead_time"), stops)
    starts = np.stack((np.full((1, 4), 0.03), np.array([[-0.05, -0.1, -0.1, -0.1]])))
    found = problem.simulate(np.array([[0.0, 0.0]]), starts)[:, 0]
    assert found[1] == pytest.approx(0.03 + problem.step * starts[1, 0])
    # it passes the near wall, and the far one turns it with half its speed
    first = int(np.ceil(0.05 / 0.1 / problem.step))
    assert found[first:, 1].min() == pytest.approx(-0.02, abs=2e-3)
    assert np.diff(found[first + 2 : first + 20, 1]) == pytest.approx(0.05 * problem.step)


def test_windows_in_which_the_ball_rests_do_not_make_outliers_of_its_motion():
    """Positions of a resting ball in steps of a pixel leave no residual at all."""
    rig = Rig(seconds=14.0, rate=50.0, gain=6.0, dead_time=0.1, lag=0.0, level=0.1, pixel=1e-3)
    time, sampled, ball, command, _ = simulate_log(1, rig)
    moving = AxisLog(time, command, True, sampled, ball)
    rest = sampled[-1] + np.arange(1, 1500) / rig.rate
    holding = np.full_like(rest, -rig.level / rig.gain)
    log = replace(
        moving,
        time=np.append(time, rest),
        tilt=np.append(command, holding),
        sampled=np.append(sampled, rest),
        ball=np.append(ball, np.full_like(rest, ball[-1])),
    )
    names = ("gain", "dead_time", "level", "friction")
    alone, found = (fit_axis(each, names, 2.5, (0.0, 0.5)) for each in (moving, log))
    assert found.sigma == pytest.approx(alone.sigma, rel=0.2)
    assert found.pushed <= 0.8  # where the motion is put to an end
    assert found.value("gain") / found.problem.tilt.scale == pytest.approx(rig.gain, rel=0.03)
