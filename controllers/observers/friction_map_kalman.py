"""Kalman filter that learns how the friction differs from place to place on the screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from controllers.observers.friction_kalman import KNOWN, LEARNT, F, FrictionKalman
from controllers.observers.rolling_ball import Derivatives, components, together
from controllers.ranges import Positive

FRICTION, SPREAD = (
    [quantity.name for quantity in KNOWN].index(name) for name in ("friction", "friction_spread")
)
"""Where these two stand in what is known."""


@dataclass(kw_only=True)
class FrictionMapKalman(FrictionKalman):
    """``friction_kalman`` with a friction F + m(x, y) that depends on the place.

    m is given by its values at the points of a grid over the screen, straight between them, and
    these values are further states of the filter. Before anything is known they are a Gaussian
    field with the standard deviation s = ``map_spread`` and the length l = ``map_length``,

        E m(p) m(q) = s^2 exp(-|p - q|^2 / (2 l^2)).

    They do not change with time, so the second time that the ball comes to a place, its friction is
    known and need not be found again, a dead time and the filter's own lag late. What is then left
    to the random walks is little: they may be slower than without a map, and let less of the
    screen's noise through. Like F, the map is learnt in motion only.

    ``friction`` and its spread are those of the place where the ball is now.

    Good where a path, or a part of the screen, comes again. On the first way over a screen it costs
    calculation and gives nothing; what depends on the place for another reason, as an error of the
    cams' table does, is taken for friction too.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "friction_map_kalman"

    map_spread: Positive = 0.02
    """Standard deviation of the friction from place to place in m/s^2, before anything is known."""
    map_length: Positive = 0.03
    """Distance in m over which it varies."""
    map_pitch: Positive = 0.05
    """Distance in m between the points of the map, at most; time and memory grow with its inverse
    to the fourth power."""
    map_sides: tuple[Positive, Positive] = (0.70, 0.395)
    """Extent of the map in m along x and y about the plate's centre; beside it its edge counts."""

    def __post_init__(self) -> None:
        """Check the settings and lay the points."""
        super().__post_init__()
        along = [
            np.linspace(-side / 2, side / 2, 1 + max(round(side / self.map_pitch), 1))
            for side in self.map_sides
        ]
        self._points = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)
        self._cells = tuple(len(each) - 1 for each in along)

    def start(self, x: Array) -> None:
        """Begin at the state x, shape (..., 8), with the same friction everywhere."""
        count = len(self._points)
        self._m = np.zeros((int(np.prod(np.shape(x)[:-1])), count))
        self._rows = np.arange(len(self._m))[:, None]
        super().start(x)
        apart = ((self._points[:, None] - self._points) ** 2).sum(axis=-1)
        P = np.zeros((self._rigs, 9 + count, 9 + count))
        P[:, :9, :9] = self._P
        P[:, 9:, 9:] = self.map_spread**2 * np.exp(-apart / (2 * self.map_length**2))
        self._P, self._fall = P, np.empty(P.shape[1:])

    @property
    def friction_map(self) -> Array:
        """Friction at the points of the grid, m/s^2, shape (..., n, m), first along x."""
        n, m = self._cells
        F0 = np.reshape(self._s[F], (-1, 1))
        return (F0 + self._m).reshape(*self._shape, n + 1, m + 1)

    @property
    def further(self) -> Array:
        """Friction, disturbance, tilt gain and their spreads as ``KNOWN``, shape (..., 8)."""
        found = super().further.reshape(self._rigs, -1)
        found[:, FRICTION] = self._at(self._state[0::4])[F]
        (corners, shares), P = self._here, self._P
        along = 9 + corners
        map_alone = P[self._rows[:, :, None], along[:, :, None], along[:, None, :]]
        both = 2 * P[self._rows, F, along] + (map_alone * shares[:, None]).sum(axis=-1)
        found[:, SPREAD] = np.sqrt(P[:, F, F] + (both * shares).sum(axis=-1))
        return found.reshape(*self._shape, len(KNOWN))

    def _shares(self, place: Sequence[Any]) -> tuple[NDArray[np.integer], Array]:
        """The four points about a place, and the share that each has in it, both shape (N, 4)."""
        least, most, (n, m) = self._by.least, self._by.most, self._cells
        (width, height), (x, y) = self.map_sides, place
        u = least(most((x / width + 0.5) * n, 0.0), n - 1e-9)
        v = least(most((y / height + 0.5) * m, 0.0), m - 1e-9)
        i, j = u // 1, v // 1
        a, b, first = u - i, v - j, i * (m + 1) + j
        corners = together((first, first + 1, first + m + 1, first + m + 2), self._rigs)
        shares = together(((1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b), self._rigs)
        # a ball that has run away is nowhere, and all that follows from it not a number
        return np.where(corners >= 0, corners, 0).astype(int), shares

    def _at(self, place: Sequence[Any]) -> Any:
        """The nine states with the friction of a place (x, y) in m, which drives no ball."""
        self._here = corners, shares = self._shares(place)
        (more,) = components((self._m[self._rows, corners] * shares).sum(axis=-1)[:, None])
        return [*self._s[:F], self._by.most(self._s[F] + more, 0.0)]

    def _propagated(self, A: Array, step: Derivatives) -> Array:
        """Covariance a period on: the map acts on the velocities as F does, where it was asked."""
        corners, shares = self._here
        P, by = self._P, np.zeros((self._rigs, 9))
        by[:, 2], by[:, 3] = step.friction
        part = shares[:, None]
        top = A @ P[:, :9] + by[:, :, None] * (part @ P[self._rows, 9 + corners])
        along = part @ top.swapaxes(1, 2)[self._rows, 9 + corners]
        top[:, :, :9] = top[:, :, :9] @ A.swapaxes(1, 2) + along.swapaxes(1, 2) * by[:, None]
        P[:, :9], P[:, 9:, :9] = top, top[:, :, 9:].swapaxes(1, 2)
        return P

    def _reduce(self, gain: Array, hP: Array, moving: Mask) -> None:
        """Rig by rig and in place, as the covariance of one is as much as stays near at hand."""
        for rig in np.flatnonzero(gain.any(axis=1)).tolist():
            np.multiply(gain[rig, :, None], hP[rig], out=self._fall)
            if not moving[rig]:
                self._fall[LEARNT, LEARNT] = 0.0
            self._P[rig] -= self._fall

    def _correct_by(self, change: Array) -> None:
        """Add to the estimate what a touch sample says of it, shape (N, 9 + points)."""
        super()._correct_by(change[:, :9])
        self._m = self._m + change[:, 9:]
