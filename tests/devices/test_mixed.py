"""`twin.devices.rig`: rigs of two kinds of devices, of which one fails while the other continues.

Truth is the simulated plant. Every row is done while the ball tracks a circle.
"""

import numpy as np
import pytest
from mixed_rigs import AkdWithCamera, OwnWithLumio

from twin.base.errors import RigError
from twin.devices.akd import conditions as akd
from twin.devices.akd.conditions import DriveError
from twin.devices.lumio import conditions as lumio
from twin.devices.own import FAILED, REPORTED, SCREEN_FAILED, SCREEN_REPORTED, SILENT
from twin.hal.interface import Severity
from twin.hal.supervisor import BALL_LOST
from twin.run.controller_building import build_controller
from twin.run.loop import drive
from twin.run.metrics import Ending
from twin.run.record import Recorder

BEGIN_S, DURATION_S = 0.5, 2.0
CIRCLE = (
    'reference={kind="circle",amplitude=0.05,omega=2.0}',
    f"duration={DURATION_S}",
    "controller.kappa=0.5",
)
WATCH_AFTER_S = 1.0
"""For how long the plate is watched after the rig was left, s."""
LEVEL_RAD, STILL_RAD_S = np.radians(0.3), 0.02


def sets(**values):
    return lambda device: [setattr(device, name, value) for name, value in values.items()]


def on_camera(**values):
    return lambda rig: sets(**values)(rig.camera)


def on_servos(**values):
    return lambda rig: sets(**values)(rig.hardware)


GONE = OSError("cable gone")
SCREEN_GONE, NODE_SILENT, STO, NO_BALL = "unplugged", "silent", "sto", "lifted"
ROWS = {
    # a camera beside AKD drives
    "camera fails": (AkdWithCamera, on_camera(error=GONE), SCREEN_FAILED, 0.0),
    "camera reports": (AkdWithCamera, on_camera(words=("too dark",)), SCREEN_REPORTED, 0.0),
    "camera silent": (AkdWithCamera, on_camera(silent=True), SILENT, 0.0),
    "camera blind": (AkdWithCamera, on_camera(ball=lambda: ()), BALL_LOST, 0.12),
    "drive silent": (
        AkdWithCamera, lambda rig: rig.lockstep.bus.faults.silence(1), akd.PDO_STALE, 0.0,
    ),
    "STO opens": (
        AkdWithCamera, lambda rig: sets(sto_closed=False)(rig.lockstep.drives[0].power),
        akd.DRIVE_FAULT, 0.0,
    ),
    # servos of one's own under a Lumio screen
    "servos fail": (OwnWithLumio, on_servos(error=GONE), FAILED, 0.0),
    "servos report": (OwnWithLumio, on_servos(words=("too hot",)), REPORTED, 0.0),
    "screen unplugged": (
        OwnWithLumio, lambda rig: sets(plugged=False)(rig.port), lumio.UNPLUGGED, 0.0,
    ),
}  # fmt: skip


def carried_out(rig, scenario, act=lambda rig: None):
    """Run a scenario; outcome, record, and the true plate from the fault on, with its times."""
    record = Recorder(round(DURATION_S / rig.period), 1, rig.period)
    seen, begun = [], []

    def watch(time, _):
        if time >= BEGIN_S and not begun:
            begun.append(rig.now())
            act(rig)

    record.observers.append(watch)
    advance = rig.plant.advance

    def followed(seconds):
        advance(seconds)
        seen.append(
            (rig.now(), *rig.plant.devices.state[0, 2::4], *rig.plant.devices.state[0, 3::4])
        )

    rig.plant.advance = followed
    if hasattr(rig, "lockstep"):
        rig.lockstep.bus.moved = followed
    (outcome,) = drive(rig, build_controller(scenario), DURATION_S, record)
    for _ in range(round(WATCH_AFTER_S / rig.period)):
        rig.sleep(rig.period)
    return outcome, record, np.array(seen), begun[0] if begun else None


