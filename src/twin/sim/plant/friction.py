"""Rolling resistance between ball and screen: one object for every plant and every study."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import ARRAYS, Arithmetic, Array, Number
from controllers.ballplate import BallPlate
from twin.settings import Unit, check, setting
from twin.sim.plant.presliding import bent
from twin.sim.plant.surface import SurfaceMap


def resisted(
    limit: Any, velocity: tuple[Any, Any], free: tuple[Any, Any], by: Arithmetic = ARRAYS
) -> tuple[Any, Any]:
    """Acceleration (x'', y'') of a ball whose free one friction resists, up to a limit (m/s^2).

    A moving ball is slowed against its velocity; a resting one starts only when the free
    acceleration exceeds the limit. Numbers or arrays of one shape, as ``by`` says.
    """
    (vx, vy), (ax, ay), where = velocity, free, by.where
    speed = by.sqrt(vx * vx + vy * vy)
    push = by.sqrt(ax * ax + ay * ay)
    moving, freed = speed > 0, (push > limit) & (push > 0)
    drag = where(moving, limit / where(moving, speed, 1.0), 0.0)
    share = where(freed, 1.0 - limit / where(freed, push, 1.0), 0.0)
    kept = where(moving, 1.0, share)
    return kept * ax - drag * vx, kept * ay - drag * vy


@dataclass(frozen=True, kw_only=True, eq=False)
class Friction:
    """A torque against the rolling: an arm times the force that presses the ball on the screen.

    The arm is that of steady rolling, plus what a contact gains while it does not move, plus a
    viscous part::

        arm = relative(x, y) rolling (1 + (breakaway_ratio - 1) age) + viscous v

    The age of the contact, 0 to 1, grows at rest and is rolled off in motion::

        dwell_time age' = 1 - age (1 + (v / stribeck_speed)^2)

    so that at rest it approaches 1 like 1 - exp(-t / dwell_time), and in steady rolling it is the
    Stribeck curve 1 / (1 + (v / stribeck_speed)^2) of Hess and Soom. With ``dwell_time`` 0 it
    always is. Fields are numbers, or arrays with one entry per rig.

    Attributes:
        rolling: Rolling resistance arm in m; a plate at rest tilted by less than
            arctan(arm / radius) holds the ball.
        breakaway_ratio: Arm of a ball that has rested long, over that of a rolling one; >= 1.
        stribeck_speed: Speed in m/s at which half of the surplus is gone.
        dwell_time: Time constant in s with which the surplus builds up at rest.
        viscous: Further arm per speed, m per m/s.
        presliding: Way in m over which the contact bends before it resists in full (``bent``); 0
            for a ball that friction holds at once and entirely.
        map: How friction and level vary over the screen; None for neither.

    Raises:
        ModelError: If a number is out of range.
    """

    rolling: Number = setting(
        "plant.friction.rolling_mm", 0.18, Unit.MM, ge=0, le=10, otherwise=0.0
    )
    breakaway_ratio: Number = setting("plant.friction.breakaway_ratio", 1.0, ge=1, le=20)
    stribeck_speed: Number = setting("plant.friction.stribeck_speed", 0.005, ge=1e-4, le=10)
    dwell_time: Number = setting("plant.friction.dwell_time", 0.0, ge=0)
    viscous: Number = setting("plant.friction.viscous_mm", 0.0, Unit.MM, ge=0, le=1000)
    presliding: Number = setting("plant.friction.presliding_um", 0.0, Unit.UM, ge=0, le=1000)
    map: SurfaceMap | None = None

    def __post_init__(self) -> None:
        """Check the ranges."""
        check(self)

    @property
    def absent(self) -> NDArray[np.bool_]:
        """Whether there is no resistance at all, shape () or (N,)."""
        return np.asarray((np.asarray(self.rolling) == 0) & (np.asarray(self.viscous) == 0))

    @cached_property
    def constant(self) -> bool:
        """Whether the arm depends neither on speed nor on rest nor on place."""
        same = self.map is None and not (np.any(self.viscous) or self.bending)
        return bool(same and np.all(np.asarray(self.breakaway_ratio) == 1))

    @cached_property
    def bending(self) -> bool:
        """Whether the contact of any rig bends before it resists in full."""
        return bool(np.any(self.presliding))

    def bent(self, bend: Array, velocity: Array, time: float) -> Array:
        """How far contacts are bent after a time at constant velocities, m, shape (N, 2).

        Args:
            bend: How far before, m, shape (N, 2).
            velocity: Of the balls on the screen, m/s, shape (N, 2).
            time: In s.
        """
        distance = np.broadcast_to(self.presliding, bend.shape[:-1])
        some = np.where(distance > 0, distance, 1.0)
        return np.where((distance > 0)[:, None], bent(bend, velocity, time, some), 0.0)

    def share(self, bend: Array) -> Array:
        """What share of the full resistance acts, as a vector against the ball's way, (N, 2)."""
        distance = np.broadcast_to(self.presliding, bend.shape[:-1])[:, None]
        return np.asarray(bend / np.where(distance > 0, distance, 1.0))

    @cached_property
    def sticking(self) -> bool:
        """Whether it takes more to break a ball away than to keep it rolling."""
        return bool(np.any(np.asarray(self.breakaway_ratio) > 1))

    @cached_property
    def ageing(self) -> bool:
        """Whether the age of the contact has to be carried along."""
        return bool(self.sticking and np.any(self.dwell_time))

    def settled(self, speed: Array) -> Array:
        """Age of a contact that has long rolled at a speed in m/s, shape (...)."""
        share: Array = 1 / (1 + (speed / np.asarray(self.stribeck_speed)) ** 2)
        return share

    def aged(self, age: Array, speed: Array, time: float) -> Array:
        """Age after a time in s at a constant speed in m/s, all shape (...)."""
        goal = self.settled(speed)
        dwell = np.asarray(self.dwell_time)
        with np.errstate(divide="ignore"):
            # at dwell_time 0 the exponent is -inf: the age is the settled one at once
            left = np.exp(-time / (goal * dwell))
        result: Array = goal + (age - goal) * left
        return result

    def arm(self, speed: Array, position: Array, age: Array | None = None) -> Array:
        """Resistance arm in m, shape (...).

        Args:
            speed: Speed of the ball on the screen, m/s, shape (...).
            position: Its place in m, shape (..., 2).
            age: Age of the contact; None for the settled one.
        """
        arm = np.asarray(self.rolling, float)
        if self.sticking:
            surplus = self.settled(speed) if age is None else age
            arm = arm * (1 + (np.asarray(self.breakaway_ratio) - 1) * surplus)
        if self.map is not None:
            arm = arm * self.map(position)[0]
        return np.asarray(arm + np.asarray(self.viscous) * speed)

    def deceleration(
        self, model: BallPlate, x: Array, age: Array | None = None, normal: Array | None = None
    ) -> Array:
        """Largest acceleration in m/s^2 that the resistance can take away, shape (...,).

        From J/r^2 and m in the balance of the rolling ball: c1 (arm / r) times the normal force
        per mass.

        Args:
            model: The ball.
            x: State of (5.5), shape (..., 8).
            age: Age of the contact; None for the settled one.
            normal: Normal force per mass in m/s^2; None for g cos(theta) cos(phi) (plate
                accelerations change it by under 1 %).
        """
        if normal is None:
            normal = model.gravity * np.cos(x[..., 6]) * np.cos(x[..., 2])
        if self.constant:
            arm = np.asarray(self.rolling)
        else:
            arm = self.arm(np.hypot(x[..., 1], x[..., 5]), x[..., 0::4], age)
        result: Array = model.c1 * (arm / model.radius) * normal
        return result
