"""`twin.shadow`.

The plate's angle as the twin expects it of what was commanded, however fast it is moved."""

from __future__ import annotations

import numpy as np
import pytest

from twin.identify.prepare import prepare
from twin.scenario import load
from twin.shadow.belief import DRIVE_BELIEFS, WATCHED_PARAMETERS, belief_of, logs
from twin.shadow.evidence import plate_angles, plate_evidence, whiten

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
    assert off["narrow_play"] == pytest.approx(0, abs=0.1)
