"""The doctor tries the drives' limits of speed and acceleration on emulated drives."""

import pytest
from stepped import SteppedDrives

from twin.doctor import drives
from twin.doctor.check import CheckStatus
from twin.doctor.drives import limits
from twin.emulator.drive import EmulatedDrive


@pytest.mark.parametrize("parameter_count", [1.0, 1e-5])
def test_a_limit_that_counts_otherwise_than_believed_is_found_by_asking_for_more(parameter_count):
    """The drive's found values lie: set in counts of 0.001 rpm, though it counts otherwise."""
    made = [EmulatedDrive(node, parameter_count=parameter_count) for node in (1, 2)]
    with SteppedDrives(drives=made) as rig:
        list(drives.bus(rig.servos.config, rig.servos))
        found = {each.what: each for each in limits(rig.servos)}
    assert found["phi limits"].status is CheckStatus.FAIL
    assert "limit_unit" in found["phi limits"].advice


def test_a_ramp_that_counts_otherwise_than_believed_is_found(monkeypatch):
    with SteppedDrives() as rig:
        for drive in rig.drives:
            drive.store.live(0x6083, 0, lambda: 500_000_000)
            drive.store.live(0x6084, 0, lambda: 500_000_000)
        monkeypatch.setattr("twin.devices.akd.protocol.kept", lambda *_: True)
        list(drives.bus(rig.servos.config, rig.servos))
        found = {each.what: each for each in limits(rig.servos)}
    assert "acceleration_unit" in found["phi limits"].advice


def test_after_the_limits_were_tried_the_usual_ones_hold_again():
    with SteppedDrives() as rig:
        list(drives.bus(rig.servos.config, rig.servos))
        found = list(limits(rig.servos))
        assert {each.status for each in found} == {CheckStatus.PASS}
        assert "(bit 11) shown" in found[0].seen
        assert [drive.store.get(0x3622) for drive in rig.drives] == [77_000] * 2
        assert not any(drive.enabled for drive in rig.drives)


def test_limits_are_not_judged_from_answers_with_gaps():
    with SteppedDrives() as rig:
        list(drives.bus(rig.servos.config, rig.servos))
        sleep, slept = rig.servos.sleep, [0]

        def slow(seconds):
            slept[0] += 1
            sleep(seconds if slept[0] % 10 else 0.015)

        rig.servos.sleep = slow
        found = {each.what: each for each in limits(rig.servos)}
    assert found["phi limits"].status is CheckStatus.WARN
    assert "too irregular to judge" in found["phi limits"].seen


def test_a_fault_while_the_limits_are_tried_is_called_by_its_name():
    with SteppedDrives() as rig:
        list(drives.bus(rig.servos.config, rig.servos))
        moved = rig.bus.moved

        def fail(dt):
            moved(dt)
            if rig.drives[0].rate > 1.0:
                rig.drives[0].fail(235)

        rig.bus.moved = fail
        found = {each.what: each for each in limits(rig.servos)}
    assert "drive fault" in found["phi limits"].seen
