"""The touch screen: port, protocol, report rate, place, lift-off, calibration, and swapped axes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from math import radians
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.conditions import TWO_CONTACTS
from twin.devices.lumio.config import (
    HIDRAW_CLASS,
    Calibration,
    CalibrationError,
    CalibrationFit,
    Interface,
    LumioConfig,
    Mounting,
    PlausibilityLimits,
    check_spread,
    fit,
    outlier,
    panels,
    read_calibration,
)
from twin.devices.lumio.screen import LumioScreen, Sample, TouchState
from twin.doctor.check import Ask, CheckResult, failed, noted, passed, reported, warned
from twin.doctor.steps import exchange, hold_level, stopped_by, turn
from twin.errors import RigError, TwinError
from twin.hal.interface import SCREEN, Transmission
from twin.hal.supervisor import LOST_AFTER
from twin.jobs import wait_until
from twin.scenario.rig import RigFile

ALIKE = 0.05
"""Share by which the size in a panel's descriptor and the measured one may differ: its frame."""
CALIBRATE = "run `ballplate calibrate touch`, name its file as touch.calibration_file"


def plugged_in(config: LumioConfig, root: Path = HIDRAW_CLASS) -> Iterator[CheckResult]:
    """A line for each interface of the Lumio panels on USB, also if another port is read.

    Args:
        config: The screen's settings.
        root: Where the kernel describes raw HID devices.
    """
    port = str(Path(config.port).resolve())
    for each in panels(root):
        what = f"touch panel {each.port}"
        seen = f"{each.identity.text}: {each.what}{_size(each)}"
        chosen = config.protocol
        if each.port != port or config.transport != "hidraw":
            yield passed(what, seen)
        elif chosen in {"auto", each.identity.protocol} or not each.identity.protocol:
            yield passed(what, f"{seen}; this one is read, by its own descriptor")
        else:
            advice = f"it is read by its descriptor, not as {chosen}: set touch.protocol to auto"
            yield warned(what, seen, advice)


def _size(interface: Interface) -> str:
    layout = interface.layout
    if layout is None:
        return ""
    number = len(layout.contacts)
    contacts = f", {number} contact{'s' if number > 1 else ''} per report"
    return f", {_area(layout.extent)}{contacts}" if layout.extent else contacts


def calibrated(rig: RigFile, extent: tuple[float, float] | None) -> CheckResult:
    """Whether the screen's calibration was measured, and fits what the panel says of its size.

    Args:
        rig: The rig file.
        extent: Sides of the sensing area along the screen's x and y, m, if the panel tells.
    """
    what = "touch calibration"
    known, file = rig.screen().calibration, rig.touch and rig.touch.calibration_file
    if known is None:
        nominal = Mounting.of(Calibration.nominal()).size
        size = f"{_area(extent)} that the panel says" if extent else _area(nominal)
        return warned(what, f"never measured; square, centred, {size}: assumed", CALIBRATE)
    mounting = Mounting.of(known)
    width, height = mounting.size
    sides = (height, width) if mounting.swapped else (width, height)
    seen = _source(file)
    if extent and any(abs(a / b - 1) > ALIKE for a, b in zip(sides, extent, strict=True)):
        differ = f"{seen}: the sensing area is {_area(sides)}, but the panel says {_area(extent)}"
        return warned(what, differ, f"is it of another panel? {CALIBRATE}")
    return passed(what, f"{seen}: the sensing area is {_area(sides)}")


def _source(file: str | None) -> str:
    if file is None:
        return "in the rig file"
    made = read_calibration(Path(file))[1]
    number, rms, date = (made.get(name, "unknown") for name in ("points", "rms_mm", "date"))
    return f"{Path(file).name}, made {date}, {number} points, {rms} mm RMS"


def _area(sides: tuple[float, float]) -> str:
    return f"{100 * sides[0]:.1f} x {100 * sides[1]:.1f} cm"


ROCK = radians(3.0)
"""How far the plate is rocked about phi, either way."""
TIMES = 2
EDGES = ("short", "long")
"""Edges that dip when the plate is tilted about phi, and about theta: x lies along the length."""


