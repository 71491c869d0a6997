"""The whole examination, in the order of a bring-up."""

from __future__ import annotations

from collections.abc import Iterator

from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.screen import LumioScreen
from twin.devices.scheduling import real_time
from twin.doctor import drives
from twin.doctor.check import Ask, CheckResult, CheckStatus, warned
from twin.doctor.computer import computer
from twin.doctor.limits import limits
from twin.doctor.panels import calibrated, plugged_in
from twin.doctor.steps import exchange
from twin.doctor.swapped import swapped
from twin.doctor.touch import touch
from twin.run.connect import cams_of
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
    found = []
    for result in drives.bus(servos.config, servos):
        found.append(result)
        yield result
    if reset and servos.axes:
        servos.reset_faults()
        exchange(servos, 0.2)
    failed = any(result.status is CheckStatus.FAIL for result in found)
    if move and servos.axes and (reset or not failed):
        moved: list[CheckResult] = []
        for check in (_torque, _limits, _motion, _swapped):
            for result in check(servos, rig, ask):
                moved.append(result)
                yield result
            if any(result.status is CheckStatus.FAIL for result in moved):
                return


def _torque(servos: AkdServos, _: RigFile, __: Ask) -> Iterator[CheckResult]:
    return drives.torque(servos)


def _limits(servos: AkdServos, _: RigFile, __: Ask) -> Iterator[CheckResult]:
    return limits(servos)


def _motion(servos: AkdServos, rig: RigFile, _: Ask) -> Iterator[CheckResult]:
    return drives.motion(servos, cams_of(rig))


def _swapped(servos: AkdServos, rig: RigFile, ask: Ask) -> Iterator[CheckResult]:
    return swapped(servos, cams_of(rig), ask)
