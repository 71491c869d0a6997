"""Checks of a Lumio screen: its port, protocol, rate, position, lift-off and calibration."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from twin.base.errors import TwinError, plural
from twin.base.jobs import wait_until
from twin.devices.lumio.config import Calibration, Mounting
from twin.devices.lumio.screen import LumioScreen, TouchState
from twin.doctor.check import Ask, CheckResult, fail_check, note_check, pass_check, warn_check
from twin.hal.supervisor import BALL_LOST_AFTER_S
from twin.scenario.rig import RigFile

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
