"""The touch screen: port, protocol, report rate, place, lift-off."""

from __future__ import annotations

import time
from collections.abc import Iterator

from twin.devices.lumio.presence import TouchState
from twin.devices.lumio.screen import LumioScreen
from twin.doctor.check import Ask, CheckResult, failed, passed, warned
from twin.doctor.steps import wait_until
from twin.errors import TwinError
from twin.hal.supervisor import LOST_AFTER

SLOWEST = 40.0
"""Reports per second below which the screen is slower than it should be (57.6)."""


def touch(screen: LumioScreen, ask: Ask, patience: float) -> Iterator[CheckResult]:
    """Listen to the screen with the ball on it, and while it is lifted."""
    config = screen.config
    what = f"touch port {config.port}"
    try:
        screen.start()
    except TwinError as error:
        yield failed(
            what, str(error), "plug it in; `ballplate doctor --udev` prints rules for access"
        )
        return
    yield passed(what, f"{config.transport}, opened")
    ask("put")
    if not wait_until(
        lambda: screen.state is TouchState.TOUCHING and screen.stream.rate > 0, patience
    ):
        heard = screen.stream.stats.bytes
        advice = screen.hint or "put the ball on the plate"
        yield failed("touch", f"no ball within {patience:g} s, {heard} bytes heard", advice)
        return
    time.sleep(0.5)
    if screen.stream.looks_like:
        yield failed("touch protocol", f"set to {config.protocol}", screen.hint)
        return
    yield passed("touch protocol", screen.protocol)
    rate = screen.stream.rate
    seen = f"{rate:.1f} reports per second"
    slow = "check the baud rate; other programs may read the port"
    yield passed("report rate", seen) if rate >= SLOWEST else warned("report rate", seen, slow)
    x, y = screen.read().position[0].tolist()
    yield passed("touch position", f"x {1e3 * x:+.1f}, y {1e3 * y:+.1f} mm: is the ball there?")
    stats = screen.stream.stats
    if stats.skipped or stats.checksum or stats.outside:
        seen = f"{stats.skipped} bytes skipped, {stats.checksum} checksums, {stats.outside} outside"
        yield warned("touch bytes", seen, "check the cable and the baud rate")
    yield from _lift(screen, ask, patience)


def _lift(screen: LumioScreen, ask: Ask, patience: float) -> Iterator[CheckResult]:
    ask("lift")
    if not wait_until(lambda: screen.state is TouchState.LOST, patience):
        yield warned("lift-off", f"not seen within {patience:g} s", "lift the ball when asked to")
        return
    seen = f"noticed; the ball counts as lost after {1e3 * LOST_AFTER:.0f} ms"
    yield passed("lift-off", seen)
    ask("put")
    back = wait_until(lambda: screen.state is TouchState.TOUCHING, patience)
    if not back:
        yield failed("touch again", f"not within {patience:g} s", "put the ball back")
