"""`twin.devices.akd.config`.

A wrong sign, scale or exchange on an emulated rig in bus time: what the plate truly does."""

from dataclasses import replace

import numpy as np
import pytest

from twin.devices.akd.conditions import CONTRADICTION
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.rig import FIRST_MOTION_RATE_RAD_S, UNCHECKED
from twin.emulator.drive import EmulatedDrive
from twin.emulator.lockstep import LockstepRig, MotionTrace
from twin.emulator.serve import STOP_MARGIN_RAD, EmulatedPlant
from twin.hal.agreement import DRIVES_EXCHANGED, EXCHANGED, OPPOSITE, WRONG_RATIO
from twin.hal.interface import Severity
from twin.hal.supervisor import Event, State
from twin.scenario import load

PLANT = ("plant.kind=lagrange",)
COURSE = ("parameters=course", *PLANT)
COUNTS = 245760


def configured(period, axis, **wrong):
    axes = [AxisConfig(name="phi", node=1), AxisConfig(name="theta", node=2)]
    for index in (0, 1) if axis is None else (axis,):
        axes[index] = replace(axes[index], **wrong)
    return AkdConfig(axes=tuple(axes), period=period)


def turned(rig, rate, seconds=0.6):
    """The largest true tilt, rad, while the controller asks for a rate; what stopped it."""
    trace = MotionTrace(rig)
    with rig:
        rig.start()
        for tick in range(round(seconds / rig.period)):
            rig.read()
            rig.write(np.array([rate]) * min(1.0, tick * rig.period / 0.1))
            rig.wait()
            if rig.supervisor.state[0] == State.FAULT:
                break
        rig.read()
        stopped = [
            entry.note for entry in rig.journal if entry.note.condition.severity != "warning"
        ]
        if stopped:
            rig.sleep(0.2)
    return trace.between(0.0).tilt.max(), stopped[0].condition if stopped else None


def stop_text(rig):
    """The first condition that stopped a rig, in words."""
    return next(
        each.note.text for each in rig.journal if each.note.condition.severity == Severity.STOP
    )


