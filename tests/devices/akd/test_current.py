"""`twin.devices.akd.config`.

The current limit in the drives: enough for the plate, and of the motor that is there."""

import math

import numpy as np
import pytest
from stepped import SteppedDrives, refused

from twin.base.shipped import model_path
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.hal.cams import CamTable
from twin.sim.plant.mechanism import Mechanism


def torque_of_the_hardest_motion():
    """Peak torque in N m of a motor, 8 deg at 7 rad/s^2 on both axes, from the model."""
    plant = Mechanism()
    plant.start(np.zeros((1, 4)))
    period, ticks = 0.002, 2
    amplitude = math.radians(8)
    omega = math.sqrt(7 / amplitude)
    t = np.arange(0, 4, period)
    begin = np.minimum(t / 2, 1)
    begin = begin**3 * (10 - 15 * begin + 6 * begin**2)
    plate = amplitude * begin[:, None] * np.stack([np.sin(omega * t), np.cos(omega * t)], axis=-1)
    motor = CamTable.from_file(model_path("cams.json")).motor(plate)
    peak = 0.0
    columns = [plant.channels.index(f"torque_{axis}_Nm") for axis in ("phi", "theta")]
    for rate in np.diff(motor, axis=0) / period:
        plant.advance(rate[None], ticks)
        peak = max(peak, float(np.abs(plant.telemetry()[0, columns]).max()))
    return peak


def test_the_torque_limit_leaves_the_plate_half_as_much_again_and_the_motor_cool():
    config = AkdConfig()
    peak = torque_of_the_hardest_motion()
    assert peak > 2.0
    assert 1.5 * peak < config.torque_limit < config.motor_torque


@pytest.mark.parametrize(("gear", "amperes"), [(1.0, 2.0), (2.0, 1.0)])
def test_the_current_is_that_of_the_torque_at_the_cam_shaft(gear, amperes):
    axes = (AxisConfig(name="phi", node=1, gear=gear), AxisConfig(name="theta", node=2))
    with SteppedDrives(AkdConfig(axes=axes, torque_limit=3.0)) as rig:
        rig.servos.start()
        store = rig.drives[0].store
    torque = store.get(0x356E) / 1000 * store.get(0x3593) / 1000 * gear
    assert 3.0 <= torque <= 3.0 + 0.1 * 1.523 * gear
    assert store.get(0x356E) == pytest.approx(1000 * amperes, abs=100)
    assert store.get(0x356F) == -store.get(0x356E)


@pytest.mark.parametrize(
    ("index", "value", "words"),
    [
        (0x3593, 100, "0.3 N m, the motor's continuous torque is 4.57"),
        (0x3593, 1_523_000, "choose the motor in the drive"),
        (0x358E, 3, "set drives.motor_torque"),
        (0x356E, 9, "do not count alike"),
    ],
)
def test_a_drive_that_does_not_know_its_motor_is_refused(index, value, words):
    with SteppedDrives() as rig:
        rig.drives[0].store.set(index, 0, value)
        assert words in refused(rig)


def test_another_motor_may_be_named():
    with SteppedDrives(AkdConfig(motor_torque=9.0)) as rig:
        for drive in rig.drives:
            drive.store.set(0x3593, 0, 3000)
        rig.servos.start()
        assert rig.drives[0].store.get(0x356E) == 1500
