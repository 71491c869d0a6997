"""Policies of few numbers that are added to a law, and the episodes in which they are tried."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Measurement
from twin.run.control import build_controllers
from twin.run.metrics import tracking_error

ENVIRONMENT = "ballplate.gym:ballplate/Track-v0"
LARGEST = 2.0
"""Of the accelerations that are added, rad/s^2."""
SCALES = np.array([0.02, 0.1, 0.02, 0.05])
"""Error in m, its rate in m/s, its integral in m s, speed of the goal in m/s that count as one."""
LEAK = 1.0
"""Time constant of the integral, s."""
NUMBERS = 2 * len(SCALES)
SIGN = np.array([1.0, -1.0])
"""Of what turning about phi and about theta does to the ball along x and y."""


class Episodes(NamedTuple):
    """What episodes of N policies gave, each shape (N,).

    Attributes:
        reward: Mean of the judged steps; what remains of an episode that ended early counts 0.
        error: Tracking error of the judged part in %, of (C.7); NaN of one that ended early.
    """

    reward: Array
    error: Array


class Residual:
    """The policies of N rigs, each eight numbers.

    Args:
        weights: Of each, along and across, shape (N, 2, 4).
        period: Control period in s.
    """

    def __init__(self, weights: Array, period: float) -> None:
        self._weights, self._period = weights, period
        self._integral = np.zeros((len(weights), 2))

    def __call__(self, x: Array, goal: Array) -> Array:
        """Plate accelerations in rad/s^2 to add, (N, 2), at estimates for goals (5, N, 2)."""
        error, rate = goal[0] - x[:, 0::4], goal[1] - x[:, 1::4]
        self._integral += self._period * (error - self._integral / LEAK)
        speed = np.hypot(*goal[1].T)[:, None]
        heading = goal[1] / (speed + SCALES[3])
        near, moving, lasting = SCALES[:3]
        parts = (error / near, rate / moving, self._integral / lasting, heading)
        seen = np.stack(parts, axis=1)
        along, across = np.einsum("nkf,nfa->kna", self._weights, seen)
        asked = along + across[:, ::-1] * np.array([-1.0, 1.0])
        return LARGEST * np.tanh(asked) * SIGN


def episodes(env: Any, weights: Array, seeds: Sequence[int], judged: float) -> Episodes:
    """Episodes of N policies, each on its rig; goals are followed from seed to end."""
    seen, _ = env.reset(seed=list(seeds))
    task, rigs = env.rigs.task, env.rigs.episodes
    controller = build_controllers(rigs.scenarios)
    policy = Residual(weights.reshape(-1, 2, len(SCALES)), task.period)
    rewards, errors, goals = [], [], []
    ended = np.zeros(len(weights), bool)
    for tick in range(task.ticks):
        now = Measurement(tick * task.period, seen[:, :4], seen[:, 6], seen[:, 7] > 0)
        if tick == 0:
            controller.start(now)
        step = controller.command(now)
        goal = np.broadcast_to(controller.reference(now.time), (5, len(weights), 2))
        rate = step.rate + task.period * policy(step.estimate, goal)
        seen, reward, terminated, _, info = env.step(rate / task.rate)
        controller.applied(seen[:, 4:6])
        ended |= terminated
        if (tick + 1) * task.period > judged:
            rewards.append(reward)
            errors.append(info["state"][:, 0::4] - seen[:, 8:10])
            goals.append(seen[:, 8:10])
    found = [tracking_error(*each) for each in zip(*_by_rig(errors, goals), strict=True)]
    return Episodes(np.mean(rewards, axis=0), np.where(ended, np.nan, found))


def _by_rig(*each: Sequence[Array]) -> list[Array]:
    return [np.stack(values, axis=1) for values in each]


def vector(count: int, settings: Sequence[str], **more: Any) -> Any:
    """An environment of so many rigs whose actions hold for one control period."""
    return gymnasium.make_vec(
        ENVIRONMENT, count, settings=list(settings), hold=1, autoreset_mode="Disabled", **more
    )
