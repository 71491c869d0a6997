"""The simulated mechanism measured: its cam table, and its linear model."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.polynomial import chebyshev

from controllers import ballplate
from controllers.arrays import Array, Number
from twin.base.errors import ModelError
from twin.base.shipped import model_path
from twin.hal.cams import CamTable, model_hash
from twin.sim.plant.interface import Parts
from twin.sim.plant.mechanism import Mechanism, free_dimension
from twin.sim.plant.model import load_model, motor_ratio
from twin.sim.sensors import ENCODER_COUNTS_PER_TURN

_BALL_OFF = (0.6, 0.0, 0.0, 0.0)
"""Start of the ball in a calibration: next to the screen, so that it falls off the rig."""


TABLE_POINTS, GRID_LINES = 13, 21
"""Motor angles per axis in the sweep, and plate angles per axis in the table."""
PLATE_RANGE, MOTOR_RANGE = math.radians(10), math.radians(57)
"""The table and the sweep reach from minus to plus these angles, rad."""
POLYNOMIAL_DEGREE = 8
"""Degree of the fitted polynomial, both plate angles together."""


def sweep_cams() -> CamTable:
    """Sweep both motors over a grid of poses at rest, read the encoders, and invert.

    Plate angles are read in whole encoder counts; a polynomial in both plate angles, fitted to
    all poses at once, averages the rounding out. Poses that end on a stop are left out.

    Raises:
        ModelError: If the model cannot be used, or too few poses are free.
    """
    path = model_path()
    # closer together towards the ends, where a fit is weakest
    line = MOTOR_RANGE * np.sin(np.linspace(-1.4, 1.4, TABLE_POINTS)) / math.sin(1.4)
    target = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    plant = Mechanism(rigs=len(target))
    plant.start(np.broadcast_to(_BALL_OFF, (plant.rigs, 4)))
    _move_and_settle(plant, target)
    width = 2 * math.pi / ENCODER_COUNTS_PER_TURN
    plate = np.round(plant.state[:, [2, 6]] / width) * width
    free = np.all(np.abs(plate) < PLATE_RANGE - width, axis=1)
    if free.sum() < (POLYNOMIAL_DEGREE + 1) ** 2:
        raise ModelError(f"model {path}: only {free.sum()} of {plant.rigs} poses are off the stops")
    basis = _basis(plate[free] / PLATE_RANGE, POLYNOMIAL_DEGREE)
    coefficients, *_ = np.linalg.lstsq(basis, plant.motor[free], rcond=None)
    grid = np.linspace(-PLATE_RANGE, PLATE_RANGE, GRID_LINES)
    lines_both = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1)
    angles = _basis(lines_both / PLATE_RANGE, POLYNOMIAL_DEGREE) @ coefficients
    return CamTable(
        grid,
        angles,
        {
            "made": "ballplate calibrate cams: static sweep of both motors, ball taken off",
            "model": path.name,
            "model_sha256": model_hash(path),
            "mujoco": mujoco.__version__,
            "unit": "rad",
            "plate_range_deg": round(math.degrees(PLATE_RANGE), 6),
            "motor_range_deg": round(math.degrees(MOTOR_RANGE), 6),
            "poses": int(free.sum()),
            "plate_encoder_counts": ENCODER_COUNTS_PER_TURN,
            "fit": f"polynomial of degree {POLYNOMIAL_DEGREE} in both plate angles",
            "load": "weight of the plate and pull of the spring included",
        },
    )


def _basis(plate: Array, degree: int) -> Array:
    """Chebyshev products up to a total degree, (..., terms), of plate angles scaled to 1."""
    phi, theta = (chebyshev.chebvander(plate[..., axis], degree) for axis in (0, 1))
    product = phi[..., :, None] * theta[..., None, :]
    order = np.add.outer(np.arange(degree + 1), np.arange(degree + 1))
    return np.asarray(product[..., order <= degree])


def _move_and_settle(plant: Mechanism, target: Array) -> None:
    """Turn the motors of every rig smoothly to their targets, then let it come to rest."""
    period, ticks = 0.01, 100
    steps = round(period / plant.step)
    s = np.linspace(0, 1, ticks + 1)
    # a quintic: no jump of the acceleration, so the plate hardly rings
    blend = s**3 * (10 - 15 * s + 6 * s**2)
    path = [plant.motor + b * (target - plant.motor) for b in blend]
    for now, after in pairwise(path):
        plant.advance((after - now) / period, steps)
    plant.advance(np.zeros_like(target), ticks * steps)


MECHANISM_STATES = (
    *ballplate.STATE_NAMES,
    *("motor_phi", "motor_phi_rate", "motor_theta", "motor_theta_rate"),
    *("servo_phi", "servo_theta", "ball_turn_x", "ball_turn_y"),
)
"""Ball and plate as in (5.5); motor angles and rates; the servos' set points in rad; the rates at
which the ball turns about the axes x and y in rad/s, which follow its speed within some 20 ms."""

STATE_DIFFERENCE_STEP = 1e-7
LEAST_LEAK = 1e-6


class LinearMechanism(NamedTuple):
    """x[k+1] = A x[k] + B u[k] from one physics step to the next, u being held motor rates.

    Attributes:
        A: Shape (16, 16), states in the order of ``STATES``.
        B: Shape (16, 2), from motor rates (phi, theta) in rad/s.
        step: Physics step in s.
        ratio: Motor angle per plate angle about level, dimensionless; of rods (phi, theta).
    """

    A: Array
    B: Array
    step: float
    ratio: Number


def linear_mechanism(parts: Parts | None = None, step: float | None = None) -> LinearMechanism:
    """The mechanism about the level plate with its ball at rest on the centre.

    Dry friction, of the rolling ball and of the plate's joints, is left out: a body that it
    holds has no motion to linearise. So is a tilt of the base, under which the ball does not rest.
    Of the engine's states those are dropped that the others do not depend on: height, attitude and
    spin of the ball.

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
    mujoco.mjd_transitionFD(model, data, STATE_DIFFERENCE_STEP, True, A, B, C, None)
    T = np.concatenate((_kept_states(model, C), _dropped_states(model)))
    n = len(MECHANISM_STATES)
    A = T @ A @ np.linalg.inv(T)
    if np.abs(A[:n, n:]).max() > LEAST_LEAK:
        raise ModelError(
            "mechanism: the motion of a ball that is oval or out of balance depends on its "
            "orientation: ball and plate alone are no linear model of it"
        )
    servos = [model.actuator(f"servo_{axis}").id for axis in ("phi", "theta")]
    B = (T @ B)[:n, servos]
    return LinearMechanism(A[:n, :n], B, float(model.opt.timestep), motor_ratio(model))


def _kept_states(model: mujoco.MjModel, C: Array) -> Array:
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


def _dropped_states(model: mujoco.MjModel) -> Array:
    """The other states: height and its rate, three angles of attitude, and spin, (6, size)."""
    ball = model.joint("ball").dofadr[0]
    height, attitude = ball + 2, [ball + 3, ball + 4, ball + 5]
    others = [height, *attitude, model.nv + height, model.nv + ball + 5]
    return np.eye(2 * model.nv + model.na)[others]
