"""Lost motion by dry friction of the plate's joints, as the mechanism has it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.hal.cams import CamTable
from twin.identify.lost_motion import as_plate, lost_motion, triangle
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.parts import Parts

TORQUES = (0.0, 0.15, 1.0, 3.0, 7.0)
"""Of each joint, N m; 0.15 is what dry bushes may have."""
BESIDE = (0.6, 0.0, 0.0, 0.0)
"""Start of the ball: off the rig."""
PERIOD, AMPLITUDE, RATE, CYCLES = 0.002, 1.0, 1.0, 2
"""Of the triangle: s, deg and deg/s of the plate."""


class Loop(NamedTuple):
    """What a slow triangle of phi shows: loop in deg, least force of its wheel on the cam in N."""

    torque: float
    width: float
    force: float


def loops() -> list[Loop]:
    """The triangle on the mechanism with every torque; one rig each, for forces are sensed so."""
    return [_loop(torque) for torque in TORQUES]


def _loop(torque: float) -> Loop:
    plant, cams = Mechanism(parts=Parts(joint_friction=torque)), CamTable.packaged()
    plant.start(np.array([BESIDE]))
    angles = triangle(math.radians(AMPLITUDE), math.radians(RATE), CYCLES, PERIOD)
    goals = cams.motor(np.stack((angles, np.zeros_like(angles)), axis=-1))
    motor, plate, force = (np.empty(len(angles) - 1) for _ in range(3))
    for k, rate in enumerate(np.diff(goals, axis=0) / PERIOD):
        plant.advance(rate[None], round(PERIOD / plant.step))
        motor[k], plate[k] = plant.motor[0, 0], plant.state[0, 2]
        force[k] = plant.telemetry()[0, 0]
    found = lost_motion("phi", as_plate(cams, motor, 0), plate, CYCLES)
    return Loop(torque, found.width, float(force.min()))
