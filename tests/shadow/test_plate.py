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
from twin.shadow.evidence import log_evidence, without_rest
from twin.shadow.plate import PLAY_ERROR_RAD, plate_angles, plate_evidence, plate_slopes, whiten
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
    assert off["narrow_play"] == pytest.approx(0, abs=0.1)


PERIOD = 0.01
SWING = np.radians(0.4)
BANDWIDTH_HZ = 12.0


def exact_twin(play_deg):
    """A twin on the exact equations, its drives with a gap."""
    drives = (f"plant.servo.bandwidth_hz={BANDWIDTH_HZ}", f"plant.servo.backlash_deg={play_deg}")
    scenario = load("circle", ["plant.kind=lagrange", *drives])
    return Belief.of(scenario, SimpleNamespace(own_lag=0.0, grips=(0.0,)))


def swung(hertz, seconds=20.0):
    """Commands of a plate that swings by 0.4 deg, rad/s."""
    time = PERIOD * np.arange(round(seconds / PERIOD))[:, None]
    return SWING * 2 * np.pi * hertz * np.cos(2 * np.pi * hertz * time + (0.0, 1.0))


def ratios(hertz, believed_deg, wider_deg=0.0, later_s=0.0):
    """Log-likelihood ratios of all causes where a swinging plate is not as believed.

    The gap is that of the simulated drives.
    """
    belief, command = exact_twin(believed_deg), swung(hertz)
    (shaft,) = plate_angles(command, PERIOD, belief, (belief.lag + later_s, 0.0))
    gap = Play(np.full((1, 1), np.radians(believed_deg + wider_deg)))
    turns = np.diff(shaft, axis=0, prepend=0.0)
    plate = np.cumsum(np.concatenate([gap.follow(turn[None]) for turn in turns]), axis=0)
    time = PERIOD * np.arange(len(command))
    segment = SimpleNamespace(time=time, plate=plate, command=command)
    log = SimpleNamespace(segments=[segment], period=PERIOD)
    evidence = plate_evidence(log, belief, np.zeros((0, 2))).softened(belief.changing)
    sums = evidence.information.sum(axis=0), evidence.score.sum(axis=0)
    still = belief.uncertainty + np.diag(belief.drift**2)
    found = log_evidence(*sums, still + belief.changes) - log_evidence(*sums, still)
    return dict(zip(CAUSE_SIZES, found.tolist(), strict=True))


@pytest.mark.parametrize("hertz", [0.1, 0.2, 1.0])
@pytest.mark.parametrize("wider_deg", [-0.015, -0.01, -0.005, 0.005, 0.01, 0.015])
@pytest.mark.parametrize("believed_deg", [0.1, 0.25])
def test_what_an_identified_gap_may_be_wrong_by_is_no_alarm(hertz, wider_deg, believed_deg):
    assert max(ratios(hertz, believed_deg, wider_deg).values()) < CHANGE_TEST.threshold_llr


@pytest.mark.parametrize("hertz", [0.2, 1.0])
@pytest.mark.parametrize("believed_deg", [0.1, 0.25])
def test_a_gap_that_has_widened_is_lost_motion_and_no_lag(hertz, believed_deg):
    found = ratios(hertz, believed_deg, 0.1)
    assert max(found, key=found.__getitem__) == "lost motion"
    assert found["lost motion"] > CHANGE_TEST.threshold_llr


@pytest.mark.parametrize("believed_deg", [0.0, 0.1, 0.25])
def test_drives_that_lag_behind_a_gap_are_found(believed_deg):
    found = ratios(1.0, believed_deg, later_s=0.008)
    assert max(found, key=found.__getitem__) == "servo lag"
    assert found["servo lag"] > CHANGE_TEST.threshold_llr


@pytest.mark.parametrize(("play_deg", "narrower"), [(0.1, 1.0), (0.0, 0.0)])
def test_a_steady_turn_is_behind_by_half_of_what_a_gap_is_wrong_by(play_deg, narrower):
    command = np.full((200, 2), 0.1)
    *_, more, less = plate_slopes(command, PERIOD, exact_twin(play_deg))
    half = PLAY_ERROR_RAD / 2 / np.sqrt(2)
    assert more[-1] == pytest.approx(-half)
    assert less[-1] == pytest.approx(narrower * half)  # no gap is narrower than none


def test_unknown_numbers_are_integrated_out():
    rng = np.random.default_rng(1)
    J = rng.normal(size=(9, 3))
    y = rng.normal(size=9)
    A, b = without_rest((J.T @ J)[None], (J.T @ y)[None], 1)
    # likelihood of y with covariance I + J_e J_e' about J_d d, by its slope and curvature at d = 0
    inverse = np.linalg.inv(np.eye(9) + J[:, 1:] @ J[:, 1:].T)
    assert A[0, 0, 0] == pytest.approx(J[:, 0] @ inverse @ J[:, 0])
    assert b[0, 0] == pytest.approx(J[:, 0] @ inverse @ y)
