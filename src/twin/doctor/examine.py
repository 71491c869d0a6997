"""The whole examination, in the order of a bring-up: computer, screen, drives, or own hardware.

A Lumio screen and AKD drives have checks that know them; devices of every other kind have those
that need no more than `PoweredScreen` and `PoweredServos`.

Of the computer and its installation: scheduling, timer, cam table, extras, ports.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from twin.base.errors import RigError, TwinError
from twin.base.jobs import wait_until
from twin.devices.akd.config import list_unconfirmed
from twin.devices.akd.protocol import table
from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.config import Calibration, Mounting
from twin.devices.lumio.screen import LumioScreen, TouchState
from twin.devices.own import OwnServos, Reading
from twin.devices.realtime import RealTimeClock, real_time
from twin.devices.rig import HardwareRig
from twin.doctor import drives
from twin.doctor.check import (
    Ask,
    CheckResult,
    fail_check,
    note_check,
    pass_check,
    report_errors,
    warn_check,
)
from twin.doctor.drives import exchange
from twin.hal.cams import FixedRatio
from twin.hal.interface import FaultSource, Severity, Transmission
from twin.hal.supervisor import LOST_AFTER
from twin.run.connect import ComputingTime, cams_of, connect, transmission_of
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario

TIMER_CHECK_S = 1.0
"""Seconds that the timer is watched."""
FULL_BUS = 0.6
"""Share of a period's time on the bus above which heartbeats and SDOs come late."""


def computer(scenario: Scenario, rig: RigFile) -> Iterator[CheckResult]:
    """Everything that can be checked without a device."""
    yield from _scheduling(scenario.rig.period)
    yield _law(scenario)
    if rig.has_cams:
        yield _cams(rig)
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
    yield note_check("bus load", seen, advice if load > FULL_BUS else "")


def _law(scenario: Scenario) -> CheckResult:
    found = ComputingTime.measured(scenario)
    what = "computing time of the law"
    if found.enough:
        return pass_check(what, f"{found.text}: will do")
    if found.never:
        return fail_check(what, f"{found.text}: will not do", found.advice)
    return warn_check(what, f"{found.text}: may be too late now and then", found.advice)


def _scheduling(period: float) -> Iterator[CheckResult]:
    clock = RealTimeClock(period)
    timing = clock.timing
    with real_time() as obtained:
        for words in obtained.words[:2]:
            seen, _, advice = words.partition(": ")
            yield note_check("real-time priority" if "priority" in seen else "memory", seen, advice)
        clock.start()
        for _ in range(round(TIMER_CHECK_S / period)):
            clock.wait()
    late = timing.lateness.quantile(0.99)
    share = 100 * timing.missed / max(1, timing.ticks + timing.missed)
    seen = f"p99 {1e6 * late:.0f} us late, {share:.2f} % of {1e3 * period:g} ms periods missed"
    advice = "close other programs; use a kernel with PREEMPT_RT"
    yield note_check("timer", seen, advice if share > 0.5 or late > period / 4 else "")


def _cams(rig: RigFile) -> CheckResult:
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
    scenario: Scenario, rig: RigFile, ask: Ask, *, move: bool, reset: bool
) -> Iterator[CheckResult]:
    """Every check, as it is made.

    Args:
        scenario: What the rig is to run.
        rig: What is connected where.
        ask: Asks for the ball to be put or lifted, and what the plate does.
        move: Whether drives may have torque and the plate may be tilted by a degree.
        reset: Whether faults found in the drives are reset.
    """
    yield from computer(scenario, rig)
    if rig.backend is not None:
        check = own(scenario, rig, move=move)
        yield from report_errors(check, "backend", "mend its class (docs/your-rig.md)")
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
        check = any_servos(scenario, rig, move=move, reset=reset)
        yield from report_errors(check, "drives", ANY_KIND_ADVICE)
        return
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


MAX_SIZE_DIFFERENCE = 0.05
"""Share by which the size in a panel's descriptor and the measured one may differ: its frame."""
CALIBRATION_ADVICE = "run `ballplate calibrate touch`, name its file as touch.calibration_file"


def check_calibration(rig: RigFile, extent: tuple[float, float] | None) -> CheckResult:
    """Whether the screen's calibration was measured, and fits what the panel says of its size.

    Args:
        rig: The rig file.
        extent: Sides of the sensing area along the screen's x and y, m, if the panel tells.
    """
    what = "touch calibration"
    known, file = rig.screen().calibration, rig.touch and rig.touch.calibration_file
    if known is None:
        nominal = Mounting.of(Calibration.nominal()).size_m
        size = f"{_area(extent)} that the panel says" if extent else _area(nominal)
        return warn_check(
            what, f"never measured; square, centred, {size}: assumed", CALIBRATION_ADVICE
        )
    mounting = Mounting.of(known)
    width, height = mounting.size_m
    sides = (height, width) if mounting.swapped else (width, height)
    seen = Path(file).name if file else "in the rig file"
    if extent and any(
        abs(a / b - 1) > MAX_SIZE_DIFFERENCE for a, b in zip(sides, extent, strict=True)
    ):
        differ = f"{seen}: the sensing area is {_area(sides)}, but the panel says {_area(extent)}"
        return warn_check(what, differ, f"is it of another panel? {CALIBRATION_ADVICE}")
    return pass_check(what, f"{seen}: the sensing area is {_area(sides)}")


