"""The ball's state and the twin's parameters at a time, of what a log shows shortly before it."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.problem import START_DIFFERENCES, START_PRIOR, Problem
from twin.identify.replay import STEP
from twin.shadow.belief import BALL, PARAMETERS
from twin.shadow.beside import Beside
from twin.shadow.starts import settled
from twin.shadow.unevenness import directed, state_moved, turned, unknown_motion

LEAD = 1.2
"""Seconds of samples from which the state at a start is smoothed."""
UNKNOWN = 4e-4
"""Standard deviation in m/s^2 of what the plate's play and cams, too, do to a ball unknown to the
twin: as much as a tilt of 0.004 deg."""
STEPS = 6
"""Most Gauss-Newton steps that look for the ball's start."""


def smoothed(beside: Beside) -> tuple[Array, Array, Array]:
    """What windows of ``LEAD`` say of the parameters and of the ball's state when it is over.

    The forces nobody knows are estimated along (a smoother), so that where the ball is at the end
    does not rest on how it came there.

    Returns:
        Mean (W, K) and covariance (W, K, K) of the deviations of ``BALL`` and of the state's four
        numbers, and the state (4, W) they are deviations from.
    """
    problem, theta, windows = beside.problem, beside.theta, beside.windows
    starts = settled(problem, theta, problem.initial_starts(), STEPS)
    line = problem.linearise(theta, starts)
    end, slopes, way = _end_state(problem, theta, starts)
    pushes = forces(beside, way)
    unknown = turned(unknown_motion(windows, beside.delay), pushes)
    J = np.concatenate((line.by_parameter[0, ..., : len(BALL)], line.by_start[0], unknown), axis=-1)  # noqa: N806
    watched = [PARAMETERS.index(name) for name in BALL]
    sd = beside.each(lambda belief: np.hypot(belief.constant, belief.changing[0])[watched])
    count, others = len(BALL), unknown.shape[-1]
    prior = np.tile(np.eye(count + 4 + others), (len(windows), 1, 1))
    prior[:, :count, :count] = sd[:, None] ** -2 * np.eye(count)
    prior[:, count : count + 4, count : count + 4] = START_PRIOR
    Jt = np.swapaxes(J, -1, -2)  # noqa: N806
    covariance = np.linalg.inv(Jt @ J + prior)
    mean = -(covariance @ (Jt @ line.r[0][..., None]))[..., 0]
    pushed = turned(state_moved(windows, LEAD), pushes)
    keep = np.broadcast_to(np.eye(count, count + 4 + others), (len(mean), count, J.shape[-1]))
    onto = np.concatenate((keep, np.concatenate((slopes, pushed), axis=-1)), axis=1)
    spread = onto @ covariance @ np.swapaxes(onto, -1, -2)
    return (onto @ mean[..., None])[..., 0], (spread + np.swapaxes(spread, -1, -2)) / 2, end


def forces(beside: Beside, velocity: Array) -> Array:
    """What nobody knows pushes balls of some velocities (N, 2, W) with, as ``directed``."""
    sloped = beside.each(lambda belief: belief.sloped)
    along = np.sqrt(np.maximum(beside.rough**2 - sloped**2, 0.0))
    return directed(velocity, STEP, along, np.hypot(sloped, UNKNOWN))


def _end_state(problem: Problem, theta: Array, starts: Array) -> tuple[Array, Array, Array]:
    """The ball's state (4, W) at the end of ``LEAD``, its slopes (W, 4, K), and its velocity.

    Slopes by the parameters of ``BALL`` and the start, by finite differences; velocity in m/s at
    every step, shape (N, 2, W).
    """
    steps = [BOUNDS[name].difference for name in BALL]
    size = np.array([*steps, *START_DIFFERENCES])
    thetas = np.repeat(theta, 1 + len(size), axis=0)
    begun = np.repeat(starts, 1 + len(size), axis=1)
    for k, step in enumerate(steps):
        thetas[1 + k, :, k] += step
    for k, step in enumerate(START_DIFFERENCES):
        begun[k, 1 + len(steps) + k] += step
    places, speeds = problem.replayed(thetas, begun)
    at = round(LEAD / STEP)
    states = np.concatenate((places[at], speeds[at]))
    size = np.where(size > 0, size, 1.0)
    slopes = np.moveaxis((states[:, 1:] - states[:, :1]) / size[:, None], 2, 0)
    return states[:, 0], slopes, speeds[:, :, 0]
