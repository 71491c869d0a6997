"""The whole examination, in the order of a bring-up."""

from __future__ import annotations

from collections.abc import Generator, Iterator

from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.screen import LumioScreen
from twin.devices.scheduling import real_time
from twin.doctor import drives
from twin.doctor.check import Ask, CheckResult, CheckStatus, warned
from twin.doctor.computer import computer
from twin.doctor.limits import limits
from twin.doctor.steps import exchange
from twin.doctor.touch import calibrated, plugged_in, swapped, touch
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


def _judged(check: Iterator[CheckResult]) -> Generator[CheckResult, None, bool]:
    """The results of a check; whether none of them is a failure."""
    good = True
    for result in check:
        good = good and result.status is not CheckStatus.FAIL
        yield result
    return good