@pytest.mark.parametrize(
    "kind", [pytest.param(AkdWithCamera, marks=pytest.mark.long), OwnWithLumio]
)
def test_a_mixed_rig_runs_whole_and_ends_level_without_torque(kind, scenario):
    chosen = scenario(*CIRCLE)
    rig = kind(chosen)
    outcome, record, motion, _ = carried_out(rig, chosen)
    assert outcome.ending is Ending.FINISHED, outcome.reason
    assert len(record.time) == round(DURATION_S / rig.period)
    assert np.diff(record.time) == pytest.approx(rig.period)
    assert np.abs(motion[-1, 1:3]).max() < LEVEL_RAD
    assert np.abs(motion[:, 1:3]).max() > np.radians(0.5)  # it was moved
    serious = [n for _, n in rig.journal if n.condition.severity is not Severity.WARNING]
    assert serious == []
    assert not torque(rig)


def torque(rig):
    if isinstance(rig, OwnWithLumio):
        return rig.hardware.torque
    return any(drive.enabled for drive in rig.lockstep.drives)


LONG = {"camera reports", "camera silent"}
"""Rows that differ from a camera that fails in the reason alone."""


@pytest.mark.short("servos fail", "servos report", "STO opens")
@pytest.mark.parametrize(
    "row", [pytest.param(each, marks=pytest.mark.long if each in LONG else ()) for each in ROWS]
)
def test_a_fault_of_one_device_is_detected_in_time_and_leaves_the_plate_safe(row, scenario):
    kind, act, condition, more = ROWS[row]
    chosen = scenario(*CIRCLE)
    rig = kind(chosen)
    outcome, record, motion, begun = carried_out(rig, chosen, act)
    found = [at for at, note in rig.journal if note.condition.name == condition.name]
    assert found, [note.text for _, note in rig.journal]
    frame = 1 / 60
    assert found[0] - BEGIN_S <= condition.within + frame + 2 * rig.period + more
    assert outcome.ending is not Ending.FINISHED
    # what was recorded is whole: every period from the first to the one in which the run ended
    assert np.diff(record.time) == pytest.approx(rig.period)
    assert record.time[0] == 0
    assert record.time[-1] >= outcome.time - 1.001 * rig.period
    after = motion[motion[:, 0] >= begun]
    last = after[after[:, 0] > after[-1, 0] - 0.05]
    assert np.abs(after[:, 1:3]).max() < chosen.rig.limits.angle_deg * np.pi / 180 + 0.01
    assert np.abs(last[:, 3:5]).max() < STILL_RAD_S
    if condition.severity is Severity.LEVEL:
        assert np.abs(last[:, 1:3]).max() < LEVEL_RAD
    assert not torque(rig)
    if isinstance(rig, AkdWithCamera):
        assert rig.camera.stopped == 1
    else:
        assert rig.hardware.stopped == 1
        assert not rig.screen.connected


@pytest.mark.parametrize(
    ("kind", "act", "words"),
    [
        (AkdWithCamera, on_camera(error=GONE), "cable gone"),
        (OwnWithLumio, lambda rig: sets(plugged=False)(rig.port), "unplugged"),
    ],
)
def test_a_screen_that_is_not_there_leaves_the_servos_without_torque(kind, act, words, scenario):
    rig = kind(scenario())
    act(rig)
    with pytest.raises((RigError, OSError), match=words), rig:
        pass
    assert not torque(rig)


def test_servos_that_are_not_there_close_the_screen_again(scenario):
    rig = AkdWithCamera(scenario())
    rig.lockstep.bus.drives.pop()
    with pytest.raises(DriveError, match="theta"), rig:
        pass
    assert (rig.camera.started, rig.camera.stopped) == (1, 1)
    other = OwnWithLumio(scenario())
    other.hardware.measure = lambda: 3
    with pytest.raises(RigError, match="Reading"), other:
        pass
    assert other.hardware.stopped == 1
    assert not other.screen.connected