@reported("which drive is phi", "reset the faults (--reset)")
def swapped(servos: AkdServos, cams: Transmission, ask: Ask) -> Iterator[CheckResult]:
    """Rock the plate about phi alone and ask which edges dipped.

    A drive and its plate encoder change places together when two nodes are exchanged, and the cams
    are alike: no measurement without a ball tells phi from theta, but anybody who looks does.

    Args:
        servos: The drives, started, without torque.
        cams: Plate angles to motor angles.
        ask: Asked for ``watch`` before and ``edge`` after; the answer is one of ``EDGES``.
    """
    _answer(servos, ask, "watch")
    level = hold_level(servos, cams)
    there: Array = np.array([[ROCK, 0.0]])
    for start, end in pairwise([level, *(there, -there) * TIMES, level]):
        if not turn(servos, cams.motor(start), cams.motor(end)):
            why = stopped_by(servos) or "the drives went off"
            yield failed("which drive is phi", why, "see the fault")
            return
    servos.quick_stop()
    exchange(servos, 0.1)
    yield _judged(_answer(servos, ask, "edge"))


def _answer(servos: AkdServos, ask: Ask, word: str) -> str:
    """What the person says, empty if there is nobody to ask; takes as long as they do.

    The drives are kept company meanwhile, or they would fault.
    """
    said: list[str] = []

    def asking() -> None:
        with suppress(Exception):  # of whatever kind: there is no answer
            said.append(ask(word))

    asked = Thread(target=asking, daemon=True)
    asked.start()
    while asked.is_alive():
        exchange(servos, servos.config.period)
    return said[0].strip().lower() if said else ""


def _judged(edge: str) -> CheckResult:
    what = "which drive is phi"
    if edge == EDGES[0]:
        return passed(what, "the short edges dipped when phi was moved")
    if edge == EDGES[1]:
        seen = "the long edges dipped when phi was moved: the drives are exchanged"
        return failed(what, seen, "exchange phi.node and theta.node in the rig file")
    return warned(what, "not answered with short or long", "watch the plate and answer")


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
        heard = screen.stream.heard
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
    yield noted("report rate", seen, slow if rate < SLOWEST else "")
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
    if not wait_until(lambda: screen.state is TouchState.TOUCHING, patience):
        yield failed("touch again", f"not within {patience:g} s", "put the ball back")


LEAST = 4
"""Points: three would fit whatever was touched."""
SHARE = 0.8
"""Of the screen's sides that the usual points span."""
READINGS = 20
"""Reports in a row that a point is the mean of, a third of a second of them."""
STILL = 0.003
"""Spread of these, in sides of the screen, beyond which the touch is still settling or moving."""
SLIP = 0.003
"""Distance in m by which a finger or a ball misses a mark at most (assumed)."""
SCATTER = 0.005
"""Root mean square in m from which the points cannot be those that were asked for."""
SCREEN_UNITS = Calibration(((1.0, 0.0), (0.0, 1.0)), (0.0, 0.0))


def usual_points() -> list[tuple[float, float]]:
    """Nine points in rows over most of the screen, m in plate axes."""
    x, y = (round(SHARE * side / 2, 3) for side in SCREEN[:2])
    return [(i * x, j * y) for j in (-1, 0, 1) for i in (-1, 0, 1)]


@dataclass(frozen=True)
class MeasuredTouch:
    """A measured calibration.

    Attributes:
        fit: The calibration and what it leaves.
        points: The points touched, m in plate axes, shape (K, 2).
    """

    fit: CalibrationFit
    points: Array

    @property
    def mounting(self) -> Mounting:
        """What it says of the screen."""
        return Mounting.of(self.fit.calibration)

    def as_dict(self) -> dict[str, Any]:
        """What it says and leaves, for ``--json``."""
        return {
            **self.mounting.as_dict(),
            "points": len(self.points),
            "rms_mm": round(1e3 * self.fit.rms, 4),
            "residuals": [
                {"point_mm": point, "off_mm": off}
                for point, off in zip(
                    np.round(1e3 * self.points, 3).tolist(),
                    np.round(1e3 * self.fit.left, 4).tolist(),
                    strict=True,
                )
            ],
        }

    def save(self, path: Path) -> None:
        """Write the file that a rig file names as ``touch.calibration_file``."""
        date = time.strftime("%Y-%m-%d")
        made = {"made": "measured on a rig", "date": date, **self.as_dict()}
        self.fit.calibration.save(path, made)


