"""The path nearest to a desired one that a plate can produce, planned slice by slice."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Mask


@dataclass(frozen=True, kw_only=True)
class PathShaping:
    """How a path that the plate cannot produce is replaced by the nearest one that it can.

    Attributes:
        horizon_s: Time in s beyond the window over which the distance is minimised.
        pieces_per_slice: Pieces of constant jerk in a slice.
        iterations: Iterations of the method of multipliers in each slice.
        weight_m2: Weight of the bounds in the method, m^2.
        return_position_m: Distance in m from a path that can be followed, below which the plan
            follows it again, if speed and acceleration are as near.
        return_velocity_m_s: The same of the velocity, m/s.
        return_acceleration_m_s2: The same of the acceleration, m/s^2.
        min_difference_m: Distance in m above which the planned path differs from the desired one.
    """

    horizon_s: float = 1.2
    pieces_per_slice: int = 2
    iterations: int = 20
    weight_m2: float = 3e-3
    return_position_m: float = 1e-4
    return_velocity_m_s: float = 1e-3
    return_acceleration_m_s2: float = 2e-2
    min_difference_m: float = 1e-3

    @property
    def return_tolerances(self) -> tuple[float, float, float]:
        """Tolerances of position, velocity and acceleration, in m and s."""
        return self.return_position_m, self.return_velocity_m_s, self.return_acceleration_m_s2


PATH_SHAPING = PathShaping()


class FeasiblePath:
    """The path nearest to a desired one within limits of acceleration and jerk, slice by slice.

    The minimum mean square distance over a horizon, among paths with constant jerk over short
    pieces, from the end of the previous slice: a quadratic programme with bounds, by the method of
    multipliers (Boyd et al. 2011, "Distributed optimization and statistical learning via the
    alternating direction method of multipliers", 3.1), started from the previous slice's result.

    Args:
        limits: Limits of acceleration, m/s^2, and jerk, m/s^3, along either axis.
        period: Time from one sample to the next, s.
        count: Samples of a slice.
        shaping: Constants of the method.
    """

    def __init__(
        self,
        limits: tuple[float, float],
        period: float,
        count: int,
        shaping: PathShaping = PATH_SHAPING,
    ) -> None:
        self.count, self._limits, self._period = count, limits, period
        self._shaping, pieces = shaping, shaping.pieces_per_slice
        piece = count * period / pieces
        self.length = n = pieces * math.ceil(shaping.horizon_s / (count * period))
        """Number of pieces in the horizon."""
        self._places = np.arange(1, n + 1) * piece / period
        """Places of the ends of pieces among the samples; the last of the slice before is 0."""
        on, by = _integration_matrices(piece)
        state, push = np.eye(3), np.zeros((3, n))
        states, pushes = np.empty((n, 3, 3)), np.empty((n, 3, n))
        for k in range(n):
            state, push = on @ state, on @ push
            push[:, k] += by
            states[k], pushes[k] = state, push
        A, J = limits
        self._free, self._moved = states[:, 0], pushes[:, 0]
        self._tilted, self._bounded = states[:, 2] / A, np.vstack((pushes[:, 2] / A, np.eye(n) / J))
        H = self._moved.T @ self._moved + shaping.weight_m2 * self._bounded.T @ self._bounded
        self._solved = np.linalg.inv(H + 1e-9 * np.eye(n))
        self._pull = shaping.weight_m2 * self._bounded.T
        times = np.arange(1, count + 1) * period
        within = np.minimum(np.floor((times - 1e-9) / piece).astype(int), pieces - 1)
        self._samples = np.empty((count, 3, 3 + pieces))
        for row, time, k in zip(self._samples, times, within.tolist(), strict=True):
            on, by = _integration_matrices(time - k * piece)
            begin = np.hstack((np.eye(3), np.zeros((3, pieces))))
            if k:
                begin = np.hstack((states[k - 1], pushes[k - 1][:, :pieces]))
            row[:] = on @ begin
            row[:, 3 + k] += by
        self._warm: tuple[Array, Array] | None = None
        self._astray: Mask = np.zeros((), bool)

    def restart(self) -> None:
        """Expect a new path, which may not continue the previous slice."""
        self._warm, self._astray = None, np.ones((), bool)

    def within(self, path: Array) -> Mask:
        """Whether acceleration and jerk of a path keep to the limits, shape (...,).

        Args:
            path: Position, velocity, acceleration, shape (3, K, ..., 2).
        """
        begins: Mask = (np.abs(path[2, 0]) <= self._limits[0]).all(axis=-1)
        return np.asarray(begins & self.within_each(path).all(axis=0))

    def within_each(self, path: Array) -> Mask:
        """Whether each sample but the first, and the step to it, keep to them, (K - 1, ...).

        Args:
            path: Position, velocity, acceleration, shape (3, K, ..., 2).
        """
        A, J = self._limits
        kept: Mask = np.abs(path[2, 1:]) <= A
        for limit, each in ((A, path[1]), (J, path[2])):  # a corner has no acceleration
            kept &= np.abs(each[1:] - each[:-1]) <= limit * self._period
        return kept[..., 0] & kept[..., 1]

    def follow(self, state: Array, path: Array, kept: Mask) -> Array:
        """The next slice, shape (3, count, ..., 2).

        Args:
            state: Position, velocity, acceleration at the end of the previous slice, (3, ..., 2).
            path: The desired path from there, shape (3, K, ..., 2), at least the horizon long.
            kept: Which of its samples, and steps to them, keep to the limits, shape (K, ...).
        """
        joins = self.within(np.stack((state, path[:, 0]), axis=1))
        able = np.asarray(joins & kept[1:].all(axis=0))
        slice_: Array = path[:, : self.count]
        if able.all() and not self._astray.any():
            return slice_
        arrived = np.tensordot(_integration_matrices(self._period)[0], state, axes=1)
        tolerances = np.array(self._shaping.return_tolerances).reshape(3, *[1] * (state.ndim - 1))
        near = np.abs(arrived - path[:, 0]) < tolerances
        self._astray = astray = ~able | (self._astray & ~near.all(axis=(0, -1)))
        if not astray.any():
            self._warm = None
            return slice_
        return np.where(astray[..., None], self._nearest(state, path), slice_)

    def _nearest(self, state: Array, path: Array) -> Array:
        """The slice of the nearest path within the limits."""
        (A, J), pieces = self._limits, self._shaping.pieces_per_slice
        x = np.moveaxis(state, 0, -2)  # every rig by itself, so that it gets the same bits alone
        place = np.minimum(self._places, path.shape[1]) - 1
        low = np.floor(place).astype(int)
        high = np.minimum(low + 1, path.shape[1] - 1)
        share = (place - low).reshape(-1, *[1] * (path.ndim - 2))
        desired = np.moveaxis(path[0][low] + share * (path[0][high] - path[0][low]), 0, -2)
        base = self._moved.T @ (desired - self._free @ x)
        tilted = self._tilted @ x
        room = np.concatenate((tilted, np.zeros_like(tilted)), axis=-2)
        z, price = self._warm or (np.zeros_like(room), np.zeros_like(room))
        least, most = -1 - room, 1 - room
        for _ in range(self._shaping.iterations):
            jerk = self._solved @ (base + self._pull @ (z - price))
            done = self._bounded @ jerk
            z = np.minimum(np.maximum(done + price, least), most)
            price = price + done - z
        kept = self._astray[..., None, None]
        self._warm = kept * _shift_multipliers(z, pieces), kept * _shift_multipliers(price, pieces)
        piece, now, pushes = self.count * self._period / pieces, x[..., 2, :], []
        for k in range(pieces):  # the method may leave a little beyond the limits
            push = np.clip(jerk[..., k, :], -J, J)
            end = np.clip(now + piece * push, -A, A)
            pushes.append((end - now) / piece)
            now = end
        begin = np.concatenate((x, np.stack(pushes, axis=-2)), axis=-2)
        made = self._samples.reshape(3 * self.count, -1) @ begin
        made = made.reshape(*made.shape[:-2], self.count, 3, 2)
        return np.moveaxis(made, (-3, -2), (1, 0))


def _integration_matrices(time: float) -> tuple[Array, Array]:
    """Matrices of position, velocity and acceleration after a time in s, for a constant jerk.

    Returns:
        Derivatives by their initial values, shape (3, 3), and by the jerk, shape (3,).
    """
    on = np.array([[1, time, time**2 / 2], [0, 1, time], [0, 0, 1]])
    return on, np.array([time**3 / 6, time**2 / 2, time])


def _shift_multipliers(bounds: Array, pieces: int) -> Array:
    """Multipliers of acceleration and jerk of each piece, shifted by one slice.

    Args:
        bounds: The multipliers, shape (..., 2 n, 2): n of the acceleration, n of the jerk.
        pieces: Pieces in a slice.
    """
    n = bounds.shape[-2] // 2
    order = np.minimum(np.arange(n) + pieces, n - 1)
    return np.take(bounds, np.concatenate((order, n + order)), axis=-2)
