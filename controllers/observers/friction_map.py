"""A Kalman filter that estimates a map of the friction over the screen, and the camber."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy

from controllers.arrays import (
    Array,
    NotNegative,
    Positive,
    State,
    column,
    components,
    numbers,
    together,
)
from controllers.interfaces import with_entries
from controllers.observers.friction import FRICTION_INDEX, PENDING_SAMPLES, FrictionKalman
from controllers.observers.late_ball import NOW, THERE, LocalState


def gaussian_field(
    sides: Sequence[float], pitch: float, spread: float, length: float
) -> tuple[tuple[int, ...], Array]:
    """Lines of a grid over a rectangle along x and y, and the covariance of a field at its points.

    E m(p) m(q) = s^2 exp(-|p - q|^2 / (2 l^2)), shape (points, points).

    Args:
        sides: Of the rectangle, m.
        pitch: Distance in m from one line to the next, at most.
        spread: Standard deviation s.
        length: l in m.
    """
    along = [np.linspace(-side / 2, side / 2, 1 + max(round(side / pitch), 1)) for side in sides]
    points = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
    every_point = points.reshape(-1, 2)
    apart = ((every_point[:, None] - every_point) ** 2).sum(axis=-1)
    return points.shape[:2], spread**2 * np.exp(-apart / (2 * length**2))


class Cell(NamedTuple):
    """The place of a ball between the four points of a map around it."""

    shares: Array
    """Weights h of these points in the map's value, shape (N, 4, 1)."""
    place: Array
    """The place (x, y) in m, shape (N, 2, 1)."""


