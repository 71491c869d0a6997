"""The rigs as environments of Gymnasium: one, or a batch of which any may begin anew.

What an episode is: which rig, what is seen of it, what an action means, what is rewarded.

An **observation** is what a controller sees, 64-bit numbers in SI units, in this order:

========  ==================================================================================
0 to 3    measured x, phi, y, theta: the newest ball position that has arrived from the touch
          screen, with its dead time and noise, m; plate angles as the encoders count, rad
4, 5      plate rates (phi', theta') that the rig applied last, after its clamps, rad/s
6         age of the ball position since it arrived, s
7         1 if the screen feels the ball, else 0
from 8    the goal (x, y) in m now and at each further time of ``preview``
========  ==================================================================================

An **action** is a pair in [-1, 1]: plate rates (phi', theta') in units of ``rate``, held for
``hold`` control periods. The rig clamps it as any command.

The **reward** of a step is the mean over its control periods of 1 / (1 + (e / s)^2), where e is the
distance of the true ball from the goal: 1 on it, 1/2 at s; at most 1 a step, and none after the
end, so that a fallen ball is what costs most. On the thesis's plate s is 20 mm, on others as much
smaller or larger as the side that is the smallest in comparison.

An episode is **terminated** when the ball leaves the plate or the rig stops for any other of its
limits, and **truncated** when the scenario's duration is over.

``info`` has what no controller sees: ``state``, the true x, x', phi, phi', y, y', theta, theta';
and ``time`` in s, ``error``, the e of now in m, and once an episode is terminated its ``reason``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from ballplate.changes import changes_of
from ballplate.rigs import as_shape
from controllers.arrays import Array, Mask, put
from twin.base.errors import ScenarioError, TwinError
from twin.hal.interface import SCREEN_SIZE_M
from twin.run.controller_building import build_reference
from twin.run.loop import Episodes
from twin.scenario.schema import Dimensions, Scenario
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder

DEFAULT_HOLD_PERIODS = 10
"""Control periods for which an action is held by default: 20 ms."""
DEFAULT_PREVIEW_S = (0.1, 0.2, 0.4)
"""How far ahead the goal is seen by default, s."""
REWARD_SCALE = 0.02
"""Distance in m at which the reward is a half on the thesis's plate."""
_OBSERVATION_BOUNDS = (1.0, 1.0, 1.0, 1.0, 10.0, 10.0, 100.0, 1.0)
"""Sizes within which what is seen is clipped; nothing that happens reaches them."""


