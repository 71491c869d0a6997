"""`twin.doctor.calibrate`: The slow triangle on emulated drives, in bus time."""

import numpy as np
import pytest
from stepped import SteppedDrives

from twin.base.errors import RigError
from twin.doctor.calibrate import measure_lost_motion
from twin.emulator.serve import EmulatedPlant
from twin.hal.cams import CamTable
from twin.scenario import load


def measured(*overrides, amplitude=0.4, rate=3.0, act=lambda rig: None):
    plant = EmulatedPlant(load("circle", overrides))
    with SteppedDrives() as rig:
        plant.attach(rig.drives)
        rig.bus.moved = plant.advance
        act(rig)
        return measure_lost_motion(
            rig.servos,
            CamTable.packaged(),
            amplitude=np.radians(amplitude),
            rate=np.radians(rate),
            cycles=2,
        )


@pytest.mark.long
def test_the_play_put_into_a_rig_is_found_on_both_axes_without_a_fault():
    for axis, found in zip(
        ("phi", "theta"), measured("plant.servo.backlash_deg=0.44"), strict=True
    ):
        assert found.axis == axis
        assert found.shape == "flat"
        # far faster than shipped: the plate rings
        assert found.width == pytest.approx(0.44, abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize(
    ("key", "width", "shape", "within"),
    [
        ("plant.servo.hysteresis_deg", 0.3, "round", 0.003),
        ("plant.servo.backlash_deg", 0.3, "flat", 0.001),
        ("plant.servo.backlash_deg", 0.0, "none", 0.002),
        # 6 N m over a wheel's spring of 80 kN/m on a lever of 0.16 m
        ("plant.plate.joint_friction", np.degrees(6 / (8e4 * 0.16**2)), "flat", 0.003),
    ],
)
def test_as_shipped_the_triangle_finds_what_was_put_in(key, width, shape, within):
    given = 3.0 if key == "plant.plate.joint_friction" else width
    for found in measured(f"{key}={given}", amplitude=1.0, rate=1.0):
        assert found.shape == shape
        assert found.width == pytest.approx(width, abs=within)


def test_drives_that_go_off_on_the_way_end_it_in_one_line():
    def fail(rig):
        def moved(seconds, inner=rig.bus.moved):
            inner(seconds)
            if rig.drives[1].enabled:
                rig.drives[1].fail(129)

        rig.bus.moved = moved

    with pytest.raises(RigError, match="the triangle was stopped: drive theta"):
        measured(act=fail)
