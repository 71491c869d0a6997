"""`twin.shadow`.

The plate's angle as the twin expects it of what was commanded, however fast it is moved."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from twin.identify.prepare import prepare
from twin.scenario import load
from twin.shadow.alarms import CHANGE_TEST
from twin.shadow.belief import (
    CAUSE_SIZES,
    DRIVE_BELIEFS,
    WATCHED_PARAMETERS,
    Belief,
    belief_of,
    logs,
)
from twin.shadow.evidence import (
    GAP_WIDTHS,
    log_evidence,
    plate_angles,
    plate_evidence,
    plate_slopes,
    whiten,
)
from twin.sim.drives import Play

SHAKEN = ("duration=5", "seed=3", "plant.step=0.002", "plant.servo.backlash_deg=0.1")

POSITIONS = ("plant.servo.deadband_deg=0.15", "plant.servo.slew_deg=30")


def recorded(*more):
    """A rig whose plate is moved some times a second: its log, and the twin that is exact."""
    chosen = load("cure", (*SHAKEN, *more))
    (log,) = logs([(chosen, chosen)])
    return prepare(log), belief_of(log)


@pytest.mark.long
@pytest.mark.parametrize(
    "more",
    [
        (),
        ("plant.kind=lagrange", "plant.servo.bandwidth_hz=12"),
        ("plant.kind=lagrange", "plant.servo.bandwidth_hz=12", *POSITIONS),
    ],
    ids=["mechanism", "exact", "to positions"],
)
def test_what_a_fast_law_makes_of_the_plate_is_what_an_exact_twin_expects(more):
    log, belief = recorded(*more)
    (segment,) = log.segments
    (angle,) = plate_angles(segment.command, log.period, belief, (belief.lag, belief.play))
    for axis in (0, 1):
        rest = (segment.plate - angle)[:, axis]
        white = whiten(rest, log.period, belief.disturbance[axis], belief.encoders[axis])
        # as encoders alone would have it is 1; a plate that does not swing on its wheels gives 20
        assert white[500:].std() < 2.5
    evidence = plate_evidence(log, belief, np.zeros((0, 2)))
    which = [WATCHED_PARAMETERS.index(name) for name in DRIVE_BELIEFS]
    A = evidence.information.sum(axis=0)[np.ix_(which, which)]
    off = dict(
        zip(DRIVE_BELIEFS, np.linalg.solve(A, evidence.score.sum(axis=0)[which]), strict=True)
    )
    assert off["lag"] == pytest.approx(0, abs=2e-4)
    assert off["transmission"] == pytest.approx(0, abs=0.005)
    gap = sum(off[name] * GAP_WIDTHS[WATCHED_PARAMETERS.index(name)] for name in DRIVE_BELIEFS)
    assert np.degrees(gap) == pytest.approx(0, abs=0.005)


def ratios(hertz, wider_deg, believed_deg=0.1):
    """Log-likelihood ratios of all causes if a swinging plate has a different gap than believed."""
    period = 0.01
    drives = ["plant.kind=lagrange", "plant.servo.bandwidth_hz=12"]
    scenario = load("circle", [*drives, f"plant.servo.backlash_deg={believed_deg}"])
    belief = Belief.of(scenario, SimpleNamespace(own_lag=0.0, grips=(0.0,)))
    time = period * np.arange(2000)
    swing = np.radians(0.4) * 2 * np.pi * hertz
    command = swing * np.cos(2 * np.pi * hertz * time[:, None] + (0.0, 1.0))
    (shaft,) = plate_angles(command, period, belief, (belief.lag, 0.0))
    gap = Play(np.full((1, 1), np.radians(believed_deg + wider_deg)))  # of the simulated drives
    turns = np.diff(shaft, axis=0, prepend=0.0)
    plate = np.cumsum(np.concatenate([gap.follow(turn[None]) for turn in turns]), axis=0)
    segment = SimpleNamespace(time=time, plate=plate, command=command)
    log = SimpleNamespace(segments=[segment], period=period)
    evidence = plate_evidence(log, belief, np.zeros((0, 2))).softened(belief.changing)
    sums = evidence.information.sum(axis=0), evidence.score.sum(axis=0)
    still = belief.uncertainty + np.diag(belief.drift**2)
    found = log_evidence(*sums, still + belief.changes) - log_evidence(*sums, still)
    return dict(zip(CAUSE_SIZES, found.tolist(), strict=True))


@pytest.mark.parametrize("hertz", [0.1, 0.2, 1.0])
@pytest.mark.parametrize("wider_deg", [-0.015, -0.01, -0.005, 0.005, 0.01, 0.015])
def test_what_an_identified_gap_may_be_wrong_by_is_no_alarm(hertz, wider_deg):
    assert max(ratios(hertz, wider_deg).values()) < CHANGE_TEST.threshold_llr


@pytest.mark.parametrize("hertz", [0.1, 0.2, 1.0])
@pytest.mark.parametrize("wider_deg", [0.05, 0.1])
def test_a_gap_that_has_widened_is_lost_motion_and_no_lag(hertz, wider_deg):
    found = ratios(hertz, wider_deg)
    assert max(found, key=found.__getitem__) == "lost motion"
    assert found["lost motion"] > CHANGE_TEST.threshold_llr


def test_without_play_there_is_no_slope_to_less_of_it():
    scenario = load("circle", ["plant.kind=lagrange", "plant.servo.backlash_deg=0"])
    belief = Belief.of(scenario, SimpleNamespace(own_lag=0.0, grips=(0.0,)))
    _, *slopes = plate_slopes(np.ones((50, 2)), 0.01, belief)
    by = dict(zip(DRIVE_BELIEFS, slopes, strict=True))
    assert not by["less_play"].any()
    # the plate of a steady turn is half a gap behind
    assert by["narrow_play"][-1] == pytest.approx(np.radians(-0.005), rel=1e-9)