class Task:
    """Scenario and family of the episodes, and what is seen of them.

    Args:
        scenario: A shipped scenario or a TOML file; its controller and observer play no part.
        settings: What is changed of it, by dotted keys or as texts ``KEY=VALUE``.
        family: A shipped family or a TOML file, from which each episode draws its rig anew; None
            for the scenario's own rig, episodes of which differ in their noise.
        hold: Control periods for which an action is held; they must divide the duration.
        rate: Plate rate in rad/s that an action of 1 means; None for ``rig.limits.rate_deg``.
        preview: How far ahead the goal is seen besides now, s.
        computing_time: How long an action is computed, s, at most as long as one is held: it takes
            the place of the one before so many control periods late as it takes further ones.

    Raises:
        ScenarioError: If there is no such scenario or family, or anything is out of range.

    Attributes:
        ticks: Control periods of an episode.
        rate: Plate rate in rad/s that an action of 1 means.
        scale: Distance in m at which the reward is a half.
        observation_space: Of one rig.
        action_space: Of one rig.
    """

    def __init__(
        self,
        scenario: str | Path,
        settings: Mapping[str, Any] | Sequence[str] = (),
        family: str | None = None,
        hold: int = DEFAULT_HOLD_PERIODS,
        rate: float | None = None,
        preview: Sequence[float] = DEFAULT_PREVIEW_S,
        computing_time: float = 0.0,
    ) -> None:
        self._build = Builder(str(scenario))
        self._fixed = [change.text for change in changes_of(settings, {})]
        self._family = None if family is None else read_family(family)
        about = {} if self._family is None else self._family.parameters
        self._relative = {key for key, each in about.items() if each.relative}
        self._one = one = self._build(self._fixed, {})
        self.period = one.rig.period
        self.ticks = round(one.duration / self.period)
        given = math.radians(one.rig.limits.rate_deg) if rate is None else rate
        self.rate = float(given) if isinstance(given, SupportsFloat) else math.nan
        if not (0 < self.rate < math.inf):
            raise ScenarioError(f"rate: must be more than 0 rad/s, got {rate}")
        if hold not in range(1, self.ticks + 1) or self.ticks % hold:
            raise ScenarioError(
                f"hold: must divide the {self.ticks} control periods of an episode, got {hold}"
            )
        self.hold = int(hold)
        self.scale = REWARD_SCALE * float(np.divide(one.plant.size, SCREEN_SIZE_M).min())
        if not 0 <= computing_time <= hold * self.period * (1 + 1e-9):
            raise ScenarioError(
                f"computing_time: must be 0 to {hold * self.period:g} s, for which an action is "
                f"held, got {computing_time}"
            )
        self.late = max(0, math.ceil(computing_time / self.period - 1e-9) - 1)
        """Control periods of a step in which the action before is still held."""
        if not all(0 <= lead < math.inf for lead in preview):
            raise ScenarioError(f"preview: must be times in s of 0 or more, got {list(preview)}")
        self.leads = np.array([0, *(round(lead / self.period) for lead in preview)])
        """Control periods from now to where the goal is seen."""
        most = np.array([*_OBSERVATION_BOUNDS, *[1.0] * (2 * len(self.leads))])
        least = np.where(np.isin(np.arange(len(most)), (6, 7)), 0.0, -most)
        self.observation_space = Box(least, most, dtype=np.float64)
        self.action_space = Box(-1.0, 1.0, (2,), dtype=np.float64)

    def episode(self, seed: int) -> Scenario:
        """The scenario of an episode: noise and rig are those of a seed.

        Raises:
            ScenarioError: If what is drawn is out of range.
        """
        if self._family is None:
            return self._one.model_copy(update={"seed": seed})
        (rig,) = draw_rigs(self._family, seed, 1)
        fixed = (*self._fixed, f"seed={seed}")
        return self._build(fixed, rig.point, self._relative & rig.point.keys())

    def path(self, scenario: Scenario) -> Array:
        """Goal (x, y) in m at every control period, and so far on as it is seen, (periods, 2).

        Raises:
            ScenarioError: If it leaves the operating area.
        """
        count = self.ticks + int(self.leads.max()) + 1
        return np.asarray(build_reference(scenario)(np.arange(count) * self.period)[0])


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
        self._low, self._high = task.observation_space.low, task.observation_space.high
        self._ended = np.zeros(count, bool)
        self._rate: Array = np.zeros((count, 2))
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
        self._rate[rigs] = 0.0
        followed = {scenario.reference.model_dump_json(): scenario for scenario in scenarios}
        if len(rigs) < self.count and followed.keys() == {self._followed}:
            return
        every = [scenario.reference.model_dump_json() for scenario in self.episodes.scenarios]
        distinct = list(dict.fromkeys(every))
        self._which = np.array([distinct.index(each) for each in every])
        firsts = [self.episodes.scenarios[every.index(each)] for each in distinct]
        self._paths = np.stack([self.task.path(scenario) for scenario in firsts])
        self._followed = distinct[0] if len(distinct) == 1 else None

    def step(self, actions: ArrayLike) -> tuple[Array, Mask, Mask]:
        """Hold actions, shape (N, 2), for a step; rigs with a finished episode get nothing more.

        Returns:
            Reward, whether terminated, whether truncated, each shape (N,).

        Raises:
            TwinError: If they are of a wrong shape.
        """
        hold, episodes = self.task.hold, self.episodes
        before = episodes.ticks
        given = as_shape("actions", actions, (self.count, 2))
        rate = self.task.rate * np.clip(given, -1.0, 1.0)
        held = [episodes.advance(self._rate, self.task.late)] if self.task.late else []
        ball = np.concatenate([*held, episodes.advance(rate, hold - self.task.late)])
        self._rate = rate
        error = ball - self._goal(before + np.arange(1, hold + 1)[:, None])
        each = 1 / (1 + (error[..., 0] ** 2 + error[..., 1] ** 2) / self.task.scale**2)
        # one after the other: how numpy adds up depends on how many rigs there are
        reward = np.asarray(sum(each)) / hold
        reward = np.where(self._ended | ~np.isfinite(reward), 0.0, reward)
        terminated = episodes.over
        truncated = ~terminated & (episodes.ticks >= self.task.ticks)
        self._ended = terminated | truncated
        return reward, terminated, truncated

    def observation(self) -> Array:
        """Present observation, shape (N, numbers)."""
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
        """Further information that no controller sees, each with one entry per rig."""
        state, ticks = self.episodes.state.copy(), self.episodes.ticks
        return {
            "state": state,
            "time": ticks * self.task.period,
            "error": np.hypot(*(state[:, 0::4] - self.goal()).T),
        }

    def goal(self) -> Array:
        """Goal (x, y) of now in m, shape (N, 2)."""
        return self._goal(self.episodes.ticks)

    def path(self, rig: int) -> Array:
        """Goals (x, y) in m of a rig's whole episode, shape (periods, 2)."""
        return self._paths[self._which[rig], : self.task.ticks + 1]

    def _goal(self, ticks: NDArray[np.integer]) -> Array:
        """Goal (x, y) in m at ticks of each rig, shape (..., N), as (..., N, 2)."""
        last = self._paths.shape[1] - 1  # rigs with a finished episode are past it
        return self._paths[self._which, np.minimum(ticks, last)]