@dataclass(kw_only=True)
class FrictionMapKalman(FrictionKalman):
    """``friction_kalman`` with a friction F + m(x, y) that depends on the place.

    m is interpolated between its values at the points of a grid over the screen, and these values
    are further states of the filter. Their prior is a Gaussian field with the standard deviation
    s = ``map_spread`` and the length l = ``map_length``,

        E m(p) m(q) = s^2 exp(-|p - q|^2 / (2 l^2)).

    They do not change with time, so when the ball returns to a place, its friction is known and
    need not be estimated again with the delay of dead time and filter. Little is then left to the
    random walks: they may be slower than without a map, and let less of the screen's noise through.
    Like F, the map is estimated in motion only. In (K3) to (K7) of ``FrictionKalman`` F becomes
    F + h' m with the weights h of the four points around the ball.

    ``friction`` and its spread are those of the ball's present place.

    With a ``camber_spread`` the plate may be cambered: a ball is accelerated away from its middle
    by c_x x along x and c_y y along y. Both c are further states, estimated in motion like the map,
    and the ``disturbance`` is the one at the ball's place.

    Good where a path, or a part of the screen, is repeated. On the first passage over a screen it
    costs calculation and gives nothing; other errors that depend on the place, as one of the cams'
    table, are estimated as friction too.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "friction_map_kalman"

    map_spread: Positive = 0.02
    """Prior standard deviation of the friction from place to place in m/s^2."""
    map_length: Positive = 0.03
    """Distance in m over which it varies."""
    map_pitch: Positive = 0.05
    """Distance in m between the points of the map, at most; time and memory grow with its inverse
    to the fourth power."""
    map_sides: tuple[Positive, Positive] = with_entries((0.70, 0.395), along_x=1)
    """Extent of the map in m along x and y about the plate's centre; outside its edge counts."""
    camber_spread: NotNegative = 0.0
    """Prior standard deviation of the plate's camber in 1/s^2; 0 for a plate that is assumed to be
    flat."""

    def start(self, x: State) -> None:
        """Begin at the state x, shape (..., 8), with the same friction everywhere."""
        super().start(x)
        lines, prior = gaussian_field(
            self.map_sides, self.map_pitch, self.map_spread, self.map_length
        )
        self._points = len(prior)
        if self.camber_spread:
            prior = scipy.linalg.block_diag(prior, self.camber_spread**2 * np.eye(2))
        self._cells, rigs, count = (lines[0] - 1, lines[1] - 1), self._rigs, len(prior)
        self._m = np.zeros((rigs, count))
        self._P = np.concatenate((self._P, np.zeros((rigs, 9, count))), axis=2)
        self._M = np.tile(prior, (rigs, 1, 1))
        self._W = np.zeros((rigs, PENDING_SAMPLES, 2, count))
        """The covariance of the map is M - W' W: W has the factors W of (K6) of the samples since M
        was updated last, and below them zeros."""
        self._pending = np.zeros(rigs, int)
        """Samples in W."""
        self._every_rig = np.arange(rigs)
        self._near_points = np.full((rigs, 10 if self.camber_spread else 8), -1)
        """Points of the map around the ball's place then and now, and at the end the camber."""
        self._near = np.empty((*self._near_points.shape, count))
        """The rows of M - W' W at those points."""
        if self.camber_spread:
            self._near_points[:, 8:], self._near[:, 8:] = (count - 2, count - 1), prior[-2:]
        self._first: list[Any] = [None, None]
        self._corners = np.array((0, 1, lines[1], lines[1] + 1))
        # indices of the entries of these points in flattened arrays
        self._m_near = [np.empty((rigs, 4), int) for _ in (THERE, NOW)]
        self._P_there, self._P_now = (np.empty((rigs, rows, 4), int) for rows in (9, 1))
        self._near_now = np.empty((rigs, 4, 4), int)
        self._W_near = np.empty((rigs, 2, self._near_points.shape[1]), int)
        self._there = self._at(self._ball.position(self._s, self._ball.then), THERE)
        self._now = self._at(self._state[0::4], NOW)

    @property
    def P(self) -> Array:
        """Covariance of the nine states and the map, shape (..., 9 + points, 9 + points)."""
        W = self._W.reshape(self._rigs, -1, self._m.shape[1])
        top, M = self._P, self._M - W.mT @ W
        below = np.concatenate((top[:, :, 9:].mT, M), axis=2)
        P = np.concatenate((top, below), axis=1)
        return P.reshape(*self._shape, *P.shape[1:])

    @property
    def friction_map(self) -> Array:
        """Friction at the points of the grid, m/s^2, shape (..., n, m), first along x."""
        n, m = self._cells
        friction = np.reshape(self._s[FRICTION_INDEX], (-1, 1)) + self._m[:, : self._points]
        return friction.reshape(*self._shape, n + 1, m + 1)

    @property
    def camber(self) -> Array:
        """Acceleration per length off the plate's middle along x and y, 1/s^2, shape (..., 2)."""
        if not self.camber_spread:
            return super().camber
        return self._m[:, self._points :].reshape(*self._shape, 2).copy()

    def _map_variance(self) -> Any:
        """Variance of the friction's map at the ball's present place, (m/s^2)^2.

        It is h' M h + 2 p h with the covariances M of the four points around it, and p with F.
        """
        h = self._now.cell.shares
        M = self._near.reshape(-1).take(self._near_now)
        p = self._P.reshape(-1).take(self._P_now)
        return numbers((h.mT @ M + 2 * p) @ h)

    def _at(self, place: Sequence[Any], which: int) -> LocalState:
        """The nine states at a place (x, y) in m; friction is 0 or more."""
        by, (n, m), (width, height), (x, y) = self._by, self._cells, self.map_sides, place
        u = by.least(by.most((x / width + 0.5) * n, 0.0), n - 1e-9)
        v = by.least(by.most((y / height + 0.5) * m, 0.0), m - 1e-9)
        i, j = u // 1, v // 1
        a, b = u - i, v - j
        # a ball without a finite position has no cell; its results are not finite either
        first = i * (m + 1) + j
        first = by.where(first >= 0, first, 0.0)
        if by.any(first != self._first[which]):
            self._come_near(first, which)
        shares = (1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b
        values = components(self._m.reshape(-1).take(self._m_near[which]))
        friction = self._s[FRICTION_INDEX] + sum(map(operator.mul, shares, values))
        s = [*self._s[:FRICTION_INDEX], by.most(friction, 0.0)]
        if self.camber_spread:
            for axis, c in enumerate(components(self._m[:, self._points :])):
                s[4 + axis] = s[4 + axis] + c * place[axis]
        cell = Cell(*(together(each, self._rigs)[:, :, None] for each in (shares, place)))
        return LocalState(s, cell)

    def _come_near(self, first: Any, which: int) -> None:
        """Read the rows of M - W' W at the four points around each ball, ``first`` the lowest."""
        count, near, part = self._m.shape[1], self._near_points, slice(4 * which, 4 * which + 4)
        self._first[which] = first
        firsts = np.array(first, int, ndmin=1)
        rigs = np.flatnonzero(firsts != near[:, part.start])
        near[rigs, part] = points = firsts[rigs, None] + self._corners
        for rig, own in zip(rigs, points, strict=True):
            W = self._W[rig].reshape(-1, count)
            self._near[rig, part] = self._M[rig, own] - W[:, own].T @ W
        row, all_states = rigs[:, None], 9 + count
        self._m_near[which][rigs] = count * row + points
        self._W_near[rigs] = all_states * (2 * row + (0, 1))[..., None] + 9 + near[rigs, None]
        if which == THERE:
            rows = 9 * row + np.arange(9)
            self._P_there[rigs] = all_states * rows[..., None] + 9 + points[:, None]
        else:
            rows = near.shape[1] * row + np.arange(4, 8)
            self._near_now[rigs] = count * rows[..., None] + points[:, None]
            row = 9 * row + FRICTION_INDEX
            self._P_now[rigs] = all_states * row[..., None] + 9 + points[:, None]

    def _propagate(self, A: Array) -> None:
        """Covariance after a period, in place: (K4) with the map.

        The nine states at the ball's place move it, s + H m: the friction F + h' m with the weights
        h of the four points around it, and for a camber c the disturbance d + c x. Times A they are
        eta and eta' after the period; all other states stay.
        """
        P, near, (h, place) = self._P, self._near, self._there.cell
        local = P.copy()
        friction, disturbance = local[:, FRICTION_INDEX:], local[:, 4:6]
        friction[:, :, :9] += (P.reshape(-1).take(self._P_there) @ h).mT
        friction[:, :, 9:] += h.mT @ near[:, :4]
        if self.camber_spread:
            disturbance[:, :, :9] += place * P[:, :, -2:].mT
            disturbance[:, :, 9:] += place * near[:, 8:]
        P[:, :4] = A @ local
        P[:, 4:9, :4] = P[:, :4, 4:9].mT
        moved = P[:, :4, :9].copy()
        moved[:, :, FRICTION_INDEX:] += P.reshape(-1).take(self._P_there[:, :4]) @ h
        if self.camber_spread:
            moved[:, :, 4:6] += P[:, :4, -2:] * place.mT
        P[:, :4, :4] = moved @ A.mT

    def _reduce(self, W: Array, moving: Any) -> None:
        """Subtract W' W of (K7) from the covariance; nothing of the map at rest."""
        super()._reduce(W, moving)
        W_map, W_near = W[:, :, 9:], W.reshape(-1).take(self._W_near)
        if not self._by.all(moving):
            informs = column(column(moving))
            W_map, W_near = np.where(informs, W_map, 0.0), np.where(informs, W_near, 0.0)
        self._near -= W_near.mT @ W_map
        self._W[self._every_rig, self._pending] = W_map
        self._pending += moving
        for rig in np.flatnonzero(self._pending == PENDING_SAMPLES):
            taken = self._W[rig].reshape(-1, W_map.shape[2])
            self._M[rig] -= taken.T @ taken
            taken[:] = self._pending[rig] = 0

    def _correct_by(self, change: Array) -> None:
        """Add W' L^-1 e of (K7) to the estimate, shape (N, 9 + points)."""
        super()._correct_by(change[:, :9])
        self._m += change[:, 9:]
        if self.camber_spread:
            camber = self._m[:, self._points :]
            bound = self.bounds.camber_per_s2
            np.minimum(camber, bound, out=camber)
            np.maximum(camber, -bound, out=camber)
