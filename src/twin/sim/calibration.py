"""Calibration of the simulated mechanism: cam tables, the error they leave, and a tap test."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
from numpy.polynomial import chebyshev
from scipy.optimize import least_squares

from controllers.arrays import Array
from twin.errors import ModelError
from twin.hal.cams import CamTable, model_hash
from twin.hal.interface import Transmission
from twin.paths import model_path
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.model import load_model
from twin.sim.sensors import COUNTS

_BALL_OFF = (0.6, 0.0, 0.0, 0.0)
"""Start of the ball in a calibration: beside the screen, so that it falls off the rig."""


@dataclass(frozen=True)
class StaticError:
    """Difference of real and commanded plate angle at rest, in degrees."""

    max_deg: float
    """Largest error of either axis."""
    rms_deg: float
    """Root mean square over both axes and all poses."""
    poses: int
    """Number of poses, both axes tilted."""


@dataclass(frozen=True)
class TapResponse:
    """Decaying oscillation of one plate axis after a tap."""

    frequency_hz: float
    """Undamped natural frequency in Hz."""
    damping: float
    """Damping ratio, dimensionless."""


LINES, GRID_LINES = 13, 21
"""Motor angles per axis in the sweep, and plate angles per axis in the table."""
PLATE_RANGE, MOTOR_RANGE = math.radians(10), math.radians(57)
"""The table and the sweep reach from minus to plus these angles, rad."""
DEGREE = 8
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
    line = MOTOR_RANGE * np.sin(np.linspace(-1.4, 1.4, LINES)) / math.sin(1.4)
    target = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    plant = Mechanism(path, rigs=len(target))
    plant.start(np.broadcast_to(_BALL_OFF, (plant.rigs, 4)))
    _move_and_settle(plant, plant.motor, target)
    width = 2 * math.pi / COUNTS
    plate = np.round(plant.state[:, [2, 6]] / width) * width
    free = np.all(np.abs(plate) < PLATE_RANGE - width, axis=1)
    if free.sum() < (DEGREE + 1) ** 2:
        raise ModelError(f"model {path}: only {free.sum()} of {plant.rigs} poses are off the stops")
    basis = _basis(plate[free] / PLATE_RANGE, DEGREE)
    coefficients, *_ = np.linalg.lstsq(basis, plant.motor[free], rcond=None)
    grid = np.linspace(-PLATE_RANGE, PLATE_RANGE, GRID_LINES)
    lines_both = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1)
    angles = _basis(lines_both / PLATE_RANGE, DEGREE) @ coefficients
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
            "plate_encoder_counts": COUNTS,
            "fit": f"polynomial of degree {DEGREE} in both plate angles",
            "load": "weight of the plate and pull of the spring included",
        },
    )


def static_error(
    table: Transmission, *, lines: int = 8, plate_range: float = math.radians(8)
) -> StaticError:
    """Command the plate to a grid of poses through a transmission, and compare angles at rest.

    Both axes move to each pose at once; the motors get rates only, as the drives do, and nothing
    corrects their angle.

    Args:
        table: From plate to motor angles.
        lines: Plate angles per axis.
        plate_range: The poses reach from minus to plus this plate angle, in rad.

    Raises:
        ModelError: If the model cannot be used.
    """
    line = np.linspace(-plate_range, plate_range, lines)
    target = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    plant = Mechanism(rigs=len(target))
    plant.start(np.broadcast_to(_BALL_OFF, (plant.rigs, 4)))
    _move_and_settle(plant, np.zeros_like(target), target, table)
    error = np.degrees(plant.state[:, [2, 6]] - target)
    return StaticError(float(np.abs(error).max()), float(np.sqrt(np.mean(error**2))), len(target))


def tap_test(model: Path | None = None, *, tap: float = 0.02) -> tuple[TapResponse, TapResponse]:
    """Tap the level plate about each axis, phi then theta, and fit a decaying sine to its angle.

    Args:
        model: The MJCF file; None for the packaged one.
        tap: Rate the tap gives the plate, in rad/s.

    Raises:
        ModelError: If the model cannot be used.
    """
    mj = load_model(model)
    data = mujoco.MjData(mj)
    found = []
    for axis in ("phi", "theta"):
        mujoco.mj_resetDataKeyframe(mj, data, mj.key("level").id)
        data.joint(axis).qvel = tap
        angle = np.empty(round(0.6 / mj.opt.timestep))
        for k in range(len(angle)):
            mujoco.mj_step(mj, data)
            angle[k] = data.joint(axis).qpos[0]
        found.append(fit_ringing(angle, mj.opt.timestep))
    return found[0], found[1]


def _basis(plate: Array, degree: int) -> Array:
    """Chebyshev products up to a total degree, (..., terms), of plate angles scaled to 1."""
    phi, theta = (chebyshev.chebvander(plate[..., axis], degree) for axis in (0, 1))
    product = phi[..., :, None] * theta[..., None, :]
    order = np.add.outer(np.arange(degree + 1), np.arange(degree + 1))
    return np.asarray(product[..., order <= degree])


def fit_ringing(angle: Array, step: float) -> TapResponse:
    """Fit a decaying sine to samples that begin one step after the tap."""
    t = step * np.arange(1, len(angle) + 1)
    spectrum = np.abs(np.fft.rfft(angle - angle.mean(), 8 * len(angle)))
    guess = 2 * math.pi * spectrum.argmax() / (8 * len(angle) * step)
    scale = np.abs(angle).max()

    def misfit(p: Array) -> Array:
        decay, omega, sine, cosine, offset = p
        wave = sine * np.sin(omega * t) + cosine * np.cos(omega * t)
        return np.asarray(np.exp(-decay * t) * wave + offset - angle / scale)

    decay, omega, *_ = least_squares(misfit, [0.05 * guess, guess, 1.0, 0.0, 0.0], x_scale="jac").x
    natural = math.hypot(decay, omega)
    return TapResponse(natural / (2 * math.pi), float(decay / natural))


def _move_and_settle(
    plant: Mechanism,
    start: Array,
    target: Array,
    table: Transmission | None = None,
) -> None:
    """Move every rig smoothly to its target by motor rates alone, then let it come to rest.

    Angles are motor angles, or plate angles where a transmission is given.
    """
    period, ticks = 0.01, 100
    steps = round(period / plant.step)
    s = np.linspace(0, 1, ticks + 1)
    # a quintic: no jump of the acceleration, so the plate hardly rings
    blend = s**3 * (10 - 15 * s + 6 * s**2)
    path = [start + b * (target - start) for b in blend]
    motor = path if table is None else [table.motor(angles) for angles in path]
    for now, after in pairwise(motor):
        plant.advance((after - now) / period, steps)
    plant.advance(np.zeros_like(target), ticks * steps)
