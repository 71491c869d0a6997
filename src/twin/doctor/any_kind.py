"""Checks of devices of any kind, and of own hardware: that they start, measure and tilt."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from twin.base.errors import RigError
from twin.devices.own import OwnServos
from twin.devices.own_hardware import Reading
from twin.devices.rig import HardwareRig
from twin.doctor import drives
from twin.doctor.check import CheckResult, fail_check, pass_check, report_errors, warn_check
from twin.hal.cams import FixedRatio
from twin.hal.interface import FaultSource, Severity, Transmission
from twin.run.connect import connect, transmission_of
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario

MOVE_ADVICE = "hands off, then: ballplate doctor --move"
ANY_KIND_ADVICE = "fix its class or its package (docs/your-rig.md)"


@dataclass(frozen=True, kw_only=True)
class DeviceCheck:
    """How devices of any kind are checked.

    Attributes:
        watch_s: Time in s for which measurements are watched.
        min_measurements: Smallest number of measurements in that time.
        min_ball_share: Smallest share of the measurements that have the ball.
        tilt_rad: Angle in rad by which each axis is tilted.
        tilt_s: Time in s of each motion, there and back, and of the rest between.
        max_tilt_error: Largest relative error of the measured tilt.
    """

    watch_s: float = 2.0
    min_measurements: int = 3
    min_ball_share: float = 0.5
    tilt_rad: float = math.radians(1.0)
    tilt_s: float = 0.5
    max_tilt_error: float = 0.4


DEVICE_CHECK = DeviceCheck()


def any_screen(
    scenario: Scenario, rig: RigFile, check: DeviceCheck = DEVICE_CHECK
) -> Iterator[CheckResult]:
    """Check a screen of any kind: that it starts, how often it measures, where the ball is.

    Args:
        scenario: Its period and limits.
        rig: Its file; the servos are not used.
        check: Constants of the check.

    Raises:
        TwinError: The screen cannot be used, or reports a fault.
    """
    real = connect(scenario, rig)
    screen, level, seen = real.screen, np.zeros((1, 2)), list[Reading]()
    try:
        screen.start()
        kind = rig.kinds["touch"].name
        yield pass_check("touch screen", f"{screen.where} of kind '{kind}' starts")
        real.clock.start()
        begun, periods, touched = real.servos.now(), round(check.watch_s / real.period), 0
        for _ in range(periods):
            real.clock.wait()
            screen.receive()
            screen.note_plate(level)
            touch = screen.read()
            _raise_fault(screen)
            if not touch.touched[0]:
                continue
            touched += 1
            at = real.servos.now() - float(touch.age[0])
            if not seen or at - seen[-1].at > real.period / 2:
                x, y = touch.position[0].tolist()
                seen.append(Reading(x, y, at))
        if touched < check.min_ball_share * periods:
            yield _no_ball(touched / periods, "the time")
        else:
            yield from _check_measurements(seen, real.servos.now() - begun, check)
    finally:
        screen.stop()


def any_servos(
    scenario: Scenario,
    rig: RigFile,
    *,
    move: bool,
    reset: bool,
    ball: bool = False,
    check: DeviceCheck = DEVICE_CHECK,
) -> Iterator[CheckResult]:
    """Check servos of any kind: that they start, and tilt the plate in the right direction.

    Args:
        scenario: Their period and limits.
        rig: Their file; the screen is not used.
        move: Whether the plate may be tilted by a degree.
        reset: Whether faults found in the drives are reset.
        ball: Whether the ball is to show the tilts later, if no encoder measures them.
        check: Constants of the check.

    Raises:
        TwinError: The servos cannot be used, or report a fault.
    """
    real, transmission = connect(scenario, rig), transmission_of(rig)
    servos, level = real.servos, np.zeros((1, 2))
    try:
        servos.start(reset=reset)
        real.clock.start()
        yield pass_check("drives", f"of kind '{rig.kinds['drives'].name}' start")
        for fault in servos.warnings():
            yield warn_check("safety net", fault.detail, fault.condition.recovery)
        if not move:
            yield warn_check("tilt", "not tested", MOVE_ADVICE)
            return
        servos.enable()
        for _ in range(round(HardwareRig.POWER_ON / real.period)):
            if servos.enabled:
                break
            _exchange(real, np.zeros((1, 2)))
        if not servos.enabled:
            seen = f"none within {HardwareRig.POWER_ON:g} s of the request"
            yield fail_check("torque", seen, "is their power on? do the drives hold a fault?")
            return
        servos.home(level, transmission.motor(level))
        if servos.encoders or not ball:
            yield from _check_tilts(real, transmission, check)
    finally:
        servos.stop()


def _exchange(real: HardwareRig, motor_rate: Array) -> None:
    """One period in which the motors turn at rates in rad/s, shape (1, 2).

    Raises:
        RigError: The servos report a fault.
    """
    real.servos.command(motor_rate)
    real.servos.send()
    real.servos.settle(real.clock.left - real.MARGIN)
    real.clock.wait()
    real.servos.receive()
    _raise_fault(real.servos)


def _raise_fault(device: FaultSource) -> None:
    """Raise the fault that a device reports, if it is more than a warning.

    Raises:
        RigError: The device, the condition and its detail.
    """
    for fault in device.faults():
        if fault.condition.severity is not Severity.WARNING:
            raise RigError(str(fault))


def own(
    scenario: Scenario,
    rig: RigFile,
    *,
    move: bool,
    ball: bool = False,
    check: DeviceCheck = DEVICE_CHECK,
) -> Iterator[CheckResult]:
    """Check own hardware: that it starts, measures, and tilts in the right direction.

    Args:
        scenario: Its period and limits.
        rig: Its file.
        move: Whether the plate may be tilted by a degree.
        ball: Whether the ball is to show the tilts later, if no encoder measures them.
        check: Constants of the check.

    Raises:
        TwinError: The hardware cannot be used, or reports a fault.
    """
    real = connect(scenario, rig)
    servos = real.servos
    assert isinstance(servos, OwnServos)
    try:
        servos.start()
        real.clock.start()
        servos.home(np.zeros(2), np.zeros(2))
        yield pass_check("backend", f"{Path(str(rig.backend)).name} starts and measures")
        begun = servos.now()
        readings = _collect_readings(real, servos, check.watch_s)
        watched_s = servos.now() - begun
        if not (yield from report_errors(_check_measurements(readings, watched_s, check), "ball")):
            return
        for fault in servos.warnings():
            yield warn_check("safety net", fault.detail, fault.condition.recovery)
        if not move:
            yield warn_check("tilt", "not tested", MOVE_ADVICE)
        elif servos.encoders or not ball:
            yield from _check_tilts(real, FixedRatio(), check)
    finally:
        servos.stop()


def _collect_readings(real: HardwareRig, servos: OwnServos, seconds: float) -> list[Reading]:
    """Each new reading of a time in s in which the plate rests.

    Raises:
        RigError: The hardware failed or reports a fault.
    """
    found: dict[float, Reading] = {}
    servos.command(np.zeros(2))
    for _ in range(round(seconds / real.period)):
        servos.send()
        real.clock.wait()
        servos.receive()
        if servos.reading is not None:
            found[servos.reading.at] = servos.reading
    for fault in servos.faults():
        raise RigError(str(fault))
    return list(found.values())


def _check_measurements(
    seen: list[Reading], watched_s: float, check: DeviceCheck
) -> Iterator[CheckResult]:
    """How often the hardware measures, in a time in s, and where it sees the ball."""
    at = np.array([each.at for each in seen])
    gap = float(np.diff(at).max()) if len(at) > 1 else math.inf
    rate = f"{(len(at) - 1) / watched_s:.0f} a second, longest gap {1e3 * gap:.0f} ms"
    if len(at) < check.min_measurements:
        yield fail_check("measurements", rate, "is `at` the time of each of them?")
        return
    yield pass_check("measurements", rate)
    ball = 1e3 * np.array([(each.x, each.y) for each in seen])
    share = np.isfinite(ball).all(axis=1).mean()
    if share < check.min_ball_share:
        yield _no_ball(share, "them")
        return
    (x, y), (dx, dy) = np.nanmean(ball, axis=0), np.nanstd(ball, axis=0)
    where = f"x {x:+.1f}, y {y:+.1f} mm, spread {dx:.2f}, {dy:.2f} mm: is it there, at rest?"
    yield pass_check("ball", where)


def _no_ball(share: float, of: str) -> CheckResult:
    return fail_check("ball", f"seen in {100 * share:.0f} % of {of}", "put it on the plate")


def _check_tilts(
    real: HardwareRig, transmission: Transmission, check: DeviceCheck
) -> Iterator[CheckResult]:
    """Whether each axis of a level plate follows its command, and returns.

    Args:
        real: The rig, its servos with torque.
        transmission: Plate angles to motor angles.
        check: Constants of the check.

    Raises:
        RigError: The servos report a fault.
    """
    servos, ticks = real.servos, round(check.tilt_s / real.period)
    commanded = f"{math.degrees(check.tilt_rad):+g} deg"
    goal = np.zeros((1, 2))

    def turn(rates: Array) -> None:
        nonlocal goal
        for _ in range(ticks):
            following = goal + real.period * rates
            by = transmission.motor(following) - transmission.motor(goal)
            _exchange(real, by / real.period)
            goal = following

    helps = list(drives.POSITIVE_ANGLE_HELP.items())
    for axis, (angle, look) in enumerate(helps[: real.supervisor.axes]):
        rates = check.tilt_rad / check.tilt_s * (np.arange(2) == axis)
        before = servos.plate()[0, axis]
        turn(rates)
        turn(0 * rates)
        turned = float(servos.plate()[0, axis] - before)
        seen = f"{math.degrees(turned):+.2f} deg for {commanded}"
        turn(-rates)
        for further in (-rates, 0 * rates, rates):  # the same the other way brakes the ball
            turn(further)
        if not servos.encoders:
            advice = f"{look}: did it? or let the ball show it, by --ball"
            yield warn_check(f"tilt of {angle}", "no encoder measures it", advice)
        elif not abs(turned / check.tilt_rad - 1) <= check.max_tilt_error:
            advice = "check sign and scale of the command and of the encoder"
            yield fail_check(f"tilt of {angle}", seen, advice)
        else:
            yield pass_check(f"tilt of {angle}", f"{seen}: {look}")
