"""`twin.doctor.drives`.

The doctor on emulated devices: in bus time where it can, on the wire once."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from stepped import SteppedDrives

import ballplate as bp
from twin.base.shipped import model_path
from twin.cli.rig import doctor
from twin.devices.akd.conditions import WRONG_SETTING, DriveError
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.doctor import drives
from twin.doctor.calibrate import measure_cams
from twin.doctor.check import (
    CheckStatus,
    fail_check,
    next_step,
    pass_check,
    report_errors,
    warn_check,
)
from twin.doctor.computer import ComputerCheck, computer
from twin.doctor.drives import limits
from twin.doctor.examine import _drives
from twin.emulator.drive import EmulatedDrive
from twin.emulator.lockstep import LockstepRig
from twin.emulator.serve import EmulatedPlant
from twin.hal.cams import CamTable, FixedRatio
from twin.run.finished import record_run, run
from twin.scenario import load
from twin.scenario.rig import check_rig

RIG = check_rig({"touch": {"port": "/dev/null"}}, "test")


@pytest.fixture
def rig():
    with SteppedDrives() as rig:
        yield rig


def by_name(results):
    return {result.what: result for result in results}


def examined(config=None, act=lambda rig: None):
    with SteppedDrives(config) as rig:
        act(rig)
        found = list(drives.bus(rig.servos.config, rig.servos))
        if rig.servos.axes:
            found += drives.torque(rig.servos)
            found += limits(rig.servos)
            found += drives.motion(rig.servos, FixedRatio(5.0))
        return by_name(found)


def tried(rig):
    """What is said of limits that are tried after the bus was examined."""
    list(drives.bus(rig.servos.config, rig.servos))
    return by_name(limits(rig.servos))


def test_healthy_drives_pass_every_check():
    found = examined()
    assert {result.status for result in found.values()} == {CheckStatus.PASS}
    assert "stopped by themselves" in found["heartbeat"].seen
    assert found["phi encoder"].seen.endswith("exchange phi.node and theta.node")
    drive = "drive phi (node 1)"
    assert found[f"{drive} limits"].seen == "speed 77 rpm, ramps 20000 rpm/s, torque 4.57 N m (3 A)"
    assert "limits in rpm (365Fh), 0.001 rpm a count" in found[f"{drive} units"].seen


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"plate_sign": -1}, "wrong way"),
        ({"motor_sign": -1}, "wrong way"),
        ({"plate_counts": 65536}, "check phi.plate_counts"),
        ({"plate_counts": 4096}, "check phi.plate_counts"),
    ],
)
def test_a_wrong_direction_or_scale_fails_and_names_what_to_change(changes, advice):
    phi, theta = AkdConfig().axes
    found = examined(AkdConfig(axes=(replace(phi, **changes), theta)))
    assert found["phi encoder"].status is CheckStatus.FAIL
    assert advice in found["phi encoder"].advice
    assert found["theta encoder"].status is CheckStatus.PASS


def test_a_drive_that_goes_on_without_heartbeat_fails(rig):
    list(drives.bus(rig.servos.config, rig.servos))
    for drive in rig.drives:
        drive.store.set(0x1016, 1, 0)
    found = by_name(drives.torque(rig.servos))
    assert found["heartbeat"].status is CheckStatus.FAIL


def test_a_result_keeps_its_keys_in_json():
    assert warn_check("timer", "late", "close other programs").as_dict() == {
        "what": "timer",
        "verdict": "warn",
        "seen": "late",
        "advice": "close other programs",
    }


def test_an_absent_drive_is_named_with_what_to_do():
    found = examined(act=lambda rig: rig.bus.drives.pop())
    (result,) = found.values()
    assert result.status is CheckStatus.FAIL
    assert "drive theta (node 2)" in result.seen
    assert result.advice


@pytest.mark.long
@pytest.mark.parametrize("late", [0.02, 0.08])
def test_the_dead_time_of_a_rig_on_the_wire_is_identified_to_5_ms(late, tmp_path):
    chosen = load("excite", [f"sensors.touch.dead_time={late}", "plant.kind=lagrange"])
    record_run(run(chosen, rig=LockstepRig(chosen)), tmp_path)
    found = bp.identify(tmp_path).settings["sensors"]["touch"]["dead_time"]
    assert abs(found - late) < 0.005


BRIEF = ComputerCheck(timer_s=0.1)


@pytest.mark.usefixtures("unlocked")
def test_what_can_be_said_of_the_computer_and_the_rig_file_is_said(scenario, tmp_path):
    found = by_name(computer(scenario(), RIG, BRIEF))
    assert "plate_counts" in found["settings of the drives"].seen
    by_hand = found["to be looked at by hand"].seen
    assert all(word in by_hand for word in ("DRV.TYPE", "DRV.CMDSOURCE", "60 ohm"))
    names = ("safety nets", "bus load", "cam table")
    assert [found[name].status for name in names] == ["pass", "pass", "warn"]
    file, true = tmp_path / "measured.json", CamTable.from_file(model_path("cams.json"))
    CamTable(true.grid, true.angles, {"made": "measured on a rig"}).save(file)
    other = {"drives": {"watch": {"stale": 100}}, "bus": {"bitrate": 500_000}, "cams": str(file)}
    rig = check_rig({"touch": {"port": "x"}, **other}, "test")
    found = by_name(computer(scenario(), rig, BRIEF))
    assert [found[name].status for name in names] == ["warn", "warn", "pass"]
    assert "drives.watch.stale = 100" in found["safety nets"].seen


@pytest.mark.long
@pytest.mark.real_time
def test_on_the_wire_nothing_fails_but_what_a_busy_machine_may_spoil():
    done = CliRunner().invoke(doctor, ["--json"], standalone_mode=False)
    found = json.loads(done.stdout)
    passed = {each["what"] for each in found if each["verdict"] == "pass"}
    assert passed >= {"touch protocol", "lift-off", "drive phi (node 1)"}, found
    assert done.return_value == 0, found


@pytest.mark.long
def test_the_cams_of_a_rig_are_measured_to_two_counts_of_its_encoders(rig):
    quiet = ("disturbance.variance=[0,0]", "plant.friction.rolling_mm=0")
    plant = EmulatedPlant(load("circle", quiet))
    true = CamTable.from_file(model_path("cams.json"))
    wrong = CamTable(true.grid, 1.04 * true.angles + 0.01 * true.angles[..., ::-1] ** 2)
    plant.attach(rig.drives)
    rig.bus.moved = plant.advance
    found = measure_cams(rig.servos, wrong, reach=np.radians(5), lines=5)
    assert found.provenance["before_deg"] > 0.15
    plate = np.radians(np.stack(np.meshgrid([-4, 0, 3], [-3, 0, 4]), axis=-1))
    off = (found.motor(plate) - true.motor(plate)) / true.ratio
    assert np.degrees(np.abs(off).max()) < 2 * 360 / 245760


@pytest.mark.long
@pytest.mark.parametrize(
    ("index", "value", "what", "advice"),
    [
        (0x36E5, 0, "FBUS.PARAM01 (bit rate)", "set it to 1000"),
        (0x36E5, 500, "FBUS.PARAM01 (bit rate)", "set it to 1000"),
        (0x3506, 0, "DRV.HWENMODE", "set it to 1"),
        (0x3498, 0, "FBUS.PROTECTION", "keep WorkBench closed"),
    ],
)
def test_a_precondition_in_the_drive_is_a_warning_with_what_to_set(index, value, what, advice):
    found = examined(act=lambda rig: rig.drives[0].store.set(index, 0, value))
    result = found[f"drive phi (node 1) {what}"]
    assert result.status is CheckStatus.WARN
    assert advice in result.advice
    assert found[f"drive theta (node 2) {what}"].status is CheckStatus.PASS


@pytest.mark.long
def test_a_drive_without_such_a_setting_is_brought_up_all_the_same():
    def older(rig):
        rig.drives[0].sdo_aborts[0x3506, 0] = 0x06020000

    found = examined(act=older)
    assert "drive phi (node 1) DRV.HWENMODE" not in found
    assert found["phi encoder"].status is CheckStatus.PASS


def test_a_drive_whose_rate_comes_once_is_not_judged_by_it():
    watch = MonitorConfig(stale=200, unsteady=51)
    with SteppedDrives(AkdConfig(watch=watch)) as rig:
        rig.bus.faults.drop(0x281)
        found = by_name(limits(rig.servos))
    assert found["phi limits"].status is CheckStatus.WARN
    assert "too irregular" in found["phi limits"].seen


def test_a_refusal_after_the_limits_were_tried_is_a_line(monkeypatch, rig):
    start = rig.servos.start

    def once():
        monkeypatch.setattr(rig.servos, "start", refuse)
        start()

    def refuse():
        raise DriveError(WRONG_SETTING, "drive phi", "keeps something else")

    monkeypatch.setattr(rig.servos, "start", once)
    last = list(report_errors(limits(rig.servos), "limits"))[-1]
    assert last.status is CheckStatus.FAIL
    assert "keeps something else" in last.seen


@pytest.mark.long
def test_plate_encoders_plugged_crosswise_are_named(scenario, rig):
    chosen = scenario("plant.kind=lagrange", "disturbance.variance=[0,0]")
    plant, seen = EmulatedPlant(chosen), {}
    phi, theta = (drive.motor.sense for drive in rig.drives)

    def first(shaft, angle):
        seen["phi"] = shaft, angle

    def second(shaft, angle):
        phi(seen["phi"][0], angle)
        theta(shaft, seen["phi"][1])

    rig.drives[0].motor.sense, rig.drives[1].motor.sense = first, second
    plant.attach(rig.drives)
    rig.bus.moved = plant.advance
    list(drives.bus(rig.servos.config, rig.servos))
    found = by_name(drives.motion(rig.servos, plant.transmission))
    assert found["phi encoder"].status is CheckStatus.FAIL
    assert "moving phi turned theta's encoder" in found["phi encoder"].seen
    assert "exchange the plugs" in found["phi encoder"].advice


def test_the_doctor_ends_with_ready_or_the_next_step():
    good, doubt = pass_check("a", "fine"), warn_check("b", "old", "measure it again")
    bad = fail_check("c", "no DC link", "switch the main supply on")
    unmoved = next_step([good, doubt], "rig.toml", move=False)
    assert unmoved.startswith("not ready: the checks that move the plate are left; next step: ")
    assert unmoved.endswith("doctor --rig rig.toml --move")
    assert next_step([good], "rig.toml", move=True).startswith("ready: put the ball on")
    assert "1 reservation above" in next_step([good, doubt], "rig.toml", move=True)
    told = next_step([good, bad, fail_check("d", "x", "y")], "rig.toml", move=True)
    assert told == "not ready; next step (c): switch the main supply on"


def test_a_fault_is_reset_on_request_without_leave_to_move(rig):
    rig.drives[0].fail(129)
    found = list(_drives(rig.servos, RIG, move=False, reset=True))
    fault = by_name(found)["drive phi (node 1) fault"]
    assert fault.seen.startswith("F129 CAN monitoring")
    assert "--reset" in fault.advice
    assert rig.drives[0].power.faults == []
    assert not any(drive.enabled for drive in rig.drives)


# The doctor tries the drives' limits of speed and acceleration on emulated drives


@pytest.mark.parametrize("parameter_count", [1.0, 1e-5])
def test_a_limit_that_counts_otherwise_than_believed_is_found_by_asking_for_more(parameter_count):
    """The drive's found values lie: set in counts of 0.001 rpm, though it counts otherwise."""
    made = [EmulatedDrive(node, parameter_count=parameter_count) for node in (1, 2)]
    with SteppedDrives(drives=made) as rig:
        found = tried(rig)
    assert found["phi limits"].status is CheckStatus.FAIL
    assert "limit_unit" in found["phi limits"].advice


