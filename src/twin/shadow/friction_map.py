"""The friction of every place of the screen, learnt from how the ball has rolled over it so far.

A screen that is rough here and smooth there takes a ball the same way again when it comes there
again. Without a map a twin only knows how much that may be; with one it foresees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Mask
from twin.hal.interface import SCREEN
from twin.shadow.belief import Belief

PITCH = 0.045
"""Distance in m between the points of a map, at most."""
LENGTH = 0.6
"""Length over which the friction is held to be alike, in patches of the screen."""
REST = 0.3
"""Share of the unevenness that no map of such points can show."""
EACH = 5
"""Places on a way that make one stretch of it."""
UNLIKELY = 4.0
"""Mean square by which a window moves the friction of its stretches, over its expected variance:
more than 1 is rare, and more than this is nothing that a screen does."""
FORGOTTEN = 3600.0
"""Time in s after which a screen is another one, as dust and wear have it."""
ANEW = 1.0
"""Seconds from one window that a map learns from to the next, at least: what two of them share is
counted twice."""


class FrictionMap:
    """Relative deviation m(x, y) of the rolling friction, by its values at the points of a grid.

    Between the points it is bilinear. The values are a Gaussian field that slowly becomes another,

        E m(p, t) m(q, t + h) = s^2 exp(-|p - q|^2 / (2 l^2)) exp(-|h| / T),

    and what windows say of them adds up (Kalman).

    Args:
        belief: Says how uneven the screen is, and the size of its patches.
    """

    def __init__(self, belief: Belief) -> None:
        spread, length = resolved(belief) * belief.patchy, LENGTH * max(belief.patch, PITCH)
        along = [np.linspace(-side / 2, side / 2, 1 + round(side / PITCH)) for side in SCREEN]
        points = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)
        apart = ((points[:, None] - points) ** 2).sum(axis=-1)
        self._cells = len(along[0]) - 1, len(along[1]) - 1
        self.mean = np.zeros(len(points))
        """At the points, shape (n,)."""
        self._prior = spread**2 * np.exp(-apart / (2 * length**2))
        self.covariance = self._prior
        """Of the same, shape (n, n)."""
        self.until = -np.inf
        """When what has been learnt ends, s."""

    def rows(self, place: Array) -> Array:
        """Share of every point in places in m, from shape (..., 2) to (..., n)."""
        n, m = self._cells
        u, v = (
            np.clip((place[..., axis] / SCREEN[axis] + 0.5) * cells, 0.0, cells - 1e-9)
            for axis, cells in enumerate((n, m))
        )
        i, j = u.astype(int), v.astype(int)
        a, b, first = u - i, v - j, i * (m + 1) + j
        corners = np.stack((first, first + 1, first + m + 1, first + m + 2), axis=-1)
        shares = np.stack(((1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b), axis=-1)
        rows = np.zeros((*place.shape[:-1], len(self.mean)))
        np.put_along_axis(rows, corners, shares, axis=-1)
        return rows

    def of(self, rows: Array) -> tuple[Array, Array]:
        """Mean (S,) and covariance (S, S) of what rows (S, n) make of the points."""
        return rows @ self.mean, rows @ self.covariance @ rows.T

    def age(self, until: float) -> None:
        """Forget a little up to a time in s, which is that of what is learnt next."""
        left = np.exp((self.until - until) / FORGOTTEN)
        self.mean = left * self.mean
        self.covariance = left**2 * self.covariance + (1 - left**2) * self._prior
        self.until = until

    def learn(self, rows: Array, information: Array, score: Array) -> None:
        """Take in what a window says of the deviations in S stretches of it.

        With d their deviations, it is likely as exp(b'd - d'A d / 2). A window that no screen would
        explain, as one in which somebody pushes the ball, is not believed.

        Args:
            rows: What the stretches show of the points, shape (S, n).
            information: A, shape (S, S).
            score: b, shape (S,).
        """
        across = self.covariance @ rows.T
        expected = rows @ across
        news = score - information @ (rows @ self.mean)
        gain = np.linalg.solve(
            np.eye(len(score)) + information @ expected, np.column_stack((information, news))
        )
        if gain[:, -1] @ expected @ gain[:, -1] > UNLIKELY * len(news):
            return
        self.mean = self.mean + across @ gain[:, -1]
        left = self.covariance - across @ gain[:, :-1] @ across.T
        self.covariance = (left + left.T) / 2


@dataclass(frozen=True)
class Ways:
    """Where the balls of W windows go, and what the first part of it tells of the friction there.

    Attributes:
        start: When the part begins that is foreseen, s, shape (W,).
        before: Places up to there at even times, m, shape (W, N, 2).
        information: Of the mean deviations over stretches of it, shape (W, S, S).
        score: As ``FrictionMap.learn`` takes it, shape (W, S).
        ahead: Places from there on, where the twin expects the ball, m, shape (W, M, 2).
    """

    start: Array
    before: Array
    information: Array
    score: Array
    ahead: Array


@dataclass(frozen=True)
class Known:
    """What a map knows of the ways of W windows.

    Attributes:
        mean: Of the deviations in the stretches before, without this window, shape (W, S).
        covariance: Of the same, shape (W, S, S).
        ahead: Deviation at the places from there on, with what this window says, shape (W, M).
        unsure: Covariance of its means over stretches, shape (W, T, T).
    """

    mean: Array
    covariance: Array
    ahead: Array
    unsure: Array


def foreseen(ways: Ways, counted: Mask, screen: FrictionMap) -> Known:
    """Let a map learn from windows one after the other, and ask it at each what it knows.

    Args:
        ways: The windows, in the order of time.
        counted: Those that may be learnt from, shape (W,).
        screen: Learns on.
    """
    found = []
    for w, start in enumerate(ways.start):
        rows = _means(screen.rows(ways.before[w]), EACH)
        before = screen.of(rows)
        if counted[w] and start > screen.until + ANEW - 1e-6:
            screen.age(float(start))
            screen.learn(rows, ways.information[w], ways.score[w])
        ahead = screen.rows(ways.ahead[w])
        _, unsure = screen.of(_means(ahead, EACH))
        found.append((*before, ahead @ screen.mean, unsure))
    return Known(*(np.stack(each) for each in zip(*found, strict=True)))


def resolved(belief: Belief) -> float:
    """Share of the unevenness that a map shows: less if patches are smaller than its meshes."""
    return min(1.0, belief.patch / PITCH)


def unresolved(belief: Belief) -> float:
    """Standard deviation of the relative friction from place to place that a map leaves out."""
    return float(belief.patchy * np.hypot(REST, np.sqrt(1 - resolved(belief) ** 2)))


def _means(rows: Array, stretch: int) -> Array:
    """Means over stretches of so many rows, the last of which may be shorter, (S, n)."""
    edges = np.arange(0, len(rows), stretch)
    return np.add.reduceat(rows, edges, axis=0) / np.diff(edges, append=len(rows))[:, None]
