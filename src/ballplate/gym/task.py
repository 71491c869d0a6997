"""What an episode is: which rig, what is seen of it, what an action means, what is rewarded.

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

The **reward** of a step is the mean over its control periods of 1 / (1 + (e / 20 mm)^2), where e is
the distance of the true ball from the goal: 1 on it, 1/2 at 20 mm; at most 1 a step, and none after
the end, so that a fallen ball is what costs most.

An episode is **terminated** when the ball leaves the plate or the rig stops for any other of its
limits, and **truncated** when the scenario's duration is over.

``info`` has what no controller sees: ``state``, the true x, x', phi, phi', y, y', theta, theta';
and ``time`` in s, ``error``, the e of now in m, and once an episode is terminated its ``reason``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from ballplate.changes import changes_of
from controllers.arrays import Array
from twin.errors import ScenarioError
from twin.run.assemble import build_reference
from twin.scenario.schema import Scenario
from twin.study.schema import drawn, read_family
from twin.study.work import Builder

HOLD = 10
"""Control periods for which an action is held by default: 20 ms."""
PREVIEW = (0.1, 0.2, 0.4)
"""How far ahead the goal is seen by default, s."""
REWARD_SCALE = 0.02
"""Distance in m at which the reward is a half."""
_BOUNDS = (1.0, 1.0, 1.0, 1.0, 10.0, 10.0, 100.0, 1.0)
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
        observation_space: Of one rig.
        action_space: Of one rig.
    """

    def __init__(
        self,
        scenario: str | Path,
        settings: Mapping[str, Any] | Sequence[str] = (),
        family: str | None = None,
        hold: int = HOLD,
        rate: float | None = None,
        preview: Sequence[float] = PREVIEW,
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
        self.rate = math.radians(one.rig.limits.rate_deg) if rate is None else float(rate)
        if not (0 < self.rate < math.inf):
            raise ScenarioError(f"rate: must be more than 0 rad/s, got {rate}")
        if hold < 1 or self.ticks % hold:
            raise ScenarioError(
                f"hold: must divide the {self.ticks} control periods of an episode, got {hold}"
            )
        self.hold = hold
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
        most = np.array([*_BOUNDS, *[1.0] * (2 * len(self.leads))])
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
        (rig,) = drawn(self._family, seed, 1)
        fixed = (*self._fixed, f"seed={seed}")
        return self._build(fixed, rig.point, self._relative & rig.point.keys())

    def path(self, scenario: Scenario) -> Array:
        """Goal (x, y) in m at every control period, and so far on as it is seen, (periods, 2).

        Raises:
            ScenarioError: If it leaves the operating area.
        """
        count = self.ticks + int(self.leads.max()) + 1
        return np.asarray(build_reference(scenario)(np.arange(count) * self.period)[0])
