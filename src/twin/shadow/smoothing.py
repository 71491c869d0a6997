"""The ball's state and the twin's parameters at a time, of what a log shows shortly before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.identify.levenberg_marquardt import fit_starts
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.problem import START_DIFFERENCES, START_PRIOR, Problem
from twin.identify.replay import STEP
from twin.identify.windows import Windows
from twin.shadow.belief import BALL, PARAMETERS, ROUGH, Belief
from twin.shadow.friction_map import Known, unresolved
from twin.shadow.unevenness import (
    FINE,
    THINNED,
    braked,
    directed,
    state_moved,
    turned,
    unknown_motion,
)

LEAD = 1.2
"""Seconds of samples from which the state at a start is smoothed."""
UNKNOWN = 4e-4
"""Standard deviation in m/s^2 of what the plate's play and cams, too, do to a ball unknown to the
twin: as much as a tilt of 0.004 deg."""
STEPS = 6
"""Most Gauss-Newton steps that look for the ball's start."""


@dataclass(frozen=True)
class Lead:
    """What W windows of ``LEAD`` say, as a likelihood of K unknowns around what the twin believes.

    Unknown are the parameters of ``BALL``, the ball's state where the window begins, forces of all
    kinds, and last by how much the friction differs in each of S stretches of the way.

    Attributes:
        information: Of the unknowns, shape (W, K, K).
        score: Of the unknowns, shape (W, K).
        onto: What each does to the state at the end of ``LEAD``, shape (W, 4, K).
        end: That state if the twin is right, x, y, x', y', shape (W, 4).
        places: Where the ball was at every ``THINNED`` steps but the last, m, shape (W, N, 2).
        stretches: S.
    """

    information: Array
    score: Array
    onto: Array
    end: Array
    places: Array
    stretches: int

    @classmethod
    def of(cls, windows: Windows, belief: Belief) -> Lead:
        """What windows say of their twin."""
        problem, theta = belief.problem(windows), belief.theta
        starts = fit_starts(problem, theta, problem.initial_starts(), STEPS)
        line = problem.linearise(theta, starts)
        end, slopes, places, speeds = _end_state(problem, theta, starts)
        pushes, friction = forces(belief, speeds), braking(belief, speeds)
        delay = belief.values["delay"]
        moved = turned(unknown_motion(windows, delay), pushes)
        slowed = turned(unknown_motion(windows, delay, FINE), friction)
        ball = line.by_parameter[0, ..., : len(BALL)]
        J = np.concatenate((ball, line.by_start[0], moved, slowed), axis=-1)  # noqa: N806
        pushed = turned(state_moved(windows, LEAD), pushes)
        held = turned(state_moved(windows, LEAD, FINE), friction)
        return cls(
            np.swapaxes(J, -1, -2) @ J,
            -np.einsum("wmk,wm->wk", J, line.r[0]),
            np.concatenate((slopes, pushed, held), axis=-1),
            end.T,
            places[:-1:THINNED].transpose(2, 0, 1),
            friction.shape[1],
        )

    def of_friction(self, belief: Belief) -> tuple[Array, Array]:
        """What is said of the friction alone, whatever all else is: (W, S, S) and (W, S)."""
        others = slice(None, -self.stretches)
        root = _root(belief, self.information.shape[-1] - self.stretches)
        A, b = root @ self.information[:, others], root @ self.score[:, others, None]  # noqa: N806
        both = np.concatenate((A[..., -self.stretches :], b), axis=-1)
        inner = np.eye(root.shape[-1]) + A[..., others] @ root
        taken = np.swapaxes(both[..., :-1], -1, -2) @ np.linalg.solve(inner, both)
        own = slice(-self.stretches, None)
        return self.information[:, own, own] - taken[..., :-1], self.score[:, own] - taken[..., -1]