def measure(
    config: LumioConfig,
    points: Sequence[tuple[float, float]],
    ask: Ask,
    patience: float,
    progress: Callable[[float], None] = lambda _: None,
) -> MeasuredTouch:
    """Have points touched in turn and fit the calibration to what the screen says.

    Args:
        config: The screen's settings; its calibration is not used.
        points: Where to touch, m in plate axes.
        ask: Asks for a touch, ``touch X Y`` in mm, and for its end, ``lift``.
        patience: Seconds that each of these is waited for.
        progress: Called with the number of points done.

    Raises:
        CalibrationError: Too few points, all on one line, or touched wrongly.
        RigError: The screen cannot be opened, or a point was not touched.
    """
    goals = np.array(points, float).reshape(-1, 2)
    if len(goals) < LEAST:
        raise CalibrationError(
            f"calibration: {len(goals)} points; {LEAST} or more are needed to see a wrong one"
        )
    check_spread(goals)
    gate = PlausibilityLimits()
    screen = LumioScreen(replace(config, calibration=SCREEN_UNITS, gate=gate))
    seen = []
    with screen:
        for index, goal in enumerate(goals):
            words = place(goal)
            ask(f"touch {1e3 * goal[0]:g} {1e3 * goal[1]:g}")
            seen.append(_read(screen, words, patience))
            ask("lift")
            if not wait_until(lambda: screen.state is TouchState.LOST, patience):
                raise RigError(f"calibration: {words} was not let go within {patience:g} s")
            progress(index + 1)
    return MeasuredTouch(judged(np.array(seen), goals), goals)


def judged(seen: Array, points: Array) -> CalibrationFit:
    """The calibration of touched points.

    Args:
        seen: What the screen said, screen units, shape (K, 2).
        points: Where they are, m, shape (K, 2).

    Raises:
        CalibrationError: They do not fit together; one that does not fit the others is named.
    """
    wrong = outlier(seen, points)
    if wrong is not None and wrong[1] > SLIP:
        index, distance = wrong
        raise CalibrationError(
            f"calibration: point {index + 1}, {place(points[index])}, was touched "
            f"{1e3 * distance:.1f} mm from where the others put it; begin again"
        )
    found = fit(seen, points)
    if found.rms > SCATTER:
        raise CalibrationError(
            f"calibration: the points do not fit together ({1e3 * found.rms:.1f} mm RMS, at most "
            f"{1e3 * SCATTER:g}); touch them in the order in which they are asked for"
        )
    return found


def place(point: Array) -> str:
    """A point of the plate in words."""
    return f"x {1e3 * point[0]:+.0f}, y {1e3 * point[1]:+.0f} mm"


def _read(screen: LumioScreen, words: str, patience: float) -> tuple[float, float]:
    """The mean position of a steady touch, screen units."""
    before = screen.stream.sample
    kept: list[Sample] = []

    def steady() -> bool:
        sample, last = screen.stream.sample, kept[-1] if kept else before
        if any(fault.condition is TWO_CONTACTS for fault in screen.faults()):
            kept.clear()
        elif sample is not None and (last is None or sample.time > last.time):
            if kept and sample.time - kept[-1].time > screen.config.gate.lost:
                kept.clear()
            kept.append(sample)
            del kept[:-READINGS]
        if len(kept) < READINGS:
            return False
        return bool(np.ptp([each.position for each in kept], axis=0).max() < STILL)

    if not wait_until(steady, patience):
        hint = f"; {screen.hint}" if screen.hint and not kept else ""
        what = "touched steadily" if kept else "touched"
        raise RigError(f"calibration: {words} was not {what} within {patience:g} s{hint}")
    x, y = np.mean([each.position for each in kept], axis=0).tolist()
    return x, y
