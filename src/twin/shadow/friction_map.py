"""The friction of every place of the screen, learnt from how the ball has rolled over it so far.

A screen that is rough here and smooth there takes a ball the same way again when it comes there
again. Without a map a twin only knows how much that may be; with one it foresees it.

Small forces on the ball that nobody knows (patches of the screen, its waves, the plate's errors)
are taken as white along its way: one acceleration for every ``STRETCH`` of time, each
axis its own, drawn at random. What they may have moved the ball by is left out of a window's
likelihood (generalised least squares), so that a window may be long enough to show a dead time
without showing a rough screen as one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Mask
from twin.hal.interface import SCREEN
from twin.identify.prepare import ROLL
from twin.identify.windows import STEP, Windows
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


STRETCH = 0.3
"""Seconds in which such a force stays the same: a ball crosses a patch of the screen in some."""
FINE = 0.1
"""Seconds in which the friction on the ball's way counts as the same, where a map shows it."""
THINNED = round(FINE / STEP / EACH)
"""Steps of a replay from one place on the way at which a map is asked to the next."""


def unknown_motion(windows: Windows, delay: float, stretch: float = STRETCH) -> Array:
    """What each unknown acceleration moves the samples by, in their standard deviations, per m/s^2.

    Args:
        windows: W windows of B samples.
        delay: Dead time of the screen in s.
        stretch: Seconds in which an acceleration stays the same.

    Returns:
        Shape (W, 2 B, 2 S), samples as a ``Linearisation`` has them.
    """
    count, samples = windows.time.shape
    edges = _edges(windows, stretch)
    since = np.maximum((windows.time - delay)[..., None] - edges, 0.0)
    twice = since**2 / 2
    moved = twice[..., :-1] - twice[..., 1:]
    both = np.einsum("wbs,wba,ac->wbasc", moved, windows.weight, np.eye(2))
    return np.asarray(both.reshape(count, 2 * samples, 2 * moved.shape[-1]))


def state_moved(windows: Windows, at: float, stretch: float = STRETCH) -> Array:
    """What the same accelerations add to x, y, x' and y' at a time in s after the begin, (4, 2 S).

    Args:
        windows: W windows.
        at: Seconds.
        stretch: Seconds in which an acceleration stays the same.
    """
    since = np.maximum(at - _edges(windows, stretch), 0.0)
    moved, hurried = -np.diff(since**2) / 2, -np.diff(since)
    return np.concatenate([np.kron(each, np.eye(2)) for each in (moved, hurried)])


def _edges(windows: Windows, stretch: float) -> Array:
    """When each acceleration begins, and the last ends, s from the begin of the windows."""
    steps, each = len(windows.field.push) - 1, round(stretch / STEP)
    return STEP * np.arange(0, steps + each, each)


def products(columns: Array, unknown: Array, size: float) -> Array:
    """Inner products of columns under noise and the unknown motion, shape (W, K, K).

    With N the unknown motion and s its size, U' (I + s^2 N N')^-1 U by Woodbury's identity.

    Args:
        columns: U, in standard deviations of the samples, shape (W, M, K).
        unknown: N, shape (W, M, S).
        size: s, standard deviation of an unknown acceleration in m/s^2.
    """
    U, N = columns, unknown  # noqa: N806
    shared = np.swapaxes(N, -1, -2) @ U
    inner = np.eye(N.shape[-1]) / size**2 + np.swapaxes(N, -1, -2) @ N
    plain = np.swapaxes(U, -1, -2) @ U
    return np.asarray(plain - np.swapaxes(shared, -1, -2) @ np.linalg.solve(inner, shared))


def directed(velocity: Array, step: float, along: float, across: float) -> Array:
    """What turns unit accelerations of every ``STRETCH`` into the unknown ones, (W, S, 2, 2).

    What is unknown of the friction pushes along the ball's way, all else in any direction. The
    roots of their covariances.

    Args:
        velocity: Of the balls in m/s at even times, shape (N, 2, W).
        step: Seconds between them.
        along: Standard deviation in m/s^2 of what acts along the way.
        across: The same of what acts along each axis.
    """
    edges = np.arange(0, len(velocity) - 1, round(STRETCH / step))
    count = np.diff(edges, append=len(velocity))[:, None, None]
    way = np.moveaxis(np.add.reduceat(velocity, edges, axis=0) / count, 2, 0)
    heading = way / np.maximum(np.hypot(way[..., 0], way[..., 1]), 1e-9)[..., None]
    more = np.hypot(along, across) - across
    onward = heading[..., None] * heading[..., None, :]
    return np.asarray(more * onward + across * np.eye(2))


def braked(velocity: Array, step: float, braking: float) -> Array:
    """What turns twice the friction in every ``FINE`` s into accelerations, (W, S, 2, 1).

    A ball that hardly moves has as much friction as it takes to hold it, whatever there is.

    Args:
        velocity: Of the balls in m/s at even times, shape (N, 2, W).
        step: Seconds between them.
        braking: What the friction is that counts as once, m/s^2.
    """
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    heading = velocity / np.where(speed > ROLL, speed, np.inf)[:, None]
    edges = np.arange(0, len(velocity) - 1, round(FINE / step))
    count = np.diff(edges, append=len(velocity))[:, None, None]
    way = np.moveaxis(np.add.reduceat(heading, edges, axis=0) / count, 2, 0)
    return np.asarray(-braking * way[..., None])


def unforeseen(
    forces: Array, ahead: float, stretch: float = STRETCH, among: Array | None = None
) -> Array:
    """Covariance in m^2 of where unknown accelerations take balls, shape (W, 2, 2).

    Args:
        forces: As ``directed`` or ``braked`` give them, shape (W, S, 2, R).
        ahead: Seconds from the begin of the first.
        stretch: Seconds in which one stays the same.
        among: Covariance of what they are multiples of in the stretches, shape (W, S, S); by
            default each is for itself.
    """
    edges = stretch * np.arange(forces.shape[1] + 1)
    moved = -np.diff(np.maximum(ahead - edges, 0.0) ** 2) / 2
    by = moved[:, None, None] * forces
    if among is None:
        return np.asarray(np.einsum("wsij,wskj->wik", by, by))
    return np.asarray(np.einsum("wsij,wst,wtkj->wik", by, among, by, optimize=True))


def turned(columns: Array, forces: Array) -> Array:
    """Columns for unit accelerations as those for the unknown ones, shape (W, M, R S).

    Args:
        columns: Of both axes of every stretch, shape (W, M, 2 S) or (M, 2 S).
        forces: As ``directed`` or ``braked`` give them, shape (W, S, 2, R).
    """
    split = columns.reshape(*columns.shape[:-1], -1, 2)[..., None, :]
    both = split @ forces[:, None, : split.shape[-3]]
    return np.asarray(both[..., 0, :].reshape(*both.shape[:-3], -1))