def _area(sides: tuple[float, float]) -> str:
    return f"{100 * sides[0]:.1f} x {100 * sides[1]:.1f} cm"


MIN_REPORT_RATE_HZ = 40.0
"""Reports per second below which the screen is slower than it should be (57.6)."""


def touch(screen: LumioScreen, ask: Ask, patience: float) -> Iterator[CheckResult]:
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
        yield fail_check("touch", f"no ball within {patience:g} s, {heard} bytes heard", advice)
        return
    time.sleep(0.5)
    if screen.stream.looks_like:
        yield fail_check("touch protocol", f"set to {config.protocol}", screen.hint)
        return
    yield pass_check("touch protocol", screen.protocol)
    rate = screen.stream.rate
    seen = f"{rate:.1f} reports per second"
    slow = "check the baud rate; other programs may read the port"
    yield note_check("report rate", seen, slow if rate < MIN_REPORT_RATE_HZ else "")
    x, y = screen.read().position[0].tolist()
    yield pass_check("touch position", f"x {1e3 * x:+.1f}, y {1e3 * y:+.1f} mm: is the ball there?")
    stats = screen.stream.stats
    if stats.skipped or stats.checksum or stats.outside:
        seen = f"{stats.skipped} bytes skipped, {stats.checksum} checksums, {stats.outside} outside"
        yield warn_check("touch bytes", seen, "check the cable and the baud rate")
    yield from _lift(screen, ask, patience)


def _lift(screen: LumioScreen, ask: Ask, patience: float) -> Iterator[CheckResult]:
    ask("lift")
    if not wait_until(lambda: screen.state is TouchState.LOST, patience):
        yield warn_check(
            "lift-off", f"not seen within {patience:g} s", "lift the ball when asked to"
        )
        return
    seen = f"noticed; the ball counts as lost after {1e3 * LOST_AFTER:.0f} ms"
    yield pass_check("lift-off", seen)
    ask("put")
    if not wait_until(lambda: screen.state is TouchState.TOUCHING, patience):
        yield fail_check("touch again", f"not within {patience:g} s", "put the ball back")


OWN_CHECK_S, OWN_TILT_RAD = 2.0, math.radians(1.0)
"""Seconds that own hardware is watched for; how far it is tilted, rad."""
ANY_KIND_ADVICE = "mend its class or its package (docs/your-rig.md)"


def any_screen(scenario: Scenario, rig: RigFile) -> Iterator[CheckResult]:
    """What can be checked of any screen: that it starts, how often it measures, where the ball is.

    Args:
        scenario: Its period and limits.
        rig: Its file; the servos are left alone.
    """
    real = connect(scenario, rig)
    screen, level, seen = real.screen, np.zeros((1, 2)), list[Reading]()
    try:
        screen.start()
        kind = rig.kinds["touch"].name
        yield pass_check("touch screen", f"{screen.where} of kind '{kind}' starts")
        real.clock.start()
        for _ in range(round(OWN_CHECK_S / real.period)):
            real.clock.wait()
            screen.receive()
            screen.note_plate(level)
            touch = screen.read()
            _raise_fault(screen)
            x, y = touch.position[0].tolist() if touch.touched[0] else (math.nan, math.nan)
            at = real.servos.now() - float(touch.age[0])
            if math.isfinite(at) and (not seen or at - seen[-1].at > real.period / 2):
                seen.append(Reading(x, y, at))
        yield from _measures(seen)
    finally:
        screen.stop()


