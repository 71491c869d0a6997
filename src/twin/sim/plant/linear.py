"""The mechanism about its level rest as a linear system, by the engine's finite differences."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from controllers import ballplate
from controllers.arrays import Array
from twin.errors import ModelError
from twin.sim.plant.mechanism import free_dimension
from twin.sim.plant.model import cam_ratio, load_model
from twin.sim.plant.parts import Parts

STATES = (
    *ballplate.STATES,
    *("motor_phi", "motor_phi_rate", "motor_theta", "motor_theta_rate"),
    *("servo_phi", "servo_theta", "ball_turn_x", "ball_turn_y"),
)
"""Ball and plate as in (5.5); motor angles and rates; the servos' set points in rad; the rates at
which the ball turns about the axes x and y in rad/s, which follow its speed within some 20 ms."""

PERTURBATION = 1e-7
LEAST_LEAK = 1e-6


class LinearMechanism(NamedTuple):
    """x[k+1] = A x[k] + B u[k] from one physics step to the next, u being held motor rates.

    Attributes:
        A: Shape (16, 16), states as ``STATES`` says.
        B: Shape (16, 2), from motor rates (phi, theta) in rad/s.
        step: Physics step in s.
        ratio: Motor angle per plate angle about level, dimensionless.
    """

    A: Array
    B: Array
    step: float
    ratio: float


def linear_mechanism(parts: Parts | None = None, step: float | None = None) -> LinearMechanism:
    """The mechanism about the level plate with its ball at rest on the centre.

    Dry friction, of the rolling ball and of the plate's joints, is left out: what it holds has no
    motion to linearise. So is a tilt of the base, under which the ball does not rest. Of the
    engine's states those are dropped that the others do not depend on: height, attitude and spin
    of the ball.

    Args:
        parts: What differs from the model file.
        step: Physics step in s; None for the model's own.

    Raises:
        ModelError: If the parts cannot be used, or ball and plate move by the attitude of the ball,
            as they do where it is oval or out of balance.
    """
    model = load_model(
        parts=replace(parts or Parts(), joint_friction=None, level=None), drawn=False
    )
    if step is not None:
        model.opt.timestep = step
    contact = model.pair("ball_plate").id
    model.pair_dim[contact] = free_dimension(model)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    size = 2 * model.nv + model.na
    A, B = np.zeros((size, size)), np.zeros((size, model.nu))
    C = np.zeros((model.nsensordata, size))
    mujoco.mjd_transitionFD(model, data, PERTURBATION, True, A, B, C, None)
    T = np.concatenate((_kept(model, C), _dropped(model)))
    n = len(STATES)
    A = T @ A @ np.linalg.inv(T)
    if np.abs(A[:n, n:]).max() > LEAST_LEAK:
        raise ModelError(
            "mechanism: a ball that is oval or out of balance moves by its attitude: ball and "
            "plate alone are no linear model of it"
        )
    servos = [model.actuator(f"servo_{axis}").id for axis in ("phi", "theta")]
    B = (T @ B)[:n, servos]
    return LinearMechanism(A[:n, :n], B, float(model.opt.timestep), cam_ratio(model))


def _kept(model: mujoco.MjModel, C: Array) -> Array:
    """``STATES`` of small deviations of the engine's state, shape (16, size).

    Args:
        model: The mechanism.
        C: Sensors of the same deviations, shape (sensors, size).
    """
    at = {name: int(model.sensor(name).adr[0]) for name in ("ball_position", "ball_velocity")}
    position, velocity = at["ball_position"], at["ball_velocity"]
    one = np.eye(C.shape[1])

    def joint(name: str) -> tuple[Array, Array]:
        dof = model.joint(name).dofadr[0]
        return one[dof], one[model.nv + dof]

    turn = model.nv + model.joint("ball").dofadr[0] + 3
    return np.stack(
        (
            *(C[position], C[velocity], *joint("phi")),
            *(C[position + 1], C[velocity + 1], *joint("theta")),
            *(*joint("cam_phi"), *joint("cam_theta")),
            *(one[2 * model.nv + model.actuator(f"servo_{a}").actadr[0]] for a in ("phi", "theta")),
            *(one[turn], one[turn + 1]),
        )
    )


def _dropped(model: mujoco.MjModel) -> Array:
    """The other states: height and its rate, three angles of attitude, and spin, (6, size)."""
    ball = model.joint("ball").dofadr[0]
    height, attitude = ball + 2, [ball + 3, ball + 4, ball + 5]
    others = [height, *attitude, model.nv + height, model.nv + ball + 5]
    return np.eye(2 * model.nv + model.na)[others]
