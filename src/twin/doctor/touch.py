"""The touch screen: port, protocol, report rate, place, lift-off."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from twin.devices.lumio.presence import TouchState
from twin.devices.lumio.screen import LumioScreen
from twin.doctor.check import Ask, CheckResult, failed, passed, warned
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
        yield failed(what, str(error), "plug it in; see the README for permissions")
        return
    yield passed(what, f"{config.transport}, opened")
    ask("put")
    if not _until(lambda: screen.state is TouchState.TOUCHING and screen.report_rate > 0, patience):
        heard = screen.counters.bytes
        advice = "put the ball on the plate; check baud rate, transport and protocol"
        yield failed("touch", f"no ball within {patience:g} s, {heard} bytes heard", advice)
        return
    time.sleep(0.5)
    yield passed("touch protocol", screen.protocol)
    rate = screen.report_rate
    seen = f"{rate:.1f} reports per second"
    slow = "check the baud rate; other programs may read the port"
    yield passed("report rate", seen) if rate >= SLOWEST else warned("report rate", seen, slow)
    x, y = screen.read().position[0].tolist()
    yield passed("touch position", f"x {1e3 * x:+.1f}, y {1e3 * y:+.1f} mm: is the ball there?")
    stats = screen.counters
    if stats.skipped or stats.checksum or stats.outside:
        seen = f"{stats.skipped} bytes skipped, {stats.checksum} checksums, {stats.outside} outside"
        yield warned("touch bytes", seen, "check the cable and the baud rate")
    yield from _lift(screen, ask, patience)


def _lift(screen: LumioScreen, ask: Ask, patience: float) -> Iterator[CheckResult]:
    ask("lift")
    if not _until(lambda: screen.state is TouchState.LOST, patience):
        yield warned("lift-off", f"not seen within {patience:g} s", "lift the ball when asked to")
        return
    seen = f"noticed; the ball counts as lost after {1e3 * LOST_AFTER:.0f} ms"
    yield passed("lift-off", seen)
    ask("put")
    back = _until(lambda: screen.state is TouchState.TOUCHING, patience)
    if not back:
        yield failed("touch again", f"not within {patience:g} s", "put the ball back")


def _until(done: Callable[[], bool], limit: float) -> bool:
    end = time.monotonic() + limit
    while time.monotonic() < end:
        if done():
            return True
        time.sleep(0.01)
    return done()
