"""How far a replay strays: the state it begins in, and what forces nobody knows make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from twin.identify.prepare import prepare
from twin.identify.search import fit_starts
from twin.identify.windows import STEP, STRETCH, Spans, cut
from twin.scenario import load
from twin.shadow.belief import Belief, believed, logs
from twin.shadow.horizon import (
    BAND,
    LEAD,
    Replays,
    directed,
    replays,
    smoothed,
    turned,
    unforeseen,
)

NO_GAPS = np.zeros((0, 2))
QUICK = (
    *("plant.kind=lagrange", "plant.step=0.004", "rig.period=0.004"),
    *("seed=4", "reference.omega=1.0"),
)


def circled(*settings):
    """A ball that goes round and round: its log, and the twin."""
    chosen = load("circle", (*QUICK, *settings))
    (log,) = logs([(chosen, chosen)])
    return prepare(log), believed(log)


@pytest.fixture(scope="module")
def uneven():
    """The same on an uneven screen."""
    return circled("duration=14", "plant.surface.spread_percent=20")


SIZES = {  # of what is believed, before anything is seen
    "rolling": 0.18e-3 * np.hypot(0.005, 0.003),
    "breakaway": np.hypot(0.03, 0.03),
    "delay": np.hypot(2e-4, 1e-4),
    "level_phi": np.hypot(2e-5, 1e-5),
    "level_theta": np.hypot(2e-5, 1e-5),
    "gain": np.hypot(0.002, 0.0015),
}


@pytest.mark.long
def test_a_smoothed_state_is_the_posterior_of_parameters_and_start(monkeypatch):
    log, belief = circled("duration=5.5", "plant.friction.breakaway_ratio=1.2")

    def spans(segment, begin, end, longest):
        begins = np.arange(begin + 2, end - longest, 2.0)  # the ball rolls
        return Spans(begins, np.full(len(begins), longest), np.zeros(len(begins), bool))

    some = cut(log, belief.lag, LEAD, spans)
    monkeypatch.setattr("twin.shadow.horizon.UNKNOWN", 1e-9)
    mean, covariance, end = smoothed(some, replace(belief, rough=0.0))
    problem, theta = belief.problem(some), belief.theta
    starts = fit_starts(problem, theta, problem.initial_starts(), 6)
    line = problem.linearise(theta, starts)
    prior = np.array([*SIZES.values(), 0.02, 0.02, 0.3, 0.3])
    for w in range(len(mean)):
        J = np.hstack((line.by_parameter[0, w, :, :6], line.by_start[0, w])) * prior
        rows = np.vstack((J, np.eye(10)))
        best = np.linalg.lstsq(rows, np.append(-line.r[0, w], np.zeros(10)), rcond=None)[0]
        assert mean[w, :6] / prior[:6] == pytest.approx(best[:6], abs=1e-6)
        spread = np.linalg.inv(rows.T @ rows)[:6, :6]
        assert covariance[w, :6, :6] / np.outer(prior, prior)[:6, :6] == pytest.approx(spread)
        # the state at the end is that of a replay with the most probable parameters and start
        moved, begun = theta.copy(), starts.copy()
        moved[0, :6] += best[:6] * prior[:6]
        begun[:, 0, w] += best[6:] * prior[6:]
        place, speed = (
            each[round(LEAD / STEP), :, 0, w] for each in problem.replayed(moved, begun)
        )
        assert end[:, w] + mean[w, 6:] == pytest.approx([*place, *speed], abs=2e-5)


@pytest.mark.long
def test_of_a_plate_with_camber_that_is_known_replays_are_as_near_as_of_a_flat_one():
    camber = "plant.camber=[0.4,-0.5]"
    far = []
    for more in ("plant.camber=[0,0]", camber):
        log, belief = circled("duration=8", "seed=3", more)
        far.append(np.median(np.abs(replays(log, belief, NO_GAPS).error[:, :2])))
    assert far[1] == pytest.approx(far[0], rel=0.5)
    flat = load("circle", (*QUICK, "plant.camber=[0,0]"))
    unknown = replays(log, Belief.of(flat, belief), NO_GAPS)
    assert np.median(np.abs(unknown.error[:, :2])) > 10 * far[1]


@pytest.mark.long
def test_on_an_uneven_screen_replays_stray_as_far_as_predicted(uneven):
    log, belief = uneven
    run = replays(log, belief, NO_GAPS)
    inside = run.square[run.counted] <= BAND
    assert len(inside) > 10
    assert inside.sum() >= stats.binom.ppf(1e-3, len(inside), 0.95)
    even = replays(log, replace(belief, rough=1e-6), NO_GAPS)
    assert (even.square[even.counted] <= BAND).mean() < 0.5


@pytest.mark.long
def test_replays_in_parts_are_those_in_one_go(uneven):
    log, belief = uneven
    whole = replays(log, belief, NO_GAPS)
    first = replays(log, belief, NO_GAPS, until=8.5)
    rest = replays(log, belief, NO_GAPS, since=float(first.time[-1]) + 1.0)
    assert 8.5 - 2.0 < first.time[-1] + 1.0 <= 8.5
    together = Replays.join([first, rest])
    assert together.time == pytest.approx(whole.time)
    assert together.error == pytest.approx(whole.error, abs=1e-6, nan_ok=True)
    assert together.spread == pytest.approx(whole.spread, rel=1e-3)


def test_over_a_gap_nothing_is_told(uneven):
    log, belief = uneven
    assert not replays(log, belief, np.array([[0.0, 40.0]])).counted.any()


COUNT = 250


def forces(heading, along=0.01, across=0.0):
    velocity = np.broadcast_to(np.reshape(heading, (1, 2, 1)), (COUNT + 1, 2, 1))
    return directed(velocity, along, across)


@pytest.mark.parametrize(("along", "across"), [(0.01, 0.0), (0.0, 0.002), (0.01, 0.002)])
def test_a_spread_is_that_of_balls_pushed_at_random(along, across):
    rng = np.random.default_rng(3)
    heading = np.array([0.6, -0.8])
    stretch = round(STRETCH / STEP)
    places = np.zeros((20_000, 2))
    for begin in range(0, COUNT, stretch):
        lasting = (min(begin + stretch, COUNT) - begin) * STEP
        left = (COUNT - begin) * STEP - lasting
        pushed = along * rng.standard_normal((len(places), 1)) * heading
        pushed = pushed + across * rng.standard_normal((len(places), 2))
        places += pushed * (lasting**2 / 2 + lasting * left)
    (predicted,) = unforeseen(forces(0.05 * heading, along, across), COUNT * STEP)
    assert predicted == pytest.approx(np.cov(places.T), abs=0.05 * np.trace(predicted))


def test_friction_that_nobody_knows_moves_no_ball_at_rest():
    assert not unforeseen(forces((0.0, 0.0)), 1.0).any()
    assert unforeseen(forces((0.0, 0.0), across=0.001), 1.0)[0, 0, 0] > 0


def test_columns_of_unit_accelerations_become_those_of_the_unknown_ones():
    there = forces((0.05, 0.0), 0.01, 0.002)
    columns = np.arange(2.0 * 2 * there.shape[1]).reshape(1, 2, -1)
    found = turned(columns, there)
    assert found[..., 0::2] == pytest.approx(np.hypot(0.01, 0.002) * columns[..., 0::2])
    assert found[..., 1::2] == pytest.approx(0.002 * columns[..., 1::2])
    assert turned(columns[0], there) == pytest.approx(found)
