"""`twin.emulator`: What an emulated rig truly does, seen from outside."""

import numpy as np
import pytest

from twin.emulator.lockstep import LockstepRig, MotionTrace
from twin.emulator.power_stage import Power


@pytest.fixture
def rig(scenario):
    return LockstepRig(scenario())


def turn(rig, seconds):
    """Let the host ask for a motor rate of phi, 0.3 rad/s."""
    for _ in range(round(seconds / rig.period)):
        rig.servos.command(np.array([[0.3, 0.0]]))
        rig.servos.send()
        rig.wait()
        rig.read()


@pytest.mark.long
def test_a_quick_stop_shorter_than_a_step_of_the_bus_is_seen(rig):
    trace = MotionTrace(rig)
    with rig:
        turn(rig, 0.05)
        begin = rig.now()
        rig.servos.quick_stop()
        turn(rig, 0.02)
    own = [each for each in trace.changes if each.axis == 0 and each.time >= begin]
    assert [each.after for each in own[:2]] == [Power.QUICK_STOP, Power.SWITCH_ON_DISABLED]
    assert own[1].time - own[0].time < 0.001
    assert [each.lost for each in own[:2]] == [False, True]
    assert trace.state(0, begin - 0.001) is Power.OPERATION_ENABLED
    assert trace.state(0, rig.now()) is Power.SWITCH_ON_DISABLED
    assert not trace.live


def test_the_motion_is_that_of_the_plant_step_by_step(rig):
    trace = MotionTrace(rig)
    with rig:
        begin = rig.now()
        turn(rig, 0.1)
        motion = trace.between(begin, rig.now())
        state = rig.plant.devices.state[0]
    assert motion.time[0] == pytest.approx(begin, abs=6e-4)
    assert np.diff(motion.time).max() < 6e-4
    np.testing.assert_array_equal(motion.plate[-1], state[[2, 6]])
    np.testing.assert_array_equal(motion.ball[-1], state[[0, 4]])
    assert motion.speed[-1] == pytest.approx(0.3, rel=0.05)
    assert motion.tilt[-1] == pytest.approx(0.03, rel=0.2)
    way = np.trapezoid(motion.rate[:, 0], motion.time)
    assert motion.plate[-1, 0] - motion.plate[0, 0] == pytest.approx(way, abs=3e-4)


def test_what_is_done_to_a_drive_is_told_from_what_it_does(rig):
    trace = MotionTrace(rig)
    with rig:
        rig.lockstep.drives[0].fail(235)
        trace.note_injection()
        rig.lockstep.drives[1].open_sto()
        turn(rig, 0.02)
    found = [each for each in trace.changes if each.before is Power.OPERATION_ENABLED]
    assert [(each.axis, each.fault, each.injected) for each in found] == [
        (0, 235, True),
        (1, 602, False),
    ]
