"""A slow triangle on the plate, one axis after the other: motors against plate encoders."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.servos import AkdServos
from twin.doctor.steps import exchange, hold_level, stopped_by, turn
from twin.errors import RigError
from twin.hal.cams import CamTable
from twin.identify.plate_motion import LostMotion, as_plate, lost_motion, triangle

AXES = ("phi", "theta")
STEPS = 100
"""How often ``progress`` is told."""


def measure(
    servos: AkdServos,
    known: CamTable,
    *,
    amplitude: float,
    rate: float,
    cycles: int,
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
