"""`twin.identify.further_terms`: what a fit may take for another friction."""

from dataclasses import replace

import numpy as np
import pytest

from docs.identify_errors import Rig, simulate_log
from twin.identify.axis_logs import AxisLog
from twin.identify.axis_problem import AxisProblem
from twin.identify.axis_verdicts import assess_axis
from twin.identify.command_model import TiltHistory
from twin.identify.further_terms import find_hidden_changes
from twin.identify.plain_model import fit_axis
from twin.identify.windows import axis_windows

NAMES = ("gain", "dead_time", "lag", "level", "friction")


def test_friction_that_holds_a_damping_too_small_to_be_fitted_reaches_the_true_one():
    rig = Rig(seconds=30.0, rate=50.0, gain=5.0, friction=0.03, viscous=0.15, noise=1e-3)
    time, sampled, ball, command, _ = simulate_log(1, rig)
    fit = fit_axis(AxisLog(time, command, True, sampled, ball), NAMES, 2.5, (0.0, 0.5))
    half = fit.estimate().half_width[NAMES.index("friction")]
    assert fit.value("friction") - half > rig.friction
    lower = {
        what: float(each[:, NAMES.index("friction")].min())
        for what, each in find_hidden_changes(fit)
    }
    assert fit.value("friction") - half + lower["a damping too small to be fitted"] < rig.friction
    (said,) = (each for each in assess_axis(fit, "x", "rad") if each.name == "friction_x")
    assert said.low < rig.friction < said.high
    assert "the interval includes what a damping too small to be fitted would change" in said.why


def test_fits_with_a_filter_of_the_positions_reach_the_true_gain_and_friction():
    """Every filter that is tried moves the fit; one about as slow as the true one to the truth."""
    rig = Rig(seconds=24.0, gain=5.46, dead_time=0.064, filtered=0.056, friction=0.059)
    time, sampled, ball, command, _ = simulate_log(103, rig)
    fit = fit_axis(AxisLog(time, command, True, sampled, ball), NAMES, 2.5, (0.0, 0.5))
    (changes,) = (each for what, each in find_hidden_changes(fit) if "filter" in what)
    assert len(changes) >= 2
    assert np.abs(changes[:, [0, 4, 5]]).min() > 0
    values = np.append(fit.found.theta, fit.found.theta[0, 1:3].sum())
    truth = rig.gain * fit.problem.tilt.scale, rig.friction, 0.05 + 0.064 + 0.056
    off = np.abs(values + changes - np.array([truth[0], 0, 0, 0, *truth[1:]]))[:, [0, 4, 5]]
    before = np.abs(values[[0, 4, 5]] - truth)
    assert (off < 0.8 * before).all(axis=1).any()
    told = {each.name: each for each in assess_axis(fit, "x", "rad")}
    for name, value in (("gain_x", rig.gain), ("friction_x", rig.friction)):
        assert told[name].low < value < told[name].high


def problem_of(tilt):
    time = np.arange(0.0, 4.0, 0.01)
    log = AxisLog(time, np.full_like(time, tilt), True, time, 0 * time)
    windows = axis_windows(log, np.zeros(1), np.full(1, 4.0))
    return AxisProblem(windows, ("gain", "dead_time"), TiltHistory(log, 1.0), 4.0, (0.0, 0.5))


def simulate(problem, speed):
    starts = np.array([0.0, speed])[:, None, None]
    return problem.simulate(np.array([[6.0, 0.0]]), starts)[:, 0, 0]


@pytest.mark.parametrize(("push", "starts"), [(0.19, False), (0.21, True)])
def test_a_friction_that_sticks_holds_a_ball_at_rest(push, starts):
    sticking = replace(problem_of(push / 6.0), sticking=(0.2, 0.01))
    moved = float(simulate(sticking, 0.0)[-1])
    assert (moved > 0.01) is starts
    if starts:  # nothing is left of it at speed
        free = float(simulate(problem_of(push / 6.0), 0.0)[-1])
        assert moved > 0.8 * free


def test_filtered_positions_lie_behind_by_the_time_constant():
    problem = problem_of(0.02)
    own, filtered = simulate(problem, 0.1), simulate(replace(problem, filter_s=0.1), 0.1)
    assert filtered[0] == pytest.approx(0.0)
    # a ball that accelerates is behind by tau v; its own start is ahead of the filter's by as much
    time = problem.step * np.arange(len(own))
    settled = time > 1.0
    behind = 0.1 * (0.1 + 0.12 * time) - 0.1**2 * 0.12
    np.testing.assert_allclose((own + 0.01 - filtered)[settled], behind[settled], atol=1e-4)
