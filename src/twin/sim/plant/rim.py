"""Rims and end stops: walls on the plate, which a rolling ball bounces off and rests against.

A wall is smooth and upright and turns with the plate. A ball that rolls against it at a speed v
rolls away at e v, with the restitution e; its speed along the wall stays. So e is what a log of a
rolling ball shows, and less than the restitution k of the bare blow: right after it the ball
slides, for its rotation goes on. With j = J / (m r^2) friction of the screen then leaves it
e = (k - j) / (1 + j): of k = 0.7 a solid ball keeps 0.21, and a ball with k below j keeps nothing.

A ball that presses on a wall rests against it: the wall takes what pushes outwards, and friction of
the screen holds the ball against the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from controllers.arrays import ARRAY_ARITHMETIC, NUMBER_ARITHMETIC, Array, Mask, Number
from twin.base.followers import FREE, GIVEN, Followers
from twin.base.settings import check, setting

RIM_FOLLOWERS = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=FREE,
    explain="compares runs of one build of the rig",
    identify="finds end stops in a log by itself",
    symbols="have a ball that meets no wall",
)
MAX_BALL_ACCELERATION_M_S2 = 20.0
"""Acceleration that no ball on a plate exceeds: 1 m/s in 0.05 s."""
ON_THE_WALL = 1e-9
"""By which share of its distance a ball on a round wall may be short of it."""


@dataclass(frozen=True, kw_only=True)
class Rim:
    """A rim around the plate, or end stops on it; fields may be arrays with one entry per rig.

    Attributes:
        size: Distances between opposite walls along x and y in m, shape (2,) or (N, 2); 0 for no
            walls. On a round plate the diameter of its rim twice.
        restitution: Speed of the ball after an impact on a wall, relative to the speed before.

    Raises:
        ModelError: If a number is out of range.
    """

    size: tuple[float, float] | Array = setting(
        "plant.rim.size", (0.0, 0.0), followed_by=RIM_FOLLOWERS, ge=0, le=5
    )
    restitution: Number = setting(
        "plant.rim.restitution", 0.2, followed_by=RIM_FOLLOWERS, ge=0, le=1
    )

    def __post_init__(self) -> None:
        """Check the ranges."""
        check(self)

    @property
    def given(self) -> bool:
        """Whether any plate has walls."""
        return bool(np.any(self.size))


Ends = tuple[float, float]
"""Least and largest place along an axis, m; infinite without a wall."""
NO_ENDS: Ends = (-math.inf, math.inf)


@dataclass(frozen=True)
class Reach:
    """How far walls let the middle of a ball go.

    Attributes:
        farthest: Along x and y in m; infinite without walls.
        rounded: Whether the wall is a circle.
        ends: Least and largest place along x and along y, m, as a log shows them.
    """

    farthest: tuple[float, float] = (math.inf, math.inf)
    rounded: bool = False
    ends: tuple[Ends, Ends] = (NO_ENDS, NO_ENDS)

    @classmethod
    def of(cls, size: Sequence[float], radius: float, shape: str) -> Reach:
        """The reach of a ball.

        Args:
            size: Distances between opposite walls in m; 0 for none.
            radius: Of the ball in m.
            shape: Of the plate, as ``plant.shape`` states it.
        """
        x, y = (each / 2 - radius if each > 0 else math.inf for each in size)
        return cls((x, y), shape == "round")

    def narrowed(self, ends: Sequence[Ends]) -> Reach:
        """This reach with further ends along x and y: the nearer one holds."""
        both = [
            (max(low, least), min(high, most))
            for (low, high), (least, most) in zip(self.ends, ends, strict=True)
        ]
        return replace(self, ends=(both[0], both[1]))

    def is_met(self, ball: Array, margin: ArrayLike) -> Mask:
        """Whether balls at places (K, 2) in m are as near to a wall as a margin in m, shape (K,).

        The margin has the shape (), (2,) or (K, 2).
        """
        low, high = np.transpose(self.ends)
        ended = ((ball < low + margin) | (ball > high - margin)).any(axis=-1)
        allowed = np.subtract(self.farthest, margin)
        if self.rounded:
            return np.asarray(ended | (np.hypot(*ball.T) > allowed.min(axis=-1)))
        return np.asarray(ended | (np.abs(ball) > allowed).any(axis=-1))


UNLIMITED_REACH = Reach()
"""Without walls."""


class Walls:
    """The walls of N plates, where the middles of their balls meet them.

    Args:
        rim: Of the plates.
        radius: Of the balls in m, shape () or (N,).
        rounded: Whether the plates are round, shape () or (N,).
        rigs: Number of plates.
        single: Whether the ball is plain numbers, else arrays (N,).
    """

    def __init__(
        self, rim: Rim, radius: ArrayLike, rounded: ArrayLike, *, rigs: int, single: bool = False
    ) -> None:
        size = np.broadcast_to(np.asarray(rim.size, float), (rigs, 2)).T
        reach = np.where(size > 0, size / 2 - np.asarray(radius), np.inf)
        rebound, circle = np.broadcast_to(rim.restitution, (rigs,)), np.isfinite(reach[0])
        circle = circle & np.broadcast_to(np.asarray(rounded, bool), (rigs,))
        self.by = NUMBER_ARITHMETIC if single else ARRAY_ARITHMETIC
        self.reach: Any = reach.ravel().tolist() if single else reach
        """How far the middles can go along x and y, m; infinitely without walls."""
        self._rebound: Any = rebound.item() if single else rebound
        self._circle: Any = circle.item() if single else circle
        self._round = bool(circle.any())

    def met(self, x: Any, y: Any) -> Any:
        """Whether balls are beyond a wall."""
        beyond = (abs(x) > self.reach[0]) | (abs(y) > self.reach[1])
        if not self._round:
            return beyond
        return beyond | (self._circle & (x * x + y * y > self.reach[0] * self.reach[0]))

    def near(self, ball: Any, time: float) -> Any:
        """Whether balls (x, x', y, y') may meet a wall within a short time in s.

        A ball is assumed to accelerate at ``MAX_BALL_ACCELERATION_M_S2`` at most.
        """
        x, vx, y, vy = ball
        gained = MAX_BALL_ACCELERATION_M_S2 * time
        way_x, way_y = time * (abs(vx) + gained), time * (abs(vy) + gained)
        return self.met(abs(x) + way_x, abs(y) + way_y)

    def rebound(self, step: float, before: Any, after: Any) -> tuple[Any, ...]:
        """Balls (x, x', y, y') after a step in s, of those that no wall had stopped.

        Args:
            step: Time between the two.
            before: Balls before the step.
            after: Balls after the step, some beyond a wall.
        """
        x, vx, y, vy = after
        along_x = self._stopped(step, self.reach[0], x, vx, before[1])
        along_y = self._stopped(step, self.reach[1], y, vy, before[3])
        if not self._round:
            return *along_x, *along_y
        where = self.by.where
        far = self.by.sqrt(x * x + y * y)
        nx, ny = self._outwards(x, y)
        speed = nx * vx + ny * vy
        there, outwards = self._stopped(
            step, self.reach[0], far, speed, nx * before[1] + ny * before[3]
        )
        more, faster = there - far, outwards - speed
        on_circle = x + more * nx, vx + faster * nx, y + more * ny, vy + faster * ny
        straight = *along_x, *along_y
        return tuple(
            where(self._circle, one, other) for one, other in zip(on_circle, straight, strict=True)
        )

    def _stopped(self, step: float, reach: Any, x: Any, v: Any, v_before: Any) -> tuple[Any, Any]:
        """Place in m and speed in m/s along one direction, with its acceleration constant.

        A ball that would meet the wall a second time within the step rests on it.
        """
        where, least, most = self.by.where, self.by.least, self.by.most
        side = where(x < 0, -1.0, 1.0)
        depth, out, acceleration = side * x - reach, side * v, side * (v - v_before) / step
        beyond = depth > 0
        depth = where(beyond, depth, 0.0)
        hit = self.by.sqrt(most(out * out - 2 * acceleration * depth, 0.0))
        total = out + hit
        left = least(2 * depth / where(total > 0, total, 1.0), step)
        away = self._rebound * hit
        short = left * (away - acceleration / 2 * left)  # distance of the ball from the wall, m
        rests = short <= 0
        place = side * (reach - where(rests, 0.0, short))
        speed = where(rests, 0.0, side * (acceleration * left - away))
        return where(beyond, place, x), where(beyond, speed, v)

    def _outwards(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Direction from the middle to (x, y)."""
        far = self.by.sqrt(x * x + y * y)
        by = self.by.where(far > 0, far, 1.0)
        return x / by, y / by

    def support(
        self, x: Any, vx: Any, y: Any, vy: Any, acceleration: tuple[Any, Any]
    ) -> tuple[Any, Any]:
        """Acceleration in m/s^2 that is left to balls, of those at rest on a wall."""
        ax, ay = acceleration
        rests = (vx == 0) & (vy == 0)
        if not self.by.any(rests):
            return acceleration
        where, (reach_x, reach_y) = self.by.where, self.reach
        left = (
            where(rests & (abs(x) >= reach_x) & (ax * x > 0), 0.0, ax),
            where(rests & (abs(y) >= reach_y) & (ay * y > 0), 0.0, ay),
        )
        if not self._round:
            return left
        nx, ny = self._outwards(x, y)
        on_wall = nx * x + ny * y >= reach_x * (1 - ON_THE_WALL)
        push = where(rests & on_wall, self.by.most(nx * ax + ny * ay, 0.0), 0.0)
        circle = self._circle
        return (
            where(circle, ax - push * nx, left[0]),
            where(circle, ay - push * ny, left[1]),
        )