PICTURE_SIDE_PX = 480
"""Longer side of a picture in pixels."""
BACKGROUND_RGB = (255, 255, 255)
PLATE_RGB = (225, 229, 234)
AREA_RGB = (205, 211, 219)
PATH_RGB = (0, 0, 0)
GOAL_RGB = (0, 158, 115)
BALL_RGB = (230, 159, 0)
"""Colours of a picture."""
PATH_POINT_M = 0.001
"""Half the width of a path in a picture, m."""


def picture(size: Dimensions, ball: Array, goal: Array, path: Array) -> NDArray[np.uint8]:
    """A plate from above with x to the right and y upwards, shape (height, width, 3), RGB.

    Args:
        size: Plate, operating area and ball.
        ball: Position in m, shape (2,).
        goal: The desired one in m, shape (2,).
        path: Desired positions of the episode in m, shape (K, 2).
    """
    width, height = size.screen
    pixel = max(width, height) / PICTURE_SIDE_PX
    columns, rows = (max(2, round(side / pixel)) for side in (width, height))
    x = (np.arange(columns) + 0.5) * pixel - width / 2
    y = height / 2 - (np.arange(rows)[:, None] + 0.5) * pixel
    image = np.full((rows, columns, 3), BACKGROUND_RGB, np.uint8)
    on_plate = np.hypot(x, y) <= width / 2 if size.round else np.full((rows, columns), True)
    image[on_plate] = PLATE_RGB
    image[on_plate & (np.abs(x) <= size.area[0]) & (np.abs(y) <= size.area[1])] = AREA_RGB
    for place in path[:: max(1, len(path) // PICTURE_SIDE_PX)]:
        near_x, near_y = np.abs(x - place[0]), np.abs(y[:, 0] - place[1])
        image[np.ix_(near_y <= PATH_POINT_M, near_x <= PATH_POINT_M)] = PATH_RGB
    for place, radius, colour in ((goal, size.ball / 2, GOAL_RGB), (ball, size.ball, BALL_RGB)):
        image[np.hypot(x - place[0], y - place[1]) <= max(radius, pixel)] = colour
    return image


class RigEnv(gymnasium.Env[Array, Array]):
    """One rig, as ``ballplate.gym.environments`` tells.

    ``reset(seed=n)`` begins the episode of seed n, as by ``ballplate run SCENARIO --set seed=n``;
    ``reset()`` draws the next seed.

    Args:
        of_task: Arguments of ``Task``: scenario, settings, family, hold, rate, preview,
            computing_time.
        render_mode: ``rgb_array`` for pictures of the plate from above by ``render``.
        more: Those of them that are named.

    Raises:
        TwinError: If anything is unknown or out of range.
    """

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012  as the base class has it

    def __init__(self, *of_task: Any, render_mode: str | None = None, **more: Any) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ScenarioError(f"render_mode: must be 'rgb_array' or None, got {render_mode!r}")
        task = Task(*of_task, **more)
        self.render_mode = render_mode
        self.metadata = {
            **self.metadata,
            "render_fps": max(1, round(1 / (task.hold * task.period))),
        }
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
        given = as_shape("action", action, (2,))
        reward, terminated, truncated = self.rigs.step(given[None])
        info = self._info()
        if terminated[0]:
            (info["reason"],) = self.rigs.episodes.reasons(np.arange(1))
        seen = self.rigs.observation()[0]
        return seen, float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of the plate now: the true ball, the goal and the path; None without a mode."""
        if self.render_mode is None:
            return None
        rigs = self.rigs
        ball, goal = rigs.episodes.state[0, 0::4], rigs.goal()[0]
        return picture(rigs.episodes.scenarios[0].dimensions, ball, goal, rigs.path(0))

    def _info(self) -> dict[str, Any]:
        about = {name: values[0] for name, values in self.rigs.info().items()}
        return about | {"time": float(about["time"]), "error": float(about["error"])}


class RigVectorEnv(VectorEnv[Array, Array, NDArray[Any]]):
    """N rigs, as ``ballplate.gym.environments`` tells.

    Seeds are those of ``SyncVectorEnv``: ``reset(seed=n)`` gives rig i the episodes of an
    environment that is reset with n + i. ``reset(options={"reset_mask": mask})`` begins the
    episodes of some rigs; the others do not notice, to the last bit. The engine computes 16 rigs
    or more in a different way than fewer, as in studies, so that the last bits of the mechanism
    differ from those of one rig; and see ``twin.run.loop.Episodes`` on episodes that begin at
    moments that are no multiple of 40 ms.

    Args:
        of_task: Arguments of ``Task``: scenario, settings, family, hold, rate, preview,
            computing_time.
        num_envs: How many rigs.
        autoreset_mode: Whether a rig begins its next episode in the step after the end of one, or
            when it is reset; until then it gets nothing.
        threads: Threads of the engine; 0 for one per processor. Bits do not depend on them.
        render_mode: None; pictures are of one rig, ``RigEnv``.
        more: Those of ``Task`` that are named.

    Raises:
        TwinError: If anything is unknown or out of range.
    """

    def __init__(
        self,
        *of_task: Any,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        render_mode: str | None = None,
        **more: Any,
    ) -> None:
        if num_envs < 1:
            raise TwinError(f"num_envs: must be at least 1, got {num_envs}")
        if render_mode is not None:
            raise TwinError(f"render_mode: must be None for several rigs, got {render_mode!r}")
        task = Task(*of_task, **more)
        self.mode = AutoresetMode(autoreset_mode)
        if self.mode is AutoresetMode.SAME_STEP:
            raise TwinError("autoreset_mode: must be NextStep or Disabled, got SameStep")
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
        return self.rigs.observation(), self._mask_info(self.rigs.info(), mask)

    def step(
        self, actions: Array
    ) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Hold actions, shape (num_envs, 2), for a step."""
        due, everyone = self._over, np.ones(self.num_envs, bool)
        reward, terminated, truncated = self.rigs.step(actions)
        if self.mode is AutoresetMode.NEXT_STEP and due.any():
            terminated, truncated = terminated & ~due, truncated & ~due
            self._begin(due)
        self._over = terminated | truncated
        info = self._mask_info(self.rigs.info(), everyone) | self._reasons(terminated)
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
        reasons = np.full(self.num_envs, None, dtype=object)
        reasons[terminated] = self.rigs.episodes.reasons(np.flatnonzero(terminated))
        return {"reason": reasons, "_reason": terminated.copy()}

    @staticmethod
    def _mask_info(about: dict[str, Any], which: Mask) -> dict[str, Any]:
        """Infos of some rigs as Gymnasium has them: each with a mask of the rigs that have it."""
        own = {name: put(values, np.flatnonzero(~which), 0) for name, values in about.items()}
        return own | {f"_{name}": which.copy() for name in about}