SIGNS = [
    (axis, wrong, OPPOSITE)
    for axis in (0, 1, None)
    for wrong in ({"plate_sign": -1}, {"motor_sign": -1})
]
SCALES = [
    (0, {"plate_counts": COUNTS * 2}, WRONG_RATIO),
    (1, {"plate_counts": COUNTS // 2}, WRONG_RATIO),
    (1, {"plate_counts": COUNTS * 3 // 2}, WRONG_RATIO),
    (0, {"gear": 2.0}, WRONG_RATIO),
    (None, {"gear": 0.5}, WRONG_RATIO),
]


FEW = [(0.002, *SIGNS[0]), (0.001, *SIGNS[3]), (0.004, *SIGNS[4]), (0.002, *SCALES[0])]
FEW += [(0.004, *SCALES[1]), (0.002, *SCALES[3])]
MORE = [(period, *each) for period in (0.001, 0.002, 0.004) for each in (*SIGNS, *SCALES)]
LONG = [pytest.param(*each, marks=pytest.mark.long) for each in MORE if each not in FEW]


@pytest.mark.short("0.004-*")
@pytest.mark.parametrize(("period", "axis", "wrong", "condition"), [*FEW, *LONG])
def test_a_wrong_setting_is_named_and_the_plate_stays_near_its_limit(
    period, axis, wrong, condition, scenario
):
    chosen = scenario(*PLANT, f"rig.period={period}")
    tilt, stopped = turned(
        LockstepRig(chosen, config=configured(period, axis, **wrong)), (0.5, -0.3)
    )
    assert stopped is condition
    assert tilt < float(np.radians(12.0))
    if condition is OPPOSITE:
        assert tilt < np.radians(1.0)


@pytest.mark.short("1-*")
@pytest.mark.parametrize(("axis", "factor", "words"), [(0, 2.0, "0.5"), (1, 0.5, "2.0")])
def test_a_wrong_velocity_unit_is_named_by_its_ratio(axis, factor, words, scenario):
    unit = factor * AxisConfig(name="phi", node=1).velocity_unit
    rig = LockstepRig(scenario(*PLANT), config=configured(0.002, axis, velocity_unit=unit))
    tilt, stopped = turned(rig, (0.5, 0.5), 1.0)
    assert stopped is CONTRADICTION
    assert f"turns {words} times as far as the velocity: check velocity_unit" in stop_text(rig)
    assert tilt < np.radians(12.0)


WIRES = {
    "encoders": ({"encoders": (1, 0)}, EXCHANGED),
    "motors": ({"motors": (1, 0)}, EXCHANGED),
    "slip": ({"slip": (0.6, 0.0)}, WRONG_RATIO),
    "motor scale": ({"motor_scale": (1.0, 2.0)}, WRONG_RATIO),
}


MECHANISMS = [
    pytest.param(PLANT, id="cams"),
    pytest.param(COURSE, id="rods", marks=pytest.mark.long),
]


@pytest.mark.parametrize("on", MECHANISMS)
@pytest.mark.parametrize("wire", WIRES)
def test_a_wrong_wire_is_named_on_cams_and_on_rods(wire, on):
    wiring, condition = WIRES[wire]
    rig = LockstepRig(load("circle", on))
    rig.plant.wiring = rig.plant.wiring._replace(**wiring)
    tilt, stopped = turned(rig, (0.5, -0.3))
    assert stopped is condition
    assert tilt < float(rig.supervisor.limits.angle) + np.radians(2.0)


@pytest.mark.long
@pytest.mark.parametrize("on", MECHANISMS)
def test_exchanged_drives_are_named_by_where_the_ball_rolls_and_the_plate_is_levelled(on):
    rig = LockstepRig(load("circle", on))
    rig.plant.wiring = rig.plant.wiring._replace(encoders=(1, 0), motors=(1, 0))
    trace = MotionTrace(rig)
    with rig:
        rig.start()
        while rig.supervisor.state[0] == State.RUNNING and rig.clock.time < 2:
            rig.read()
            rig.write(
                np.radians([[6 * np.cos(4 * rig.clock.time), 2 * np.sin(3 * rig.clock.time)]])
            )
            rig.wait()
        assert rig.supervisor.state[0] == State.HOLDING
        assert DRIVES_EXCHANGED.name in rig.supervisor.reason[0]
    motion = trace.between(0.0)
    assert np.degrees(motion.tilt.max()) < 4.0
    assert np.degrees(motion.tilt[-1]) < 0.3


def test_a_healthy_rig_turns_as_it_is_asked(scenario):
    tilt, stopped = turned(LockstepRig(scenario(*PLANT)), (0.2, -0.1))
    assert stopped is None
    assert tilt == pytest.approx(0.55 * 0.2, rel=0.1)


@pytest.mark.long
def test_levelling_that_tilts_the_plate_further_is_ended(scenario):
    rig = LockstepRig(scenario(*PLANT))
    rig._motors.lost = np.inf  # the second line of defence alone
    with rig:
        rig.start()
        for _ in range(100):
            rig.read()
            rig.write(np.array([[0.3, 0.0]]))
            rig.wait()
        rig.plant.rewire(encoder_scale=(-1.0, 1.0))
        rig.supervisor.handle(Event.LEVEL)
        for _ in range(400):
            rig.read()
            rig.write(np.zeros((1, 2)))
            rig.wait()
        assert rig.supervisor.state[0] == State.FAULT
        assert "levelled" in rig.supervisor.reason[0]
        assert np.degrees(np.abs(rig.plant.devices.state[0, 2::4]).max()) < 6.0


def test_a_plate_stops_at_its_mechanical_stop_and_its_motor_with_it(scenario):
    plant, drives = EmulatedPlant(scenario(*PLANT)), [EmulatedDrive(1), EmulatedDrive(2)]
    plant.attach(drives)
    stop = plant.stop
    assert stop == pytest.approx(np.radians(10.0) + STOP_MARGIN_RAD)
    for _ in range(500):
        drives[0].motor.rate, drives[1].motor.rate = 1.0, -1.0
        plant.advance(0.001)
    assert plant.devices.state[0, 2::4] == pytest.approx([stop, -stop], abs=0.002)
    assert [drive.rate for drive in drives] == [0.0, 0.0]
    drives[0].motor.rate = -1.0
    plant.advance(0.1)
    assert plant.devices.state[0, 2] < stop - 0.05


@pytest.mark.short("never checked")
@pytest.mark.parametrize("unchecked", ["", "never checked"])
def test_the_first_motion_of_a_rig_that_nobody_has_checked_is_slow_until_it_is_proven(
    unchecked, scenario
):
    rig = LockstepRig(scenario(*PLANT))
    rig.unchecked = unchecked
    rates = []
    with rig:
        rig.start()
        for _ in range(250):
            rig.read()
            rates.append(np.abs(rig.write(np.array([[0.3, -0.3]]))).max())
            rig.wait()
    noted = [each.note.text for each in rig.journal if each.note.condition is UNCHECKED]
    assert noted == ([f"rig file: first motion slow: {unchecked}"] if unchecked else [])
    proven = next(k for k, rate in enumerate(rates) if rate > FIRST_MOTION_RATE_RAD_S + 1e-9)
    angle = rig.period * sum(rates[:proven])
    if unchecked:
        assert angle == pytest.approx(np.radians(2.0), rel=0.1)
    assert rates[-1] == pytest.approx(0.3)


def test_a_disagreement_takes_the_torque_of_both_drives_while_the_host_goes_on(scenario):
    rig = LockstepRig(scenario(*PLANT), config=configured(0.002, 0, plate_sign=-1))
    after = 0
    with rig:
        rig.start()
        while after < 25:  # 50 ms, and the host's heartbeat goes on
            rig.read()
            rig.write(np.array([[0.5, -0.3]]))
            rig.wait()
            after += rig.supervisor.state[0] == State.FAULT
            assert rig.now() < 5
        assert not any(drive.power.live for drive in rig.lockstep.drives)


@pytest.mark.long
def test_motors_and_plate_are_compared_anew_by_another_transmission(scenario):
    rig = LockstepRig(scenario(*PLANT))
    with rig:
        rig.start()
        for _ in range(200):
            rig.read()
            rig.write(np.array([[0.2, -0.2]]))
            rig.wait()
        assert rig._motors.proven
        rig.replace_transmission(rig.plant.transmission)
        assert not rig._motors.proven
        rig.read()
    assert Severity.STOP not in {each.note.condition.severity for each in rig.journal}


@pytest.mark.long
def test_an_axis_that_never_turns_keeps_the_first_motion_slow_for_three_seconds(scenario):
    rig = LockstepRig(scenario(*PLANT, "duration=4"))
    rig.unchecked = "never checked"
    fastest = []
    with rig:
        rig.start()
        for tick in range(1700):
            rig.read()
            way = 0.5 if tick // 50 % 4 in {0, 3} else -0.5
            fastest.append(abs(rig.write(np.array([[way, 0.0]]))[0, 0]))
            rig.wait()
    assert max(fastest[:1499]) <= FIRST_MOTION_RATE_RAD_S + 1e-9
    assert max(fastest[1510:]) > 1.5 * FIRST_MOTION_RATE_RAD_S
    assert Severity.STOP not in {each.note.condition.severity for each in rig.journal}
