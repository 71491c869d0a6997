"""A vibration of the plate that nobody commands: steady, or random about one frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from controllers.arrays import Array
from twin.sim.noise import Noise, Rigs


class Vibration:
    """Rates of both axes of N plates that swing by themselves, a quarter turn apart.

    A steady one is a sine. A random one is a sum of sine and cosine whose sizes wander: white noise
    through a first-order lag each (Ornstein-Uhlenbeck), so narrow-band noise of the same rms.

    Args:
        period: Control period in s.
        seeds: One seed sequence per rig.
    """

    def __init__(self, period: float, seeds: Sequence[np.random.SeedSequence]) -> None:
        self._period = period
        self._tick = 0
        self._begun = np.zeros((len(seeds), 1), int)
        self._noise = Noise(np.full(4, 0.5), [s.spawn(1)[0] for s in seeds])
        self._sizes: Array = np.zeros((len(seeds), 4))
        none = np.zeros((len(seeds), 1))
        self.be(none, none, none)

    def be(self, amplitude: Array, frequency: Array, wander: Array) -> None:
        """Swing so from now on.

        Args:
            amplitude: Of the steady rates in rad/s, shape (N, 1); the rms of both kinds is this by
                the root of two.
            frequency: In Hz, shape (N, 1).
            wander: Time in s in which a random one forgets its phase, shape (N, 1); 0 for a steady
                one.
        """
        self.acts = bool(amplitude.any())
        self._amplitude = amplitude
        self._turn = 2 * np.pi * frequency * self._period
        self._random = wander > 0
        self._kept = np.exp(-self._period / np.where(self._random, wander, 1.0))

    def adopt(self, rigs: Rigs, other: Vibration) -> None:
        """Let some rigs begin to swing now, with the noise of others that have not begun."""
        self._begun[rigs] = self._tick
        self._noise.adopt(rigs, other._noise)

    def rate(self) -> Array:
        """Rates of the next period in rad/s, shape (N, 2)."""
        self._tick += 1
        age = self._tick - self._begun
        phase = self._turn * age
        sine, cosine = np.sin(phase), np.cos(phase)
        steady = np.concatenate((sine, cosine), axis=1)
        if self._random.any():
            drawn = self._noise.draw()
            # begun as it goes on: there is no instant at which it is known to be still
            fresh = np.where(age == 1, 1.0, np.sqrt(1 - self._kept**2))
            self._sizes = np.where(age == 1, 0.0, self._kept * self._sizes) + fresh * drawn
            wandering = self._sizes[:, :2] * sine + self._sizes[:, 2:] * cosine
            steady = np.where(self._random, wandering, steady)
        moved: Array = self._amplitude * steady
        return moved
