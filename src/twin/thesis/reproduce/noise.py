"""The thesis's noise: white and held, the same for every way of computing a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.sim.plant.interface import Plant
from twin.sim.rig import Bench
from twin.sim.sensors import EncoderModel, SimulatedEncoders, SimulatedScreen, TouchModel
from twin.sim.sensors import Noise as SensorNoise

BALL = (7.2538e-7, 1.7721e-7)
"""Variances of x and y in m^2, Table B.1."""
PLATE = (1.5433e-10, 1.1580e-10)
"""Variances of phi and theta in rad^2, Table B.1."""
DISTURBANCE = (1.0816e-4, 2.8090e-5)
"""Variances of the plate accelerations in (rad/s^2)^2, Table B.1."""


class Noise(NamedTuple):
    """Draws of K intervals for N rigs."""

    hold: float
    """Length of an interval in s."""
    measured: Array
    """Added to x, phi, y, theta; shape (K, N, 4)."""
    disturbance: Array
    """Added to the plate accelerations in rad/s^2; shape (K, N, 2)."""


def streams(runs: int, cases: int = 1) -> list[np.random.SeedSequence]:
    """Seeds of the rigs: ``runs`` neighbouring ones a case, the same for every case."""
    return [
        np.random.SeedSequence(0, spawn_key=(run,)) for _ in range(cases) for run in range(runs)
    ]


def draw(duration: float, runs: int, hold: float) -> Noise:
    """What a bench with these seeds draws, to the last bit.

    Each rig's seed has children: of the screen's noise (0) and of the phase of its frames (1), of
    the encoders (2) and of the disturbance (3).

    Args:
        duration: Seconds to be covered, both ends included.
        runs: Number of runs.
        hold: Seconds for which a draw is held.
    """
    intervals = math.floor(duration / hold + 1e-9) + 1

    def source(child: int, variance: tuple[float, float]) -> Array:
        seeds = [seed.spawn(child + 1)[child] for seed in streams(runs)]
        draws = [np.random.default_rng(s).standard_normal((intervals, 2)) for s in seeds]
        return np.stack(draws, axis=1) * np.sqrt(variance)

    measured = np.empty((intervals, runs, 4))
    measured[..., 0::2] = source(0, BALL)
    measured[..., 1::2] = source(2, PLATE)
    return Noise(hold, measured, source(3, DISTURBANCE))


def repeated(noise: Noise, cases: int) -> Noise:
    """The same draws for several cases side by side."""
    times = (1, cases, 1)
    return Noise(noise.hold, np.tile(noise.measured, times), np.tile(noise.disturbance, times))


class SeededBench(Bench):
    """A bench whose rigs draw their noise from given seeds.

    Args:
        seeds: One a rig; the rest is as for ``Bench``.
    """

    def __init__(
        self,
        plant: Plant,
        seeds: Sequence[np.random.SeedSequence],
        *,
        period: float,
        touch: TouchModel,
        encoders: EncoderModel,
        disturbance: tuple[float, float],
        hold: int,
    ) -> None:
        super().__init__(plant, period=period, touch=touch, encoders=encoders, hold=hold)
        self._screen = SimulatedScreen(touch, period, seeds, hold)
        self._encoders = SimulatedEncoders(encoders, seeds, hold)
        step = (plant.ratio * period) ** 2 * np.asarray(disturbance)
        self._disturbance = SensorNoise(step, [seed.spawn(1)[0] for seed in seeds], hold)
        self._look()
