"""The whole examination, in the order of a bring-up."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.screen import LumioScreen
from twin.devices.own import OwnServos, Reading
from twin.devices.realtime import real_time
from twin.devices.rig import HardwareRig
from twin.doctor import drives
from twin.doctor.check import Ask, CheckResult, CheckStatus, failed, passed, reported, warned
from twin.doctor.computer import computer
from twin.doctor.limits import limits
from twin.doctor.steps import exchange
from twin.doctor.touch import calibrated, plugged_in, swapped, touch
from twin.errors import RigError
from twin.run.connect import cams_of, connect
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario


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
        yield from own(scenario, rig, move=move)
        return
    screen = LumioScreen(rig.screen())
    yield from plugged_in(screen.config)
    try:
        yield from touch(screen, ask, rig.patience)
    finally:
        screen.stop()
    yield calibrated(rig, screen.stream.extent)
    servos = AkdServos(rig.servos(scenario.rig.period))
    try:
        with real_time():
            yield from _drives(servos, rig, ask, move=move, reset=reset)
    finally:
        servos.stop()
    if not move:
        advice = "hands off the plate, then: ballplate doctor --move"
        yield warned("torque, heartbeat, encoders", "not tested", advice)


def _drives(
    servos: AkdServos, rig: RigFile, ask: Ask, *, move: bool, reset: bool
) -> Iterator[CheckResult]:
    good = yield from _judged(drives.bus(servos.config, servos))
    if reset and servos.axes:
        servos.start(reset=True)
        exchange(servos, 0.2)
    if not (move and servos.axes and (reset or good)):
        return
    cams = cams_of(rig)
    torque, motion = drives.torque(servos), drives.motion(servos, cams)
    for check in (torque, limits(servos), motion, swapped(servos, cams, ask)):
        if not (yield from _judged(check)):
            return


WATCHED, TILT = 2.0, math.radians(1.0)
"""Seconds that own hardware is watched for; how far it is tilted, rad."""


@reported("backend", "mend its class (docs/your-rig.md)")
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
        yield passed("backend", f"{Path(str(rig.backend)).name} starts and measures")
        if not (yield from _judged(_measures(_watched(real, servos, WATCHED)))):
            return
        for fault in servos.warnings():
            yield warned("safety net", fault.detail, fault.condition.recovery)
        if move:
            yield from _tilts(real, servos)
        else:
            yield warned("tilt", "not tested", "hands off, then: ballplate doctor --move")
    finally:
        servos.stop()


def _watched(
    real: HardwareRig, servos: OwnServos, seconds: float, rates: Array | None = None
) -> list[Reading]:
    """Each new reading of a while in which the plate turns at rates (2,), rad/s.

    Raises:
        RigError: The hardware failed or reports something.
    """
    found: dict[float, Reading] = {}
    servos.command(np.zeros(2) if rates is None else rates)
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
    rate = f"{(len(at) - 1) / WATCHED:.0f} a second, longest gap {1e3 * gap:.0f} ms"
    if len(at) < 3:
        yield failed("measurements", rate, "does `at` tell when each of them came?")
        return
    yield passed("measurements", rate)
    ball = 1e3 * np.array([(each.x, each.y) for each in seen])
    share = np.isfinite(ball).all(axis=1).mean()
    if share < 0.5:
        yield failed("ball", f"seen in {100 * share:.0f} % of them", "put it on the plate")
        return
    (x, y), (dx, dy) = np.nanmean(ball, axis=0), np.nanstd(ball, axis=0)
    where = f"x {x:+.1f}, y {y:+.1f} mm, spread {dx:.2f}, {dy:.2f} mm: is it there, at rest?"
    yield passed("ball", where)


def _tilts(real: HardwareRig, servos: OwnServos) -> Iterator[CheckResult]:
    """Whether each axis goes where it is told, and back."""
    for axis, (angle, look) in enumerate(
        (("phi", "the end at larger x goes down"), ("theta", "the end at larger y goes up"))
    ):
        rates = TILT / 0.5 * (np.arange(2) == axis)
        before = servos.plate()[0, axis]
        _watched(real, servos, 0.5, rates), _watched(real, servos, 0.5)
        turned = float(np.degrees(servos.plate()[0, axis] - before))
        _watched(real, servos, 0.5, -rates)
        if servos.reading is None or servos.reading.phi is None:
            yield warned(f"tilt of {angle}", "no encoder measures it", f"{look}: did it?")
        elif abs(turned - 1) > 0.4:
            advice = "check sign and scale of the command and of the encoder"
            yield failed(f"tilt of {angle}", f"{turned:+.2f} deg for +1 deg", advice)
        else:
            yield passed(f"tilt of {angle}", f"{turned:+.2f} deg for +1 deg: {look}")


def _judged(check: Iterator[CheckResult]) -> Generator[CheckResult, None, bool]:
    """The results of a check; whether none of them is a failure."""
    good = True
    for result in check:
        good = good and result.status is not CheckStatus.FAIL
        yield result
    return good
