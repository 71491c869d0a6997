"""N rigs, each in an episode of a task: what both kinds of environment are made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ballplate.gym.task import REWARD_SCALE, Task
from ballplate.stepping import shaped
from controllers.arrays import Array, Mask
from twin.errors import TwinError
from twin.run.batch import Episodes


class Transition(NamedTuple):
    """What a step brought N rigs; each shape (N,)."""

    reward: Array
    terminated: Mask
    truncated: Mask


class Rigs:
    """N rigs side by side; ``begin`` first.

    Args:
        task: What their episodes are.
        count: How many.
        threads: Threads of the engine; 0 for one per processor.
    """

    def __init__(self, task: Task, count: int, threads: int = 0) -> None:
        self.task, self.count = task, count
        self._threads = threads
        self._rows = np.arange(count)
        self._low, self._high = task.observation_space.low, task.observation_space.high
        self._ended = np.zeros(count, bool)
        self._episodes: Episodes | None = None
        self._followed: str | None = None
        """The one reference that all follow, if there is one."""

    @property
    def episodes(self) -> Episodes:
        """The rigs themselves.

        Raises:
            TwinError: If none has begun.
        """
        if self._episodes is None:
            raise TwinError("reset: all rigs must be reset once before anything else")
        return self._episodes

    def begin(self, rigs: NDArray[np.integer], seeds: Sequence[int]) -> None:
        """Let some rigs begin an episode of a seed each.

        Raises:
            TwinError: If the first time it is not all of them, or what is drawn cannot be.
        """
        scenarios = [self.task.episode(seed) for seed in seeds]
        if self._episodes is None and len(rigs) == self.count:
            self._episodes = Episodes(scenarios, threads=self._threads)
        else:
            self.episodes.begin(rigs, scenarios)
        self._ended[rigs] = False
        followed = {scenario.reference.model_dump_json(): scenario for scenario in scenarios}
        if len(rigs) < self.count and followed.keys() == {self._followed}:
            return
        every = [scenario.reference.model_dump_json() for scenario in self.episodes.scenarios]
        distinct = list(dict.fromkeys(every))
        self._which = np.array([distinct.index(each) for each in every])
        firsts = [self.episodes.scenarios[every.index(each)] for each in distinct]
        self._paths = np.stack([self.task.path(scenario) for scenario in firsts])
        self._followed = distinct[0] if len(distinct) == 1 else None

    def step(self, actions: ArrayLike) -> Transition:
        """Hold actions, shape (N, 2), for a step; rigs whose episode is over get nothing more.

        Raises:
            TwinError: If they are of another shape.
        """
        hold, episodes = self.task.hold, self.episodes
        before = episodes.ticks
        given = shaped("actions", actions, (self.count, 2))
        rate = self.task.rate * np.clip(given, -1.0, 1.0)
        ball = episodes.advance(rate, hold)
        error = ball - self._goal(before + np.arange(1, hold + 1)[:, None])
        each = 1 / (1 + (error[..., 0] ** 2 + error[..., 1] ** 2) / REWARD_SCALE**2)
        # one after the other: how numpy adds up depends on how many rigs there are
        reward = np.asarray(sum(each)) / hold
        reward = np.where(self._ended | ~np.isfinite(reward), 0.0, reward)
        terminated = episodes.over
        truncated = ~terminated & (episodes.ticks >= self.task.ticks)
        self._ended = terminated | truncated
        return Transition(reward, terminated, truncated)

    def observation(self) -> Array:
        """What is seen now, shape (N, numbers)."""
        now, ticks = self.episodes.measurement, self.episodes.ticks
        goals = self._goal(ticks + self.task.leads[:, None])
        seen = np.concatenate(
            (
                now.y,
                self.episodes.applied,
                np.stack((now.age, now.touched), axis=-1),
                goals.swapaxes(0, 1).reshape(self.count, -1),
            ),
            axis=1,
        )
        return np.clip(np.nan_to_num(seen), self._low, self._high)

    def info(self) -> dict[str, Any]:
        """What no controller sees, each with one entry per rig."""
        state, ticks = self.episodes.state.copy(), self.episodes.ticks
        return {
            "state": state,
            "time": ticks * self.task.period,
            "error": np.hypot(*(state[:, 0::4] - self._goal(ticks)).T),
        }

    def _goal(self, ticks: NDArray[np.integer]) -> Array:
        """Goal (x, y) in m at ticks of each rig, shape (..., N), as (..., N, 2)."""
        last = self._paths.shape[1] - 1  # rigs whose episode is over are past it
        found: Array = self._paths[self._which, np.minimum(ticks, last)]
        return found