def smoothed(lead: Lead, belief: Belief, known: Known) -> tuple[Array, Array]:
    """What windows say of the parameters and of the ball's state when they are over.

    The forces nobody knows are estimated along (a smoother), so that where the ball is at the end
    does not rest on how it came there.

    Args:
        lead: What the samples say.
        belief: The twin.
        known: What is known of the friction without them.

    Returns:
        Mean (W, K) and covariance (W, K, K) of the deviations of ``BALL`` and of the state's four
        numbers from ``lead.end``.
    """
    count, all_of = len(BALL), lead.information.shape[-1]
    root = np.zeros_like(lead.information)
    others = all_of - lead.stretches
    root[:, :others, :others] = _root(belief, others)
    root[:, others:, others:] = np.linalg.cholesky(
        known.covariance + 1e-12 * np.eye(lead.stretches)
    )
    expected = np.zeros_like(lead.score)
    expected[:, others:] = known.mean
    news = lead.score - (lead.information @ expected[..., None])[..., 0]
    across = np.swapaxes(root, -1, -2)
    covariance = np.linalg.inv(np.eye(all_of) + across @ lead.information @ root)
    mean = expected + (root @ (covariance @ (across @ news[..., None])))[..., 0]
    keep = np.broadcast_to(np.eye(count, all_of), (len(mean), count, all_of))
    onto = np.concatenate((keep, lead.onto), axis=1)
    spread = onto @ root @ covariance @ across @ np.swapaxes(onto, -1, -2)
    return (onto @ mean[..., None])[..., 0], (spread + np.swapaxes(spread, -1, -2)) / 2


def forces(belief: Belief, velocity: Array) -> Array:
    """What nobody knows pushes balls of some velocities (N, 2, W) with, as ``directed``."""
    along = belief.braking * np.hypot(ROUGH, unresolved(belief))
    return directed(velocity, STEP, along, np.hypot(belief.sloped, UNKNOWN))


def braking(belief: Belief, velocity: Array) -> Array:
    """What twice the friction slows balls of some velocities (N, 2, W) with, as ``braked``."""
    return braked(velocity, STEP, belief.braking)


def _root(belief: Belief, count: int) -> Array:
    """Standard deviations of the first unknowns before anything is seen, (count, count).

    What an uneven screen makes of the parameters is left out: the forces are unknowns of their own.
    """
    watched = [PARAMETERS.index(name) for name in BALL]
    variance = (belief.constant**2 + belief.changing[0] ** 2 - belief.uneven**2)[watched]
    sizes = np.ones(count)
    sizes[: len(BALL)] = np.sqrt(variance)
    sizes[len(BALL) : len(BALL) + 4] = np.diag(START_PRIOR) ** -0.5
    return np.diag(sizes)


def _end_state(problem: Problem, theta: Array, starts: Array) -> tuple[Array, Array, Array, Array]:
    """The ball's state (4, W) at the end of ``LEAD``, its slopes (W, 4, K), and the way to it.

    Slopes by the parameters of ``BALL`` and the start, by finite differences; places in m and
    velocities in m/s at every step, shape (N, 2, W).
    """
    steps = [BOUNDS[name].difference for name in BALL]
    size = np.array([*steps, *START_DIFFERENCES])
    thetas = np.repeat(theta, 1 + len(size), axis=0)
    begun = np.repeat(starts, 1 + len(size), axis=1)
    for k, step in enumerate(steps):
        thetas[1 + k, k] += step
    for k, step in enumerate(START_DIFFERENCES):
        begun[k, 1 + len(steps) + k] += step
    places, speeds = problem.replayed(thetas, begun)
    at = round(LEAD / STEP)
    states = np.concatenate((places[at], speeds[at]))
    size = np.where(size > 0, size, 1.0)
    slopes = np.moveaxis((states[:, 1:] - states[:, :1]) / size[:, None], 2, 0)
    return states[:, 0], slopes, places[:, :, 0], speeds[:, :, 0]
