"""One rig as an environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from ballplate.gym.rigs import Rigs
from ballplate.gym.task import HOLD, PREVIEW, Task
from ballplate.stepping import shaped
from controllers.arrays import Array


class RigEnv(gymnasium.Env[Array, Array]):
    """One rig, as ``ballplate.gym.task`` tells; arguments are those of ``Task``.

    ``reset(seed=n)`` begins the episode of seed n, that of ``ballplate run SCENARIO --set seed=n``;
    ``reset()`` draws the next seed.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  as the base class has it

    def __init__(
        self,
        scenario: str | Path,
        settings: Mapping[str, Any] | Sequence[str] = (),
        family: str | None = None,
        hold: int = HOLD,
        rate: float | None = None,
        preview: Sequence[float] = PREVIEW,
        render_mode: str | None = None,
    ) -> None:
        task = Task(scenario, settings, family, hold, rate, preview)
        self.render_mode = render_mode
        self.observation_space, self.action_space = task.observation_space, task.action_space
        self.rigs = Rigs(task, 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Of its noise, its rig and all that follow; None for the next.
            options: None are known.
        """
        super().reset(seed=seed)
        of_episode = int(self.np_random.integers(2**31)) if seed is None else seed
        self.rigs.begin(np.arange(1), [of_episode])
        return self.rigs.observation()[0], self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold an action, shape (2,), for a step."""
        given = shaped("action", action, (2,))
        reward, terminated, truncated = self.rigs.step(given[None])
        info = self._info()
        if terminated[0]:
            (info["reason"],) = self.rigs.episodes.reasons(np.arange(1))
        seen = self.rigs.observation()[0]
        return seen, float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def _info(self) -> dict[str, Any]:
        about = {name: values[0] for name, values in self.rigs.info().items()}
        return about | {"time": float(about["time"]), "error": float(about["error"])}
