"""Measurements for the files of a rig: cam table, lost motion, touch calibration."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import degrees, radians
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.arrays import Array
from twin.base.errors import RigError
from twin.base.jobs import wait_until
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
from twin.doctor.drives import FOLLOWING_GAIN_PER_S, exchange, hold_level, stopped_by, turn
from twin.hal.cams import CamTable
from twin.hal.interface import AXIS_NAMES, SCREEN_SIZE_M
from twin.identify.plate_motion import LostMotion, as_plate, lost_motion, triangle

if TYPE_CHECKING:
    from twin.devices.akd.servos import AkdServos


@dataclass(frozen=True, kw_only=True)
class CamSweep:
    """How the cams are measured.

    Attributes:
        rate_rad_s: Mean rate of the plate from point to point, rad/s; the largest is pi / 2 times
            that, as the motion is half a cosine.
        min_move_s: Shortest duration in s of a move.
        settle_s: Time in s for which the plate rests before its angles are read.
        read_periods: Periods over which they are averaged, against counts and noise of the
            encoder.
        degree: Degree of the polynomial for the deviation of the rig from the table.
    """

    rate_rad_s: float = radians(10.0)
    min_move_s: float = 0.2
    settle_s: float = 0.1
    read_periods: int = 25
    degree: int = 3


CAM_SWEEP = CamSweep()


def measure_cams(
    servos: AkdServos,
    known: CamTable | None = None,
    *,
    reach: float,
    lines: int,
    progress: Callable[[float], None] = lambda _: None,
    sweep: CamSweep = CAM_SWEEP,
) -> CamTable:
    """Measure the cams with the ball off the plate, which is level at the beginning.

    Args:
        servos: The drives, not started.
        known: Table by which the points are approached; the model's by default.
        reach: Largest plate angle either way, rad.
        lines: Points along each axis.
        progress: Called with the number of points done.
        sweep: Constants of the measurement.

    Returns:
        The table; its provenance has the number of points, the largest difference of plate angles
        to the known table and the root mean square that this one leaves, both in deg.

    Raises:
        RigError: The drives lost their torque during the measurement.
        DriveError: They cannot be brought up.
    """
    known = known or CamTable.packaged()
    servos.start()
    try:
        motor, plate = _read_points(servos, known, _path(reach, lines), progress, sweep)
    finally:
        servos.stop()
    off = motor - known.motor(plate)
    basis = _powers(plate, sweep.degree)
    weights = np.linalg.lstsq(basis, off, rcond=None)[0]
    left = (off - basis @ weights) / known.ratio
    nodes = np.stack(np.meshgrid(known.grid, known.grid, indexing="ij"), axis=-1)
    # beyond the reached angles the difference keeps its value at their edge
    angles = known.angles + _powers(np.clip(nodes, -reach, reach), sweep.degree) @ weights
    provenance: dict[str, Any] = {
        "made": "measured on a rig",
        "date": time.strftime("%Y-%m-%d"),
        "points": len(plate),
        "reach_deg": round(degrees(reach), 3),
        "before_deg": round(float(np.degrees(np.abs(off).max() / known.ratio)), 5),
        "rms_deg": round(float(np.degrees(np.sqrt(np.mean(left**2)))), 5),
    }
    return CamTable(known.grid, angles, provenance)


def _read_points(
    servos: AkdServos,
    known: CamTable,
    points: list[Array],
    progress: Callable[[float], None],
    sweep: CamSweep,
) -> tuple[Array, Array]:
    """Motor and plate angles at points and at the level plate, shape (points + 1, 2) each."""
    here = level = hold_level(servos, known)
    motor: list[Array] = []
    plate: list[Array] = []
    for goal in (*points, level):
        distance = 2 * float(np.abs(goal - here).max())
        seconds = max(sweep.min_move_s, distance / sweep.rate_rad_s)
        if not turn(servos, known.motor(here), known.motor(goal), seconds):
            raise RigError(f"measuring the cams was stopped: {stopped_by(servos) or 'drives off'}")
        exchange(servos, sweep.settle_s)
        read: Array = np.zeros((2, 2))
        for _ in range(sweep.read_periods):
            exchange(servos, servos.config.period)
            read = read + np.concatenate((servos.motor(), servos.plate())) / sweep.read_periods
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


def _powers(plate: Array, degree: int) -> Array:
    """The monomials of both plate angles up to a degree, shape (..., monomials)."""
    phi, theta = plate[..., 0], plate[..., 1]
    return np.stack(
        [phi**i * theta**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1
    )


PROGRESS_STEPS = 100
"""Calls of ``progress`` for each axis, about."""


def measure_lost_motion(
    servos: AkdServos,
    known: CamTable,
    *,
    amplitude: float,
    rate: float = radians(1.0),
    cycles: int = 3,
    progress: Callable[[float], None] = lambda _: None,
) -> list[LostMotion]:
    """Lost motion of both axes with the ball off the plate, which is level at the beginning.

    Args:
        servos: The drives, not started.
        known: The cam table.
        amplitude: Plate angle of the triangle, rad.
        rate: Plate rate, rad/s.
        cycles: Whole cycles of each axis, 2 or more, after a quarter.
        progress: Called with the share done, 0 to 1.

    Raises:
        RigError: The drives lost their torque during it, or the plate did not move.
        DriveError: They cannot be brought up.
    """
    path = triangle(amplitude, rate, cycles, servos.config.period)
    paths = np.zeros((len(AXIS_NAMES), len(path), 1, 2))
    for axis in range(len(AXIS_NAMES)):
        paths[axis, :, 0, axis] = path
    goals, level = known.motor(paths), known.motor(np.zeros((1, 2)))
    read = []
    servos.start()
    try:
        hold_level(servos, known)
        for axis, goal in enumerate(goals):
            read.append(_record_motion(servos, goal, axis, progress))
            if not turn(servos, servos.motor(), level):
                raise _stopped_error(servos)
    finally:
        servos.stop()
    # not before: what computes does not keep the drives' heartbeat
    return [
        lost_motion(name, as_plate(known, motor, axis), plate, cycles)
        for axis, (name, (motor, plate)) in enumerate(zip(AXIS_NAMES, read, strict=True))
    ]


def _record_motion(
    servos: AkdServos, goals: Array, axis: int, progress: Callable[[float], None]
) -> tuple[Array, Array]:
    """Angles of one axis's motor and plate, rad, once a period, shape (K,) each."""
    count, period = len(goals) - 1, servos.config.period
    motor, plate = np.empty(count), np.empty(count)
    for k in range(count):
        if not servos.enabled:
            raise _stopped_error(servos)
        ahead = (goals[k + 1] - goals[k]) / period
        servos.command(ahead + FOLLOWING_GAIN_PER_S * (goals[k] - servos.motor()))
        exchange(servos, period)
        motor[k], plate[k] = servos.motor()[0, axis], servos.plate()[0, axis]
        if k % max(1, count // PROGRESS_STEPS) == 0:
            progress((axis + k / count) / len(AXIS_NAMES))
    servos.command(np.zeros((1, 2)))
    return motor, plate


def _stopped_error(servos: AkdServos) -> RigError:
    return RigError(f"the triangle was stopped: {stopped_by(servos) or 'drives off'}")


@dataclass(frozen=True, kw_only=True)
class TouchMeasurement:
    """How the calibration of a touch screen is measured.

    Attributes:
        point_span: Share of the screen's sides that the usual points span.
        reports: Number of consecutive reports that are averaged for a point, a third of a second.
        max_spread: Spread of these, in sides of the screen, above which the touch is still settling
            or moving.
        max_mark_error_m: Largest distance in m by which a finger or a ball misses a mark (assumed).
    """

    point_span: float = 0.8
    reports: int = 20
    max_spread: float = 0.003
    max_mark_error_m: float = 0.003


TOUCH_MEASUREMENT = TouchMeasurement()
SCREEN_UNITS = Calibration(((1.0, 0.0), (0.0, 1.0)), (0.0, 0.0))
"""The calibration that leaves positions in sides of the screen."""


def usual_points(measurement: TouchMeasurement = TOUCH_MEASUREMENT) -> list[tuple[float, float]]:
    """Nine points in rows over most of the screen, m in plate axes."""
    x, y = (round(measurement.point_span * side / 2, 3) for side in SCREEN_SIZE_M)
    return [(i * x, j * y) for j in (-1, 0, 1) for i in (-1, 0, 1)]


def measure_touch(
    config: LumioConfig,
    points: Sequence[tuple[float, float]],
    ask: Ask,
    patience: float,
    progress: Callable[[float], None] = lambda _: None,
    measurement: TouchMeasurement = TOUCH_MEASUREMENT,
) -> CalibrationFit:
    """Request touches of points in turn and fit the calibration to what the screen reports.

    Args:
        config: The screen's settings; its calibration is not used.
        points: Where to touch, m in plate axes.
        ask: Requests a touch, ``touch X Y`` in mm, and its end, ``lift``.
        patience: Longest time in s that each of these is waited for.
        progress: Called with the number of points done.
        measurement: Constants of the measurement.

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
            seen.append(_measure_touch(screen, words, patience, measurement))
            ask("lift")
            if not wait_until(lambda: screen.state is TouchState.LOST, patience):
                raise RigError(f"calibration: {words} was not released within {patience:g} s")
            progress(index + 1)
    return fit_calibration(np.array(seen), goals, measurement)


def fit_calibration(
    seen: Array, points: Array, measurement: TouchMeasurement = TOUCH_MEASUREMENT
) -> CalibrationFit:
    """The calibration of touched points.

    Args:
        seen: Positions that the screen reported, screen units, shape (K, 2).
        points: The same points on the plate, m, shape (K, 2).
        measurement: Constants of the measurement.

    Raises:
        CalibrationError: They do not fit together; the one with the largest error is named.
    """
    found, largest = fit(seen, points), measurement.max_mark_error_m
    worst = int(found.distances.argmax())
    if found.distances[worst] > largest:
        raise CalibrationError(
            f"calibration: the points contradict one another: {worst + 1}, "
            f"{place(points[worst])}, is {1e3 * found.distances[worst]:.1f} mm off, at most "
            f"{1e3 * largest:g}; touch them in the order in which they are requested"
        )
    return found


def _measure_touch(
    screen: LumioScreen, words: str, patience: float, measurement: TouchMeasurement
) -> tuple[float, float]:
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
            del kept[: -measurement.reports]
        if len(kept) < measurement.reports:
            return False
        spread = np.ptp([each.position for each in kept], axis=0).max()
        return bool(spread < measurement.max_spread)

    if not wait_until(steady, patience):
        hint = f"; {screen.hint}" if screen.hint and not kept else ""
        what = "touched steadily" if kept else "touched"
        raise RigError(f"calibration: {words} was not {what} within {patience:g} s{hint}")
    x, y = np.mean([each.position for each in kept], axis=0).tolist()
    return x, y


def place(point: Array) -> str:
    """A point of the plate in words."""
    return f"x {1e3 * point[0]:+.0f}, y {1e3 * point[1]:+.0f} mm"
