"""The whole examination, in the order of a bring-up: computer, screen, drives, or own hardware.

A Lumio screen and AKD drives have checks of their own. Devices of every other kind have those that
need no more than `PoweredScreen` and `PoweredServos`. The computer and its installation are checked
without a device: scheduling, timer, cam table, extras, ports.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from controllers.arrays import Array
from twin.base.errors import RigError, TwinError, plural
from twin.base.jobs import wait_until
from twin.devices.akd.config import list_unconfirmed
from twin.devices.akd.protocol import table
from twin.devices.lumio.config import Calibration, Mounting
from twin.devices.lumio.screen import LumioScreen, TouchState
from twin.devices.own import OwnServos
from twin.devices.own_hardware import Reading
from twin.devices.realtime import RealTimeClock, real_time
from twin.devices.rig import HardwareRig
from twin.doctor import drives
from twin.doctor.check import (
    Ask,
    CheckResult,
    CheckStatus,
    fail_check,
    note_check,
    pass_check,
    report_errors,
    warn_check,
)
from twin.doctor.drives import exchange
from twin.doctor.rolling import roll
from twin.hal.cams import FixedRatio
from twin.hal.interface import FaultSource, Severity, Transmission
from twin.hal.supervisor import BALL_LOST_AFTER_S
from twin.run.connect import ComputingTime, cams_of, connect, transmission_of
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario

if TYPE_CHECKING:
    from twin.devices.akd.servos import AkdServos


@dataclass(frozen=True, kw_only=True)
class ComputerCheck:
    """How the computer is checked.

    Attributes:
        timer_s: Time in s for which the timer is watched.
        lateness_quantile: Quantile of the timer's lateness that is compared with the period.
        max_lateness_periods: Largest lateness at that quantile, in control periods.
        max_missed_percent: Largest share of missed periods, %.
        max_bus_load: Share of a period's time on the bus above which heartbeats and SDOs are late.
    """

    timer_s: float = 1.0
    lateness_quantile: float = 0.99
    max_lateness_periods: float = 0.25
    max_missed_percent: float = 0.5
    max_bus_load: float = 0.6


COMPUTER_CHECK = ComputerCheck()


def computer(
    scenario: Scenario, rig: RigFile, check: ComputerCheck = COMPUTER_CHECK
) -> Iterator[CheckResult]:
    """Everything that can be checked without a device."""
    yield from _check_scheduling(scenario.rig.period, check)
    yield _check_computing_time(scenario)
    if rig.has_cams:
        yield _check_cams(rig)
    relaxed = ", ".join(rig.relaxed(scenario.rig.period))
    advice = "take these keys out of the rig file; every run is warned of them"
    seen = f"relaxed: {relaxed}" if relaxed else "as by default, or tighter"
    yield note_check("safety nets", seen, advice if relaxed else "")
    if not rig.has_akd:
        return
    yield warn_check(
        "settings of the drives",
        f"never confirmed on a rig: {', '.join(list_unconfirmed())}",
        "compare them with the drives' manual and setup software",
    )
    by_hand = "; ".join(table()["by_hand"])
    yield warn_check("to be looked at by hand", by_hand, "see docs/bring-up.md")
    load, bus = rig.servos(scenario.rig.period).bus_load, rig.bus
    seen = f"{100 * load:.0f} % at {bus.bitrate / 1e6:g} Mbit/s, stuffed at worst"
    advice = "set drives and adapter to 1 Mbit/s"
    yield note_check("bus load", seen, advice if load > check.max_bus_load else "")


def _check_computing_time(scenario: Scenario) -> CheckResult:
    found = ComputingTime.measured(scenario)
    what = "computing time of the law"
    if found.enough:
        return pass_check(what, f"{found.text}: will do")
    if found.never:
        return fail_check(what, f"{found.text}: will not do", found.advice)
    return warn_check(what, f"{found.text}: may be too late now and then", found.advice)


def _check_scheduling(period: float, check: ComputerCheck) -> Iterator[CheckResult]:
    clock = RealTimeClock(period)
    timing = clock.timing
    with real_time() as obtained:
        for words in obtained.words[:2]:
            seen, _, advice = words.partition(": ")
            yield note_check("real-time priority" if "priority" in seen else "memory", seen, advice)
        clock.start()
        for _ in range(round(check.timer_s / period)):
            clock.wait()
    late = timing.lateness.quantile(check.lateness_quantile)
    share = 100 * timing.missed / max(1, timing.ticks + timing.missed)
    quantile = f"p{100 * check.lateness_quantile:g}"
    missed = f"{share:.2f} % of {1e3 * period:g} ms periods missed"
    seen = f"{quantile} {1e6 * late:.0f} us late, {missed}"
    advice = "close other programs; use a kernel with PREEMPT_RT"
    bad = share > check.max_missed_percent or late > check.max_lateness_periods * period
    yield note_check("timer", seen, advice if bad else "")


def _check_cams(rig: RigFile) -> CheckResult:
    own = rig.cams or "cams.json"
    try:
        table = cams_of(rig)
    except TwinError as error:
        advice = f"run `ballplate calibrate cams --rig FILE --out {own}`"
        return fail_check("cam table", str(error), advice)
    seen = f"{Path(own).name}: ratio {table.ratio:.2f}"
    if not rig.cams:
        advice = "name a table measured on this rig as 'cams' in the rig file"
        return warn_check("cam table", f"{seen}, computed from the model", advice)
    return pass_check("cam table", seen)


def examine(
    scenario: Scenario, rig: RigFile, ask: Ask, *, move: bool, reset: bool, ball: bool = False
) -> Iterator[CheckResult]:
    """Every check, as it is made.

    Args:
        scenario: The scenario that the rig is to run.
        rig: The rig file: which devices are connected where.
        ask: Requests that the ball is put on or lifted.
        move: Whether drives may have torque and the plate may be tilted by a degree.
        reset: Whether faults found in the drives are reset.
        ball: Whether the ball is to roll as well, to show the directions of the axes.
    """
    good = True
    for result in _devices(scenario, rig, ask, move=move, reset=reset, ball=ball):
        good = good and result.status is not CheckStatus.FAIL
        yield result
    if not (ball and move and good):
        return
    ask("lift")
    ask("put")  # in the middle: a virtual rig puts a ball that was lifted back where it was
    yield from report_errors(rolling_ball(scenario, rig), "rolling ball", ROLL_ADVICE)


ROLL_ADVICE = "put the ball in the middle of a level plate, and see the reason"


def rolling_ball(scenario: Scenario, rig: RigFile) -> Iterator[CheckResult]:
    """Check by the ball in which direction each axis tilts; the whole rig is switched on.

    Args:
        scenario: Its period and limits.
        rig: Its file.

    Raises:
        TwinError: The rig cannot be switched on, or it stopped.
    """
    real = connect(scenario, rig)
    real.watches_roll = False
    with real:
        yield from roll(real, rig.patience)


def _devices(
    scenario: Scenario, rig: RigFile, ask: Ask, *, move: bool, reset: bool, ball: bool
) -> Iterator[CheckResult]:
    """The computer, then each device by itself."""
    yield from computer(scenario, rig)
    if rig.backend is not None:
        check = own(scenario, rig, move=move, ball=ball)
        yield from report_errors(
            check, "backend", "fix its class or its options (docs/your-rig.md)"
        )
        return
    if rig.has_lumio:
        screen = LumioScreen(rig.screen())
        try:
            yield from touch(screen, ask, rig.patience)
        finally:
            screen.stop()
        yield check_calibration(rig, screen.stream.extent)
    else:
        ask("put")
        check = any_screen(scenario, rig)
        yield from report_errors(check, "touch screen", ANY_KIND_ADVICE)
    if not rig.has_akd:
        check = any_servos(scenario, rig, move=move, reset=reset, ball=ball)
        yield from report_errors(check, "drives", ANY_KIND_ADVICE)
        return
    from twin.devices.akd.servos import AkdServos  # noqa: PLC0415  loads python-can

    servos = AkdServos(rig.servos(scenario.rig.period))
    try:
        with real_time():
            yield from _drives(servos, rig, move=move, reset=reset)
    finally:
        servos.stop()
    if not move:
        advice = "hands off the plate, then: ballplate doctor --move"
        yield warn_check("torque, heartbeat, encoders", "not tested", advice)


def _drives(servos: AkdServos, rig: RigFile, *, move: bool, reset: bool) -> Iterator[CheckResult]:
    good = yield from report_errors(drives.bus(servos.config, servos), "CAN bus")
    if reset and servos.axes:
        servos.start(reset=True)
        exchange(servos, 0.2)
    if not (move and servos.axes and (reset or good)):
        return
    cams = cams_of(rig)
    for what, check in (
        ("torque", drives.torque(servos)),
        ("limits in the drives", drives.limits(servos)),
        ("motion", drives.motion(servos, cams)),
    ):
        if not (yield from report_errors(check, what)):
            return


CALIBRATION_ADVICE = "run `ballplate calibrate touch`, name its file as touch.calibration_file"


@dataclass(frozen=True, kw_only=True)
class LumioCheck:
    """How a Lumio screen is checked.

    Attributes:
        settling_s: Time in s from the first touch to the check of its protocol and rate.
        min_report_rate_hz: Reports per second below which the screen is slower than it should be
            (57.6).
        max_size_difference: Relative difference of the size in a panel's descriptor from the
            measured one that is allowed: the panel's frame.
    """

    settling_s: float = 0.5
    min_report_rate_hz: float = 40.0
    max_size_difference: float = 0.05


LUMIO_CHECK = LumioCheck()


def check_calibration(
    rig: RigFile, extent: tuple[float, float] | None, check: LumioCheck = LUMIO_CHECK
) -> CheckResult:
    """Whether the screen's calibration was measured, and fits the size that the panel reports.

    Args:
        rig: The rig file.
        extent: Sides of the sensing area along the screen's x and y, m; None if not reported.
        check: Constants of the check.
    """
    what = "touch calibration"
    known, file = rig.screen().calibration, rig.touch and rig.touch.calibration_file
    if known is None:
        nominal = Mounting.of(Calibration.nominal()).size_m
        size = f"{_area(extent)} that the panel reports" if extent else _area(nominal)
        return warn_check(
            what, f"never measured; square, centred, {size}: assumed", CALIBRATION_ADVICE
        )
    mounting = Mounting.of(known)
    width, height = mounting.size_m
    sides = (height, width) if mounting.swapped else (width, height)
    seen = Path(file).name if file else "in the rig file"
    if extent and any(
        abs(a / b - 1) > check.max_size_difference for a, b in zip(sides, extent, strict=True)
    ):
        differ = f"{seen}: sensing area {_area(sides)}, but the panel reports {_area(extent)}"
        return warn_check(what, differ, f"is it of a different panel? {CALIBRATION_ADVICE}")
    return pass_check(what, f"{seen}: the sensing area is {_area(sides)}")


def _area(sides: tuple[float, float]) -> str:
    return f"{100 * sides[0]:.1f} x {100 * sides[1]:.1f} cm"


def touch(
    screen: LumioScreen, ask: Ask, patience: float, check: LumioCheck = LUMIO_CHECK
) -> Iterator[CheckResult]:
    """Listen to the screen with the ball on it, and while it is lifted."""
    config = screen.config
    what = f"touch port {config.port}"
    try:
        screen.start()
    except TwinError as error:
        yield fail_check(
            what, str(error), "plug it in; `ballplate doctor --udev` prints rules for access"
        )
        return
    yield pass_check(what, f"{config.transport}, opened")
    ask("put")
    if not wait_until(
        lambda: screen.state is TouchState.TOUCHING and screen.stream.rate > 0, patience
    ):
        heard = screen.stream.heard
        advice = screen.hint or "put the ball on the plate"
        yield fail_check(
            "touch", f"no ball within {patience:g} s, {plural(heard, 'byte')} heard", advice
        )
        return
    time.sleep(check.settling_s)
    if screen.stream.looks_like:
        yield fail_check("touch protocol", f"set to {config.protocol}", screen.hint)
        return
    yield pass_check("touch protocol", screen.protocol)
    rate = screen.stream.rate
    seen = f"{rate:.1f} reports per second"
    slow = "check the baud rate; other programs may read the port"
    yield note_check("report rate", seen, slow if rate < check.min_report_rate_hz else "")
    x, y = screen.read().position[0].tolist()
    yield pass_check("touch position", f"x {1e3 * x:+.1f}, y {1e3 * y:+.1f} mm: is the ball there?")
    stats = screen.stream.stats
    if stats.skipped or stats.checksum or stats.outside:
        skipped, checksums = plural(stats.skipped, "byte"), plural(stats.checksum, "checksum")
        seen = f"{skipped} skipped, {checksums}, {stats.outside} outside"
        yield warn_check("touch bytes", seen, "check the cable and the baud rate")
    yield from _lift(screen, ask, patience)


def _lift(screen: LumioScreen, ask: Ask, patience: float) -> Iterator[CheckResult]:
    ask("lift")
    if not wait_until(lambda: screen.state is TouchState.LOST, patience):
        yield warn_check(
            "lift-off", f"not seen within {patience:g} s", "lift the ball when asked to"
        )
        return
    seen = f"noticed; the ball counts as lost after {1e3 * BALL_LOST_AFTER_S:.0f} ms"
    yield pass_check("lift-off", seen)
    ask("put")
    if not wait_until(lambda: screen.state is TouchState.TOUCHING, patience):
        yield fail_check("touch again", f"not within {patience:g} s", "put the ball back")


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
