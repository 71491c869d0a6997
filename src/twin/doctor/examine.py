"""The whole examination, in the order of a bring-up: computer, screen, drives, or own hardware.

A Lumio screen and AKD drives have checks of their own. Devices of every other kind have those that
need no more than `PoweredScreen` and `PoweredServos`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from twin.devices.lumio.screen import LumioScreen
from twin.devices.realtime import real_time
from twin.doctor import drives
from twin.doctor.any_kind import ANY_KIND_ADVICE, any_screen, any_servos, own
from twin.doctor.check import Ask, CheckResult, CheckStatus, report_errors, warn_check
from twin.doctor.computer import computer
from twin.doctor.drives import exchange
from twin.doctor.lumio import check_calibration, touch
from twin.doctor.rolling import roll
from twin.run.connect import cams_of, connect
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario

if TYPE_CHECKING:
    from twin.devices.akd.servos import AkdServos

ROLL_ADVICE = "put the ball in the middle of a level plate, and see the reason"


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
