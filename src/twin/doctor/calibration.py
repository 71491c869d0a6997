"""What is measured on a rig for its files: cam table, lost motion, touch calibration."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import degrees, radians
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.conditions import TWO_CONTACTS
from twin.devices.lumio.config import (
    Calibration,
    CalibrationError,
    CalibrationFit,
    LumioConfig,
    PlausibilityLimits,
    fit,
)
from twin.devices.lumio.screen import LumioScreen, Sample, TouchState
from twin.doctor.check import Ask
from twin.doctor.drives import exchange, hold_level, stopped_by, turn
from twin.errors import RigError
from twin.hal.cams import CamTable
from twin.hal.interface import SCREEN
from twin.identify.plate_motion import LostMotion, as_plate, lost_motion, triangle
from twin.jobs import wait_until

RATE = np.radians(10.0)
"""How fast the plate is brought from point to point, rad/s."""
SETTLE = 0.1
"""Seconds that it stands before it is read."""
PERIODS = 25
"""Periods over which it is read: counts and noise of the encoder average out."""
DEGREE = 3
"""Of the polynomial by which the rig differs from the table it is compared with."""


def measure_cams(
    servos: AkdServos,
    known: CamTable,
    *,
    reach: float,
    lines: int,
    progress: Callable[[float], None] = lambda _: None,
) -> CamTable:
    """Measure the cams with the ball off the plate; it stands level at the beginning.

    Args:
        servos: The drives, not started.
        known: The table of the model, by which the points are found.
        reach: Largest plate angle either way, rad.
        lines: Points along each axis.
        progress: Called with the number of points done.

    Returns:
        The table; its provenance has the number of points, the largest difference of plate angles
        to the known table and the root mean square that this one leaves, both in deg.

    Raises:
        RigError: The drives went off on the way.
        DriveError: They cannot be brought up.
    """
    servos.start()
    try:
        motor, plate = _readings(servos, known, reach, lines, progress)
    finally:
        servos.stop()
    off = motor - known.motor(plate)
    basis = _powers(plate)
    weights = np.linalg.lstsq(basis, off, rcond=None)[0]
    left = (off - basis @ weights) / known.ratio
    nodes = np.stack(np.meshgrid(known.grid, known.grid, indexing="ij"), axis=-1)
    # beyond what was reached the difference stays what it was at the edge
    angles = known.angles + _powers(np.clip(nodes, -reach, reach)) @ weights
    provenance: dict[str, Any] = {
        "made": "measured on a rig",
        "date": time.strftime("%Y-%m-%d"),
        "points": len(plate),
        "reach_deg": round(degrees(reach), 3),
        "before_deg": round(float(np.degrees(np.abs(off).max() / known.ratio)), 5),
        "rms_deg": round(float(np.degrees(np.sqrt(np.mean(left**2)))), 5),
    }
    return CamTable(known.grid, angles, provenance)


def _readings(
    servos: AkdServos,
    known: CamTable,
    reach: float,
    lines: int,
    progress: Callable[[float], None],
) -> tuple[Array, Array]:
    """Motor and plate angles at every point, shape (points, 2) each."""
    here = level = hold_level(servos, known)
    motor: list[Array] = []
    plate: list[Array] = []
    for goal in (*_path(reach, lines), level):
        seconds = max(0.2, 2 * float(np.abs(goal - here).max()) / RATE)
        if not turn(servos, known.motor(here), known.motor(goal), seconds):
            raise RigError(f"measuring the cams was stopped: {stopped_by(servos) or 'drives off'}")
        exchange(servos, SETTLE)
        read: Array = np.zeros((2, 2))
        for _ in range(PERIODS):
            exchange(servos, servos.config.period)
            read = read + np.concatenate((servos.motor(), servos.plate())) / PERIODS
        motor.append(read[0])
        plate.append(read[1])
        here = goal
        progress(len(plate))
    return np.array(motor), np.array(plate)


def _path(reach: float, lines: int) -> list[Array]:
    """Points line by line, there and back, so that each move is short."""
    steps = np.linspace(-reach, reach, lines)
    return [
        np.array([[phi, theta]])
        for index, phi in enumerate(steps)
        for theta in (steps if index % 2 == 0 else steps[::-1])
    ]


def _powers(plate: Array) -> Array:
    """The monomials of both plate angles up to a degree, shape (..., monomials)."""
    phi, theta = plate[..., 0], plate[..., 1]
    return np.stack(
        [phi**i * theta**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], axis=-1
    )


AXES = ("phi", "theta")
STEPS = 100
"""How often ``progress`` is told."""


def measure_lost_motion(
    servos: AkdServos,
    known: CamTable,
    *,
    amplitude: float,
    rate: float = radians(1.0),
    cycles: int = 3,
    progress: Callable[[float], None] = lambda _: None,
) -> list[LostMotion]:
    """Lost motion of both axes with the ball off the plate; it stands level at the beginning.

    Args:
        servos: The drives, not started.
        known: The cam table.
        amplitude: Of the triangle, rad of the plate.
        rate: How fast, rad/s of the plate.
        cycles: Whole cycles of each axis, 2 or more, after a quarter.
        progress: Called with the share done, 0 to 1.

    Raises:
        RigError: The drives went off on the way, or the plate did not move.
        DriveError: They cannot be brought up.
    """
    path = triangle(amplitude, rate, cycles, servos.config.period)
    paths = np.zeros((len(AXES), len(path), 1, 2))
    for axis in range(len(AXES)):
        paths[axis, :, 0, axis] = path
    goals, level = known.motor(paths), known.motor(np.zeros((1, 2)))
    read = []
    servos.start()
    try:
        hold_level(servos, known)
        for axis, goal in enumerate(goals):
            read.append(_followed(servos, goal, axis, progress))
            if not turn(servos, servos.motor(), level):
                raise _stopped(servos)
    finally:
        servos.stop()
    # not before: what computes does not keep the drives' heartbeat
    return [
        lost_motion(name, as_plate(known, motor, axis), plate, cycles)
        for axis, (name, (motor, plate)) in enumerate(zip(AXES, read, strict=True))
    ]


def _followed(
    servos: AkdServos, goals: Array, axis: int, progress: Callable[[float], None]
) -> tuple[Array, Array]:
    """Angles of one axis's motor and plate, rad, once a period, shape (K,) each."""
    count, period = len(goals) - 1, servos.config.period
    motor, plate = np.empty(count), np.empty(count)
    for k in range(count):
        if not servos.enabled:
            raise _stopped(servos)
        ahead = (goals[k + 1] - goals[k]) / period
        servos.command(ahead + 20 * (goals[k] - servos.motor()))
        exchange(servos, period)
        motor[k], plate[k] = servos.motor()[0, axis], servos.plate()[0, axis]
        if k % max(1, count // STEPS) == 0:
            progress((axis + k / count) / len(AXES))
    servos.command(np.zeros((1, 2)))
    return motor, plate


def _stopped(servos: AkdServos) -> RigError:
    return RigError(f"the triangle was stopped: {stopped_by(servos) or 'drives off'}")


SHARE = 0.8
"""Of the screen's sides that the usual points span."""
READINGS = 20
"""Reports in a row that a point is the mean of, a third of a second of them."""
STILL = 0.003
"""Spread of these, in sides of the screen, beyond which the touch is still settling or moving."""
SLIP = 0.003
"""Distance in m by which a finger or a ball misses a mark at most (assumed)."""
SCREEN_UNITS = Calibration(((1.0, 0.0), (0.0, 1.0)), (0.0, 0.0))


def usual_points() -> list[tuple[float, float]]:
    """Nine points in rows over most of the screen, m in plate axes."""
    x, y = (round(SHARE * side / 2, 3) for side in SCREEN[:2])
    return [(i * x, j * y) for j in (-1, 0, 1) for i in (-1, 0, 1)]


def measure_touch(
    config: LumioConfig,
    points: Sequence[tuple[float, float]],
    ask: Ask,
    patience: float,
    progress: Callable[[float], None] = lambda _: None,
) -> CalibrationFit:
    """Have points touched in turn and fit the calibration to what the screen says.

    Args:
        config: The screen's settings; its calibration is not used.
        points: Where to touch, m in plate axes.
        ask: Asks for a touch, ``touch X Y`` in mm, and for its end, ``lift``.
        patience: Seconds that each of these is waited for.
        progress: Called with the number of points done.

    Raises:
        CalibrationError: Points were touched wrongly.
        RigError: The screen cannot be opened, or a point was not touched.
    """
    goals = np.array(points, float).reshape(-1, 2)
    gate = PlausibilityLimits()
    screen = LumioScreen(replace(config, calibration=SCREEN_UNITS, gate=gate))
    seen = []
    with screen:
        for index, goal in enumerate(goals):
            words = place(goal)
            ask(f"touch {1e3 * goal[0]:g} {1e3 * goal[1]:g}")
            seen.append(_touched(screen, words, patience))
            ask("lift")
            if not wait_until(lambda: screen.state is TouchState.LOST, patience):
                raise RigError(f"calibration: {words} was not let go within {patience:g} s")
            progress(index + 1)
    return judged(np.array(seen), goals)


def judged(seen: Array, points: Array) -> CalibrationFit:
    """The calibration of touched points.

    Args:
        seen: What the screen said, screen units, shape (K, 2).
        points: Where they are, m, shape (K, 2).

    Raises:
        CalibrationError: They do not fit together; the one farthest off is named.
    """
    found = fit(seen, points)
    worst = int(found.distances.argmax())
    if found.distances[worst] > SLIP:
        raise CalibrationError(
            f"calibration: the points do not fit together: {worst + 1}, {place(points[worst])}, is "
            f"{1e3 * found.distances[worst]:.1f} mm off, at most {1e3 * SLIP:g}; touch them in the "
            "order in which they are asked for"
        )
    return found


def place(point: Array) -> str:
    """A point of the plate in words."""
    return f"x {1e3 * point[0]:+.0f}, y {1e3 * point[1]:+.0f} mm"


def _touched(screen: LumioScreen, words: str, patience: float) -> tuple[float, float]:
    """The mean position of a steady touch, screen units."""
    before = screen.stream.tracker.sample
    kept: list[Sample] = []

    def steady() -> bool:
        sample, last = screen.stream.tracker.sample, kept[-1] if kept else before
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
