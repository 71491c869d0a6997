"""N rigs as one vector environment: one batch of the engine, whoever begins when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ballplate.gym.rigs import Rigs
from ballplate.gym.task import HOLD, PREVIEW, Task
from controllers.arrays import Array, Mask, put
from twin.errors import TwinError


class RigVectorEnv(VectorEnv[Array, Array, NDArray[Any]]):
    """N rigs, as ``ballplate.gym.task`` tells; the first arguments are those of ``Task``.

    Seeds are those of ``SyncVectorEnv``: ``reset(seed=n)`` gives rig i the episodes of an
    environment that is reset with n + i. ``reset(options={"reset_mask": mask})`` begins the
    episodes of some rigs; the others do not notice, to the last bit. From 16 rigs on the engine's
    are seen in another way than fewer, as in studies, so that the last bits of the mechanism differ
    from those of one rig; and see ``twin.run.batch.Episodes`` on episodes that begin at moments
    that are no multiple of 40 ms.

    Args:
        num_envs: How many rigs.
        autoreset_mode: Whether a rig whose episode is over begins the next one in the next step, in
            the same step, or when it is reset; until then it gets nothing.
        threads: Threads of the engine; 0 for one per processor. Bits do not depend on them.
        scenario: As for ``Task``, and those that follow.
        settings: What is changed of it.
        family: What each episode draws its rig from.
        hold: Control periods for which an action is held.
        rate: Plate rate in rad/s that an action of 1 means.
        preview: How far ahead the goal is seen besides now, s.
        render_mode: None are known.

    Raises:
        TwinError: If anything is unknown or out of range.
    """

    def __init__(
        self,
        scenario: str | Path,
        settings: Mapping[str, Any] | Sequence[str] = (),
        family: str | None = None,
        hold: int = HOLD,
        rate: float | None = None,
        preview: Sequence[float] = PREVIEW,
        *,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        render_mode: str | None = None,
    ) -> None:
        if num_envs < 1:
            raise TwinError(f"num_envs: must be at least 1, got {num_envs}")
        task = Task(scenario, settings, family, hold, rate, preview)
        self.mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.mode}
        self.num_envs, self.render_mode = num_envs, render_mode
        self.single_observation_space = task.observation_space
        self.single_action_space = task.action_space
        self.observation_space = batch_space(task.observation_space, num_envs)
        self.action_space = batch_space(task.action_space, num_envs)
        self.rigs = Rigs(task, num_envs, threads)
        self._random = [np_random()[0] for _ in range(num_envs)]
        self._over = np.zeros(num_envs, bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        """Begin the episodes of all rigs, or of those of ``options["reset_mask"]``.

        Args:
            seed: One for the first rig, the next one for the second, and so on; or one each, None
                for the next of that rig.
            options: ``reset_mask``: which rigs begin, shape (num_envs,).

        Raises:
            TwinError: If there are not as many seeds as rigs, the mask is none, or the first time
                leaves out rigs.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        seeds: Sequence[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        else:
            seeds = [seed + rig for rig in range(self.num_envs)] if isinstance(seed, int) else seed
        if len(seeds) != self.num_envs:
            raise TwinError(f"seed: must be one for each of {self.num_envs} rigs, got {len(seeds)}")
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise TwinError(
                f"reset_mask: must be {self.num_envs} truth values, one of them true, got {mask}"
            )
        self._begin(mask, seeds)
        return self.rigs.observation(), self._told(self.rigs.info(), mask)

    def step(
        self, actions: Array
    ) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Hold actions, shape (num_envs, 2), for a step."""
        due, everyone = self._over, np.ones(self.num_envs, bool)
        reward, terminated, truncated = self.rigs.step(actions)
        if self.mode is AutoresetMode.NEXT_STEP and due.any():
            terminated, truncated = terminated & ~due, truncated & ~due
            self._begin(due)
        over = terminated | truncated
        info = self._told(self.rigs.info(), everyone) | self._reasons(terminated)
        if self.mode is AutoresetMode.SAME_STEP and over.any():
            final = np.full(self.num_envs, None, dtype=object)
            last = self.rigs.observation()
            for rig in np.flatnonzero(over).tolist():
                final[rig] = last[rig].copy()
            told = self._told(self.rigs.info(), over) | self._reasons(terminated)
            self._begin(over)
            info = self._told(self.rigs.info(), everyone)
            info |= {"final_obs": final, "_final_obs": over.copy()}
            info |= {"final_info": told, "_final_info": over.copy()}
        self._over = over
        return self.rigs.observation(), reward, terminated, truncated, info

    def _begin(self, which: Mask, seeds: Sequence[int | None] | None = None) -> None:
        """Let some rigs begin, of seeds or of those that are next for them."""
        chosen = []
        for rig in np.flatnonzero(which).tolist():
            seed = None if seeds is None else seeds[rig]
            if seed is None:
                seed = int(self._random[rig].integers(2**31))
            else:
                self._random[rig] = np_random(seed)[0]
            chosen.append(seed)
        self.rigs.begin(np.flatnonzero(which), chosen)
        self._over = self._over & ~which

    def _reasons(self, terminated: Mask) -> dict[str, Any]:
        """Why episodes were terminated, for those that were."""
        if not terminated.any():
            return {}
        told = np.full(self.num_envs, None, dtype=object)
        told[terminated] = self.rigs.episodes.reasons(np.flatnonzero(terminated))
        return {"reason": told, "_reason": terminated.copy()}

    @staticmethod
    def _told(about: dict[str, Any], which: Mask) -> dict[str, Any]:
        """Infos of some rigs as Gymnasium has them: each beside a mask of whose there are."""
        own = {name: put(values, np.flatnonzero(~which), 0) for name, values in about.items()}
        return own | {f"_{name}": which.copy() for name in about}
