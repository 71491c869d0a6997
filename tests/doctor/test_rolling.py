"""`twin.doctor.rolling`: how each axis tilts, shown by the ball, on boards in virtual time."""

import math

import numpy as np
import pytest
from command_line import called
from own_board import VirtualBoard, own_rig

from twin.base.errors import RigError
from twin.doctor.check import CheckStatus
from twin.doctor.rolling import ROLL_TEST, roll
from twin.hal.supervisor import State
from twin.scenario import load

HOBBY = {"lag": 0.06, "late": 0.03, "noise": 3e-4}
LONG = pytest.mark.long
IDENTITY = ((1.0, 0.0), (0.0, 1.0))


class Wired(VirtualBoard):
    """The board with wires and picture of one's own: what is commanded, and what is seen."""

    def __init__(self, *, commanded=IDENTITY, seen=IDENTITY, **given):
        self.commanded, self.seen = np.array(commanded), np.array(seen)
        self.furthest, self.steepest = 0.0, 0.0
        super().__init__(encoder=False, **{**HOBBY, **given})

    def command(self, rates, angles):
        angles = (self.commanded @ angles).tolist()
        self.steepest = max(self.steepest, *map(abs, angles))
        super().command(rates, angles)

    def measure(self):
        self.furthest = max(self.furthest, *map(abs, self.board.ball))
        reading = super().measure()
        x, y = self.seen @ (reading.x, reading.y)
        return reading._replace(x=float(x), y=float(y))


def rolled(hardware, patience=0.0, *settings):
    """The results by their names, and the rig."""
    scenario = load("hold", ("parameters=hobby", *settings))
    rig = own_rig(hardware, scenario, plate_lag=hardware.board.lag, steep_deg=5.0)
    rig.watches_roll = False
    with rig:
        found = {each.what: each for each in roll(rig, patience)}
    return found, rig


@pytest.mark.long
@pytest.mark.parametrize(
    "given",
    [
        pytest.param({}, id="hobby"),
        pytest.param({"friction": 0.001, "lag": 0.11, "late": 0.06}, id="late", marks=LONG),
        pytest.param({"friction": 0.015, "lag": 0.02, "late": 0.0}, id="rough", marks=LONG),
    ],
)
def test_a_rig_that_is_wired_rightly_passes_and_keeps_its_ball(given):
    hardware = Wired(**given)
    found, rig = rolled(hardware)
    assert {name: each.status for name, each in found.items()} == {
        "ball by phi": CheckStatus.PASS,
        "ball by theta": CheckStatus.PASS,
    }
    assert "larger x at a positive angle" in found["ball by phi"].seen
    assert "smaller y at a positive angle" in found["ball by theta"].seen
    assert hardware.furthest < 0.06  # of the 0.1 m of its area
    assert hardware.steepest <= 1.5 * ROLL_TEST.max_tilt_rad
    assert np.abs(hardware.board.angle).max() < math.radians(0.3)
    assert rig.supervisor.state[0] == State.OFF


@LONG
def test_a_rig_of_one_axis_is_tilted_by_phi_alone():
    found, _ = rolled(Wired(), 0.0, "plant.kind=lagrange", "plant.axes=1")
    assert {name: each.status for name, each in found.items()} == {"ball by phi": CheckStatus.PASS}


TURN = 0.5, math.sqrt(0.75)
TURNED = ((TURN[1], -TURN[0]), (TURN[0], TURN[1]))
WRONG = {
    "phi commanded backwards": ({"commanded": ((-1, 0), (0, 1))}, ("larger x went down",), "theta"),
    "theta commanded backwards": ({"commanded": ((1, 0), (0, -1))}, ("larger y went up",), "phi"),
    "x of the picture mirrored": ({"seen": ((-1, 0), (0, 1))}, ("larger x went down",), "theta"),
    "drives exchanged": ({"commanded": ((0, 1), (1, 0))}, ("exchange the drives", "exchange"), ""),
    "picture turned by 90 deg": ({"seen": ((0, -1), (1, 0))}, ("exchange", "exchange"), ""),
    "picture turned by 30 deg": ({"seen": TURNED}, ("turn the screen", "turn the screen"), ""),
}


@pytest.mark.parametrize(
    "wrong", [pytest.param(each, marks=() if "mirrored" in each else LONG) for each in WRONG]
)
def test_a_rig_that_is_wired_wrongly_fails_by_the_axis_and_keeps_its_ball(wrong):
    given, words, right = WRONG[wrong]
    hardware = Wired(**given)
    found, _ = rolled(hardware)
    failed = [each for each in found.values() if each.status is CheckStatus.FAIL]
    assert len(failed) == len(words)
    for each, word in zip(failed, words, strict=True):
        assert word in each.advice
    if right:
        assert found[f"ball by {right}"].status is CheckStatus.PASS
    if "30" in wrong:
        assert 25 < float(failed[0].seen.split()[1]) < 35
    assert hardware.furthest < 0.08


@pytest.mark.long
def test_a_ball_that_does_not_roll_is_said_so():
    hardware = Wired(friction=0.5)
    found, _ = rolled(hardware)
    assert "did not roll at +4.0 and -4.0 deg" in found["ball by phi"].seen
    assert found["ball by phi"].status is CheckStatus.FAIL


def test_a_ball_at_the_edge_is_to_be_put_in_the_middle():
    hardware = Wired()
    hardware.board.ball = [0.06, 0.0]
    found, _ = rolled(hardware)
    assert found["ball"].seen.startswith("not at rest there: x +60, y ")
    assert found["ball"].advice == "put it within 35 x 35 mm of the middle"
    assert hardware.steepest < math.radians(0.1)


def test_a_ball_that_is_not_seen_is_said_so():
    hardware = Wired()
    step = hardware.board.step

    def taken(now):
        if now > 0.2:  # after the rig has waited for it
            hardware.board.ball = [0.5, 0.0]
        return step(now)

    hardware.board.step = taken
    found, _ = rolled(hardware)
    assert found["ball"].seen == "no ball is seen"
    assert found["ball"].status is CheckStatus.FAIL


@pytest.mark.long
def test_a_ball_that_is_put_into_the_middle_in_time_is_waited_for():
    hardware = Wired()
    hardware.board.ball = [0.06, 0.0]
    step = hardware.board.step

    def put(now):
        if 3.0 < now < 4.0:
            hardware.board.ball = [0.0, 0.0]
        return step(now)

    hardware.board.step = put
    found, _ = rolled(hardware, patience=4.0)
    assert found["ball by phi"].status is CheckStatus.PASS


def test_a_ball_that_is_taken_away_levels_the_plate():
    hardware = Wired()
    step = hardware.board.step

    def taken(now):
        if now > 2.0:
            hardware.board.ball = [0.5, 0.0]
        return step(now)

    hardware.board.step = taken
    with pytest.raises(RigError, match="ball"):
        rolled(hardware)
    assert np.abs(hardware.board.angle).max() < math.radians(0.3)


def test_the_help_names_the_largest_tilt(capsys):
    _, said, _ = called(capsys, "doctor", "--help")
    tilt = f"tilted, by up to {math.degrees(ROLL_TEST.max_tilt_rad):g} deg,"
    assert tilt in " ".join(said.split())


def test_ball_without_move_is_refused(capsys):
    code, _, said = called(capsys, "doctor", "--rig", "rig.toml", "--ball")
    assert code == 2
    assert "--ball: tilts the plate until the ball rolls; it needs --move" in " ".join(said.split())
