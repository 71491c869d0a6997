"""What a control period of the exact plant costs, as ratios to plain RK4 within one run.

The baseline integrates the model's own derivative with the friction's own resistance, step by step
in arrays, through the same commands. Best of several rounds that alternate between the two, so that
a busy machine slows both alike.
"""

from __future__ import annotations

import time

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction, resist

STEP, STEPS = 0.001, 2
MODEL = BallPlate()


def commands(periods: int) -> Array:
    """Plate rates in rad/s that keep the ball about the middle, shape (periods, 1, 2)."""
    t = STEP * STEPS * np.arange(periods)[:, None, None]
    return 0.1 * np.concatenate((np.sin(3 * t), np.cos(3 * t)), axis=-1)


def plain(friction: Friction | None, rates: Array) -> float:
    """Seconds of plain RK4."""

    def rate(x: Array, u: Array) -> Array:
        out = MODEL.derivative(x, u)
        if friction is not None:
            limit = friction.deceleration(MODEL, x)
            out[:, 1], out[:, 5] = resist(limit, (x[:, 1], x[:, 5]), (out[:, 1], out[:, 5]))
        return out

    x = np.zeros((rates.shape[1], 8))
    begin = time.perf_counter()
    for command in rates:
        u = (command - x[:, 3::4]) / (STEPS * STEP)
        for _ in range(STEPS):
            k1 = rate(x, u)
            k2 = rate(x + STEP / 2 * k1, u)
            k3 = rate(x + STEP / 2 * k2, u)
            k4 = rate(x + STEP * k3, u)
            x = x + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return time.perf_counter() - begin


def exact(friction: Friction | None, rates: Array) -> float:
    """Seconds of the plant."""
    plant = ExactPlant(MODEL, rigs=rates.shape[1], step=STEP, friction=friction)
    begin = time.perf_counter()
    for command in rates:
        plant.advance(command, STEPS)
    return time.perf_counter() - begin
