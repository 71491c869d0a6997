"""`twin.devices.akd.drive_units`.

Units, limits and ramps: computed from what the drive says, or refused with the line to set."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stepped import SteppedDrives, refused

from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.akd.drive_units import DriveQuantity
from twin.devices.akd.protocol import RPM_RAD_S
from twin.emulator.drive import EmulatedDrive

SPEED, RAMP = 6000, 30_000
"""A motor's speed limit in rpm, and a ramp in rpm/s."""
WHOLE = {"limit_unit": RPM_RAD_S, "acceleration_unit": RPM_RAD_S}
"""What makes a drive start that counts whole units."""


def drives(per_unit=1000):
    """Two drives with so many counts to rpm and rpm/s, set as a motor wants it."""
    made = []
    for node in (1, 2):
        drive = EmulatedDrive(node, parameter_count=1 / per_unit)
        found = {0x3622: round(SPEED * per_unit), 0x3623: -round(SPEED * per_unit)}
        found |= dict.fromkeys((0x3501, 0x3522, 0x6083, 0x6084), round(RAMP * per_unit))
        for index, value in found.items():
            drive.store.set(index, 0, value)
        made.append(drive)
    return made


def held(rig):
    """Rate in rad/s at which the first drive holds a command above its limit, and its ramp."""
    rig.servos.axes[0].target = 6.0
    rig.servos.send()
    rates = []
    for _ in range(40):
        rig.adapter.sleep(0.0005)
        rates.append(rig.drives[0].rate)
    ramp = max(b - a for a, b in zip([0.0, *rates], rates, strict=False)) / 0.0005
    return rates[-1], ramp


@pytest.mark.parametrize(("per_unit", "named"), [(1000, {}), (1, WHOLE)])
def test_limit_and_ramp_hold_in_the_drive_s_own_counts_with_the_lines_named(per_unit, named):
    axes = tuple(replace(axis, **named) for axis in AkdConfig().axes)
    config = AkdConfig(axes=axes, rate_limit=2.0, ramp=100.0)
    with SteppedDrives(config, drives(per_unit)) as rig:
        rig.enabled()
        rate, ramp = held(rig)
    assert 2.0 <= rate <= 2.2
    assert 100.0 <= ramp <= 110.0
    assert " rpm," in rig.servos.found[0].limits
    assert "rpm/s (3659h)" in rig.servos.found[0].units


@pytest.mark.parametrize("unit", [1, 2, 3, 4])
@pytest.mark.parametrize(
    ("index", "line"),
    [
        (0x365F, "UNIT.VROTARY (365Fh) is {}; set it to 0 (rpm)"),
        (0x3659, "UNIT.ACCROTARY (3659h) is {}; set it to 0 (rpm/s)"),
    ],
)
def test_a_drive_in_another_unit_is_refused_with_the_line_that_sets_it(unit, index, line):
    made = drives()
    made[0].store.set(index, 0, unit)
    with SteppedDrives(drives=made) as rig:
        assert line.format(unit) in refused(rig)


def test_a_drive_that_counts_whole_units_is_refused_with_the_line_to_change():
    with SteppedDrives(drives=drives(1)) as rig:
        text = refused(rig)
    assert "VL.LIMITP (3622h) holds 6000, which would be 6 rpm" in text
    assert f"if it is 6000 rpm, set phi.limit_unit = {RPM_RAD_S:.9g}" in text


def test_the_ramps_of_a_drive_that_counts_whole_units_are_refused_too():
    axes = (AxisConfig(name="phi", node=1, limit_unit=RPM_RAD_S), AxisConfig(name="theta", node=2))
    with SteppedDrives(AkdConfig(axes=axes), drives(1)) as rig:
        text = refused(rig)
    assert "DRV.ACC (3501h)" in text
    assert f"set phi.acceleration_unit = {RPM_RAD_S:.9g}" in text


def test_a_unit_too_coarse_for_the_limit_is_refused():
    axes = tuple(
        AxisConfig(name=name, node=node, limit_unit=2 * math.pi, acceleration_unit=2 * math.pi)
        for node, name in ((1, "phi"), (2, "theta"))
    )
    with SteppedDrives(AkdConfig(axes=axes), drives(per_unit=1 / 60)) as rig:
        assert "too coarse" in refused(rig)


@given(st.floats(1.0, 20.0))
def test_what_is_sent_is_round_in_the_drive_s_unit_and_never_below_what_is_wanted(wanted):
    speed = DriveQuantity("rpm", RPM_RAD_S / 1000, "limit_unit")
    counts = speed.counts(wanted)
    assert wanted * (1 - 1e-9) <= counts * speed.scale <= 1.1 * wanted + speed.scale
    assert len(str(counts).rstrip("0")) <= 2
