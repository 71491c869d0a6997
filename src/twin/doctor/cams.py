"""The cam table of a rig, measured on it: the plate is brought to a grid of angles and read."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import degrees
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.servos import AkdServos
from twin.doctor.steps import exchange, hold_level, stopped_by, turn
from twin.errors import RigError
from twin.hal.cams import CamTable

RATE = np.radians(10.0)
"""How fast the plate is brought from point to point, rad/s."""
SETTLE = 0.1
"""Seconds that it stands before it is read."""
READINGS = 25
"""Periods over which it is read: counts and noise of the encoder average out."""
DEGREE = 3
"""Of the polynomial by which the rig differs from the table it is compared with."""


@dataclass(frozen=True)
class MeasuredCams:
    """A measured table, and how well it fits the readings.

    Attributes:
        table: Plate angles to motor angles.
        before_deg: Largest difference of plate angles to the table known before, deg.
        rms_deg: Root mean square that the new table leaves, deg.
        points: Number of points.
    """

    table: CamTable
    before_deg: float
    rms_deg: float
    points: int


def measure(
    servos: AkdServos,
    known: CamTable,
    *,
    reach: float,
    lines: int,
    progress: Callable[[float], None] = lambda _: None,
) -> MeasuredCams:
    """Measure the cams with the ball off the plate; it stands level at the beginning.

    Args:
        servos: The drives, not started.
        known: The table of the model, by which the points are found.
        reach: Largest plate angle either way, rad.
        lines: Points along each axis.
        progress: Called with the number of points done.

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
    rms = round(float(np.degrees(np.sqrt(np.mean(left**2)))), 5)
    provenance: dict[str, Any] = {
        "made": "measured on a rig",
        "date": time.strftime("%Y-%m-%d"),
        "points": len(plate),
        "reach_deg": round(degrees(reach), 3),
        "rms_deg": rms,
    }
    return MeasuredCams(
        CamTable(known.grid, angles, provenance),
        float(np.degrees(np.abs(off).max() / known.ratio)),
        rms,
        len(plate),
    )


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
        for _ in range(READINGS):
            exchange(servos, servos.config.period)
            read = read + np.concatenate((servos.motor(), servos.plate())) / READINGS
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
