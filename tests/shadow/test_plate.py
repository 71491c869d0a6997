"""`twin.shadow`.

The plate's angle as the twin expects it of what was commanded, however fast it is moved."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from twin.identify.prepare import prepare
from twin.scenario import load
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
    plate_angles,
    plate_evidence,
    plate_slopes,
    posterior,
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


SLOW, FAST = 0.15, 1.0


@pytest.mark.parametrize("hertz", [SLOW, FAST])
@pytest.mark.parametrize("wider_deg", [-0.01, -0.005, 0.005, 0.01, 0.05])
def test_a_gap_that_is_wider_or_narrower_than_believed_is_no_lag(hertz, wider_deg):
    period, believed = 0.01, 0.1
    drives = ["plant.kind=lagrange", "plant.servo.bandwidth_hz=12"]
    scenario = load("circle", [*drives, f"plant.servo.backlash_deg={believed}"])
    belief = Belief.of(scenario, SimpleNamespace(own_lag=0.0, grips=(0.0,)))
    time = period * np.arange(1500)
    swing = np.radians(0.4) * 2 * np.pi * hertz
    command = swing * np.cos(2 * np.pi * hertz * time[:, None] + (0.0, 1.0))
    angle, *slopes = plate_slopes(command, period, belief)
    # what the simulated drives make of the same shaft with the other gap
    (shaft,) = plate_angles(command, period, belief, (belief.lag, 0.0))
    gap = Play(np.full((1, 1), np.radians(believed + wider_deg)))
    turns = np.diff(shaft, axis=0, prepend=shaft[:1])
    true = shaft[0] + np.cumsum(np.concatenate([gap.follow(turn[None]) for turn in turns]), axis=0)
    both = np.stack((true - angle, *slopes))
    e, *J = np.concatenate(
        [
            whiten(both[..., axis], period, belief.disturbance[axis], belief.encoders[axis])
            for axis in (0, 1)
        ],
        axis=1,
    )
    J = np.array(J)[:, 100:]
    open_to = {"lag": 0.015, "transmission": 0.15, **CAUSE_SIZES["lost motion"]}
    prior = np.diag([open_to[name] ** 2 for name in DRIVE_BELIEFS])
    found, _ = posterior(J @ J.T, J @ e[100:], prior)
    off = dict(zip(DRIVE_BELIEFS, found, strict=True))
    wider = sum(off[name] * GAP_WIDTHS[WATCHED_PARAMETERS.index(name)] for name in DRIVE_BELIEFS)
    assert off["lag"] == pytest.approx(0, abs=0.0015)
    assert np.degrees(wider) == pytest.approx(wider_deg, abs=0.003)