def any_servos(
    scenario: Scenario, rig: RigFile, *, move: bool, reset: bool
) -> Iterator[CheckResult]:
    """What can be checked of any servos: that they start, and tilt the plate the right way.

    Args:
        scenario: Their period and limits.
        rig: Their file; the screen is left alone.
        move: Whether the plate may be tilted by a degree.
        reset: Whether faults found in the drives are reset.
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
            yield warn_check("tilt", "not tested", "hands off, then: ballplate doctor --move")
            return
        servos.enable()
        for _ in range(round(HardwareRig.POWER_ON / real.period)):
            if servos.enabled:
                break
            _exchange(real, np.zeros((1, 2)))
        if not servos.enabled:
            seen = f"none within {HardwareRig.POWER_ON:g} s of the request"
            yield fail_check("torque", seen, "is their power on? does a fault stand in the drives?")
            return
        servos.home(level, transmission.motor(level))
        yield from _tilts(real, transmission)
    finally:
        servos.stop()


def _exchange(real: HardwareRig, motor_rate: Array) -> None:
    """One period in which the motors turn at rates in rad/s, shape (1, 2).

    Raises:
        RigError: The servos report something.
    """
    real.servos.command(motor_rate)
    real.servos.send()
    real.servos.settle(real.clock.left - real.MARGIN)
    real.clock.wait()
    real.servos.receive()
    _raise_fault(real.servos)


def _raise_fault(device: FaultSource) -> None:
    """Raise what a device reports, if it is more than a warning.

    Raises:
        RigError: The report.
    """
    for fault in device.faults():
        if fault.condition.severity is not Severity.WARNING:
            raise RigError(str(fault))


def own(scenario: Scenario, rig: RigFile, *, move: bool) -> Iterator[CheckResult]:
    """What can be said of own hardware: that it starts, measures, and tilts the right way.

    Args:
        scenario: Its period and limits.
        rig: Its file.
        move: Whether the plate may be tilted by a degree.
    """
    real = connect(scenario, rig)
    servos = real.servos
    assert isinstance(servos, OwnServos)
    try:
        servos.start()
        real.clock.start()
        servos.home(np.zeros(2), np.zeros(2))
        yield pass_check("backend", f"{Path(str(rig.backend)).name} starts and measures")
        if not (
            yield from report_errors(
                _measures(_collect_readings(real, servos, OWN_CHECK_S)), "ball"
            )
        ):
            return
        for fault in servos.warnings():
            yield warn_check("safety net", fault.detail, fault.condition.recovery)
        if move:
            yield from _tilts(real, FixedRatio())
        else:
            yield warn_check("tilt", "not tested", "hands off, then: ballplate doctor --move")
    finally:
        servos.stop()


def _collect_readings(real: HardwareRig, servos: OwnServos, seconds: float) -> list[Reading]:
    """Each new reading of a time in s in which the plate stands.

    Raises:
        RigError: The hardware failed or reports something.
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


def _measures(seen: list[Reading]) -> Iterator[CheckResult]:
    """How often the hardware measures, and where it sees the ball."""
    at = np.array([each.at for each in seen])
    gap = float(np.diff(at).max()) if len(at) > 1 else math.inf
    rate = f"{(len(at) - 1) / OWN_CHECK_S:.0f} a second, longest gap {1e3 * gap:.0f} ms"
    if len(at) < 3:
        yield fail_check("measurements", rate, "does `at` tell when each of them came?")
        return
    yield pass_check("measurements", rate)
    ball = 1e3 * np.array([(each.x, each.y) for each in seen])
    share = np.isfinite(ball).all(axis=1).mean()
    if share < 0.5:
        yield fail_check("ball", f"seen in {100 * share:.0f} % of them", "put it on the plate")
        return
    (x, y), (dx, dy) = np.nanmean(ball, axis=0), np.nanstd(ball, axis=0)
    where = f"x {x:+.1f}, y {y:+.1f} mm, spread {dx:.2f}, {dy:.2f} mm: is it there, at rest?"
    yield pass_check("ball", where)


def _tilts(real: HardwareRig, transmission: Transmission) -> Iterator[CheckResult]:
    """Whether each axis of a level plate goes where it is commanded, and back.

    Args:
        real: The rig, its servos with torque.
        transmission: Plate angles to motor angles.

    Raises:
        RigError: The servos report something.
    """
    servos, ticks = real.servos, round(0.5 / real.period)
    goal = np.zeros((1, 2))

    def turn(rates: Array) -> None:
        nonlocal goal
        for _ in range(ticks):
            following = goal + real.period * rates
            by = transmission.motor(following) - transmission.motor(goal)
            _exchange(real, by / real.period)
            goal = following

    for axis, (angle, look) in enumerate(drives.POSITIVE_ANGLE_HELP.items()):
        rates = OWN_TILT_RAD / 0.5 * (np.arange(2) == axis)
        before = servos.plate()[0, axis]
        turn(rates)
        turn(0 * rates)
        turned = float(np.degrees(servos.plate()[0, axis] - before))
        turn(-rates)
        if not servos.encoders:
            yield warn_check(f"tilt of {angle}", "no encoder measures it", f"{look}: did it?")
        elif not abs(turned - 1) <= 0.4:
            advice = "check sign and scale of the command and of the encoder"
            yield fail_check(f"tilt of {angle}", f"{turned:+.2f} deg for +1 deg", advice)
        else:
            yield pass_check(f"tilt of {angle}", f"{turned:+.2f} deg for +1 deg: {look}")
