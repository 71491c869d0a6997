"""What a control period of the exact plant costs, as ratios to plain RK4 within one run.

Run with ``uv run python benchmarks/exact_plant.py``. The baseline integrates the model's own
derivative with the friction's own resistance, step by step in arrays, through the same commands.
Best of several rounds that alternate between the two, so that a busy machine slows both alike.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction

STEP, STEPS = 0.001, 2
MODEL = BallPlate()
GOALS = {"without friction": 3, "constant friction": 8}
"""How many times faster than the baseline one rig is to be."""


def commands(periods: int, rigs: int) -> Array:
    """Plate rates in rad/s that keep the ball about the middle, shape (periods, N, 2)."""
    t = STEP * STEPS * np.arange(periods)[:, None]
    rates = 0.1 * np.concatenate((np.sin(3 * t), np.cos(3 * t)), axis=1)
    return np.repeat(rates[:, None], rigs, axis=1)


def plain(friction: Friction | None, rates: Array) -> float:
    """Seconds of plain RK4."""

    def rate(x: Array, u: Array) -> Array:
        out = MODEL.derivative(x, u)
        if friction is not None:
            out[:, 1::4] = friction.resist(MODEL, x, out[:, 1::4])
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


def main() -> None:
    """Print microseconds per control period and ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    frictions = {"without friction": None, "constant friction": Friction(rolling=1.8e-4)}
    for rigs, periods in ((1, 1000), (256, 200)):
        rates = commands(periods, rigs)
        for name, friction in frictions.items():
            times = [(plain(friction, rates), exact(friction, rates)) for _ in range(rounds)]
            before, now = (1e6 * min(each) / periods for each in zip(*times, strict=True))
            goal = f" (goal: at least {GOALS[name]})" if rigs == 1 else ""
            print(
                f"{rigs} rigs, {name}: plain RK4 {before:.0f} us a period, plant {now:.0f} us: "
                f"{before / now:.1f} times faster{goal}"
            )


if __name__ == "__main__":
    main()
