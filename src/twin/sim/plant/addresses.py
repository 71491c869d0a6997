"""Where everything of interest stands in the arrays of a batch of mechanisms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from twin.sim.plant.model import NAMES

Indices = NDArray[np.integer]

TELEMETRY = {
    "wheel_phi_N": "wheel_phi_force",
    "wheel_theta_N": "wheel_theta_force",
    "ball_N": "ball_force",
    "torque_phi_Nm": "torque_phi",
    "torque_theta_Nm": "torque_theta",
    "spring_m": "spring_length",
    "motor_phi_rad": "motor_phi",
    "motor_theta_rad": "motor_theta",
}
"""Name in the record, and the sensor whose first number it is."""


@dataclass(frozen=True)
class Addresses:
    """Places of a mechanism in the engine's arrays; axes are ordered phi, theta.

    Attributes:
        level: The keyframe that is level and at rest.
        ball_pose: In ``qpos`` the ball's centre; its orientation follows.
        ball_rate: In ``qvel`` the ball's velocity and angular velocity.
        poses: In ``qpos`` both plate angles and the ball's centre, shape (5,).
        rates: In ``qvel`` their rates, shape (5,).
        state: In ``sensordata`` the state in the order of (5.5), shape (8,).
        over: In ``sensordata`` whether the ball is on the screen.
        told: In ``sensordata`` what ``TELEMETRY`` names, shape (channels,).
        servo: In ``ctrl`` the motor rates.
        shaft: In ``qpos`` the motor shafts' angles.
    """

    level: int
    ball_pose: slice
    ball_rate: slice
    poses: Indices
    rates: Indices
    state: Indices
    over: int
    told: Indices
    servo: slice | list[int]
    shaft: slice | list[int]

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Self:
        """Those of a model that has all names the plant asks for."""
        ball = model.joint("ball")
        plate = [model.joint(axis) for axis in ("phi", "theta")]
        pose, rate = ball.qposadr[0], ball.dofadr[0]
        at = {name: int(model.sensor(name).adr[0]) for name in NAMES["sensor"]}
        place, speed = at["ball_position"], at["ball_velocity"]
        along_x = place, speed, at["phi"], at["phi_rate"]
        along_y = place + 1, speed + 1, at["theta"], at["theta_rate"]
        return cls(
            level=model.key("level").id,
            ball_pose=slice(pose, pose + 3),
            ball_rate=slice(rate, rate + 6),
            poses=np.array([*(joint.qposadr[0] for joint in plate), *range(pose, pose + 3)]),
            rates=np.array([*(joint.dofadr[0] for joint in plate), *range(rate, rate + 3)]),
            state=np.array([*along_x, *along_y]),
            over=at["ball_on_plate"],
            told=np.array([at[sensor] for sensor in TELEMETRY.values()]),
            servo=_columns([model.actuator(f"servo_{axis}").id for axis in ("phi", "theta")]),
            shaft=_columns([model.joint(f"cam_{axis}").qposadr[0] for axis in ("phi", "theta")]),
        )


def _columns(ids: Sequence[int]) -> slice | list[int]:
    """Two columns as a slice where their order allows it: slices are cheap to read and write."""
    first, second = (int(i) for i in ids)
    if second > first:
        return slice(first, second + 1, second - first)
    return [first, second]
