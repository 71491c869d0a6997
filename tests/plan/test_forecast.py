"""`twin.plan.forecast`: Expected intervals are those that the noise gives."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from ballplate import identify, plan_experiment, run
from twin.identify.least_squares import (
    CONVERGED,
    Fit,
    FitProblem,
    Minimum,
    SampleWindows,
    Termination,
)
from twin.identify.parameters import DEFAULT_PARAMETERS, IdentifiedParameter
from twin.identify.twin_model import identify_twin
from twin.plan.forecast import ExpectedFit, find_indistinct, forecast_log, half_width
from twin.scenario.schema import at_study_step
from twin.shadow.belief import logs
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder

WINDOWS, SAMPLES, SIGMA = 30, 20, 2e-3


@dataclass(frozen=True)
class Falling(FitProblem[SampleWindows]):
    """A ball with a start of its own in each window: x = p + v t + a t^2/2."""

    about: ClassVar = {"a": IdentifiedParameter("a", "", "", least=-9.0, most=9.0, difference=0.1)}
    start_steps: ClassVar = np.array([1e-3, 1e-3])
    prior: ClassVar = 1e-9 * np.eye(2)
    tolerated_misfit: ClassVar = 3.0

    def simulate_samples(self, theta, starts):
        time = self.windows.time
        x = starts[0][..., None] + starts[1][..., None] * time + theta[:, :1, None] * time**2 / 2
        return x[..., None], np.zeros((*x.shape, 1))


def falling():
    time = np.tile(np.linspace(0, 1, SAMPLES), (WINDOWS, 1))
    weight = np.full((WINDOWS, SAMPLES, 1), 1 / SIGMA)
    return Falling(SampleWindows(np.arange(WINDOWS), time, np.zeros_like(weight), weight), ("a",))


def test_the_expected_half_width_is_that_of_linear_regression():
    problem, theta, starts = falling(), np.zeros((1, 1)), np.zeros((2, 1, WINDOWS))
    line = problem.linearise(theta, starts)
    found = Minimum(theta, starts, np.zeros(1), line, Termination(CONVERGED, 0, 0))
    expected = ExpectedFit(problem, found).estimate().half_width
    time = problem.windows.time[0]
    own = np.stack((np.ones_like(time), time, time**2 / 2), axis=-1)
    variance = SIGMA**2 * np.linalg.inv(own.T @ own)[2, 2] / WINDOWS
    assert expected == pytest.approx([1.96 * np.sqrt(variance)], rel=0.12)
    # a fit of one noise scatters about it
    noise = np.random.default_rng(1)
    each = []
    for _ in range(30):
        r = noise.standard_normal(line.r.shape)
        one = found._replace(linearisation=line._replace(r=r))
        each.append(Fit(problem, one).estimate().half_width[0])
    assert np.mean(each) == pytest.approx(expected[0], rel=0.08)


def test_parameters_that_move_the_ball_alike_are_named_and_no_others():
    slopes = np.random.default_rng(2).standard_normal((400, 4))
    slopes[:, 2] = 30 * (slopes[:, 0] + 0.05 * slopes[:, 2])
    names = ("rolling", "delay", "breakaway", "dwell")
    assert find_indistinct(names, slopes.T @ slopes) == [("rolling", "breakaway")]
    slopes[:, 2] = np.random.default_rng(3).standard_normal(400)
    assert find_indistinct(names, slopes.T @ slopes) == []


@pytest.mark.long
def test_identification_of_the_planned_run_gives_the_forecast_widths():
    found = identify(run("excite", ["parameters=hobby", "duration=40"])).verdicts
    planned = plan_experiment("excite", on="hobby", seconds=40, rigs=0).best.nominal
    for name in ("rolling", "delay", "level_phi", "level_theta"):
        (one,) = (each for each in found if each.name == name)
        # seven degrees of freedom: the width of one fit scatters by a quarter
        assert 0.5 < half_width(planned.verdict(name)) / half_width(one) < 2


@pytest.mark.long
def test_a_ball_that_falls_gives_nothing_and_says_so():
    planned = plan_experiment("excite", on="three_legs", seconds=6, rigs=0).best
    assert planned.nominal.verdicts == ()
    assert "the ball rolls for" in planned.nominal.why
    assert planned.score == pytest.approx(100)


@pytest.mark.long
def test_a_start_that_the_true_friction_misses_widens_no_forecast():
    """In a window of this run the ball clings longer than a replay of the rig itself says."""
    number = 5
    rig = draw_rigs(read_family("uncertain"), 63_201, number + 1)[number]
    build, fixed = Builder("excite"), ["duration=40"]
    truth = at_study_step(build([*fixed, f"seed={rig.seed + 2}"], rig.point))
    (log,) = logs([(at_study_step(build(fixed, {})), truth)])
    planned, found = forecast_log(log, truth), identify_twin(log, DEFAULT_PARAMETERS)
    widths = {one.name: half_width(one) for one in found.verdicts}
    for name in ("rolling", "delay", "level_phi", "level_theta"):
        # of one log they differ by the draw of the residuals alone
        assert 1 / 1.3 < half_width(planned.verdict(name)) / widths[name] < 1.3
