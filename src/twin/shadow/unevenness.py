"""Small forces on the ball that nobody knows: patches of the screen, its waves, the plate's errors.

Along the ball's way they are taken as white: one acceleration for every ``STRETCH`` of time, each
axis its own, drawn at random. What they may have moved the ball by is left out of a window's
likelihood (generalised least squares), so that a window may be long enough to show a dead time
without showing a rough screen as one.
"""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.identify.prepare import ROLL
from twin.identify.replay import STEP
from twin.identify.windows import Windows
from twin.shadow.friction_map import EACH

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