def test_a_ramp_that_counts_otherwise_than_believed_is_found(monkeypatch, rig):
    for drive in rig.drives:
        drive.store.live(0x6083, 0, lambda: 500_000_000)
        drive.store.live(0x6084, 0, lambda: 500_000_000)
    monkeypatch.setattr("twin.devices.akd.protocol.is_kept", lambda *_: True)
    found = tried(rig)
    assert "acceleration_unit" in found["phi limits"].advice


def test_after_the_limits_were_tried_the_usual_ones_hold_again(rig):
    found = tried(rig)
    assert {each.status for each in found.values()} == {CheckStatus.PASS}
    assert "(bit 11) shown" in found["phi limits"].seen
    assert [drive.store.get(0x3622) for drive in rig.drives] == [77_000] * 2
    assert not any(drive.enabled for drive in rig.drives)


def test_limits_are_not_judged_from_answers_with_gaps(rig):
    list(drives.bus(rig.servos.config, rig.servos))
    sleep, slept = rig.servos.sleep, [0]

    def slow(seconds):
        slept[0] += 1
        sleep(seconds if slept[0] % 10 else 0.015)

    rig.servos.sleep = slow
    found = by_name(limits(rig.servos))
    assert found["phi limits"].status is CheckStatus.WARN
    assert "too irregular to judge" in found["phi limits"].seen


def test_a_fault_while_the_limits_are_tried_is_called_by_its_name(rig):
    moved = rig.bus.moved

    def fail(dt):
        moved(dt)
        if rig.drives[0].rate > 1.0:
            rig.drives[0].fail(235)

    rig.bus.moved = fail
    found = tried(rig)
    assert "drive fault" in found["phi limits"].seen
