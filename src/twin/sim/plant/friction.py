"""Rolling resistance between ball and screen, and how a screen varies from place to place.

One object for every plant and every study: a contact gives way elastically until it has been bent
far, resists the more the longer it has rested, and differs over the screen, which may not be level.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import ARRAY_ARITHMETIC, Arithmetic, Array, Number, put
from controllers.ballplate import BallPlate
from twin.base.errors import ModelError
from twin.base.followers import FREE, GIVEN, SHAPE, Followers
from twin.base.settings import Unit, check, jump, ramp, setting
from twin.hal.interface import SCREEN_SIZE_M


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceMap:
    """Relative friction and height over a grid of points, straight between them.

    The grid's lines are spread evenly from edge to edge of the screen: the first index goes along
    x, the second along y, both from the negative to the positive edge. Leading axes are rigs.

    Attributes:
        relative: Rolling friction relative to the friction's own, shape (..., n, m), not negative.
        height: Height of the surface in m, shape (..., n, m); only its slope matters.
        size: Sides of the screen along x and y in m, shape (2,) or (rigs, 2).
        bow: By how much the slope along x and y falls per length on that way, 1/m: above 0 the
            middle is the highest place, as of a ball of that curvature.

    Raises:
        ModelError: If a grid has fewer than two lines a side, the two differ in shape, or a number
            is out of range.
    """

    relative: Array | None = None
    height: Array | None = None
    size: tuple[float, float] | Array = SCREEN_SIZE_M
    bow: tuple[float, float] = (0.0, 0.0)
    grids: Array = field(init=False, repr=False)
    """Relative friction, slope along x and along y as one array, shape (N, n, m, 3)."""
    _steps: NDArray[np.integer] = field(init=False, repr=False)
    """Steps of each rig's grid along x and y, shape (N, 2); what lies beyond is not used."""

    def __post_init__(self) -> None:
        """Check the grids and work out the slopes."""
        given = [
            np.asarray(grid, float) for grid in (self.relative, self.height) if grid is not None
        ]
        if not given:
            raise ModelError("a surface map needs a grid of relative friction or of heights")
        shape = given[0].shape
        if any(grid.shape != shape for grid in given) or len(shape) < 2 or min(shape[-2:]) < 2:
            raise ModelError(
                f"a surface map needs equal grids of at least 2 x 2 points, "
                f"got {' and '.join('x'.join(map(str, grid.shape)) for grid in given)}"
            )
        if not all(np.isfinite(grid).all() for grid in given):
            raise ModelError("a surface map must be finite")
        grids = np.zeros((*shape, 3))
        grids[..., 0] = 1.0 if self.relative is None else self.relative
        if (grids[..., 0] < 0).any():
            raise ModelError("relative friction must not be negative")
        if self.height is not None:
            across = [side / (lines - 1) for side, lines in zip(self.size, shape[-2:], strict=True)]
            slopes = np.gradient(np.asarray(self.height, float), *across, axis=(-2, -1))
            grids[..., 1], grids[..., 2] = slopes
        if any(self.bow):
            x, y = (
                np.linspace(-side / 2, side / 2, lines)
                for side, lines in zip(self.size, shape[-2:], strict=True)
            )
            grids[..., 1] -= self.bow[0] * x[:, None]
            grids[..., 2] -= self.bow[1] * y
        object.__setattr__(self, "grids", grids.reshape(-1, *shape[-2:], 3))
        steps = np.subtract(shape[-2:], 1)
        object.__setattr__(self, "_steps", np.tile(steps, (len(self.grids), 1)))

    @property
    def sloping(self) -> bool:
        """Whether the surface is anywhere not flat."""
        return bool(self.grids[..., 1:].any())

    def __call__(self, position: Array) -> tuple[Array, Array]:
        """Relative friction, shape (...), and slope (dz/dx, dz/dy), shape (..., 2).

        Args:
            position: Ball in plate axes in m, shape (..., 2); outside the screen the nearest edge
                counts.
        """
        rig = np.arange(len(self.grids)) if len(self.grids) > 1 else 0
        steps = self._steps[rig]
        place = np.clip((position / self.size + 0.5) * steps, 0, steps)
        corner = np.minimum(place.astype(int), steps - 1)
        i, j = corner[..., 0], corner[..., 1]
        s, t = (place[..., 0] - i)[..., None], (place[..., 1] - j)[..., None]
        g = self.grids
        near = (1 - t) * g[rig, i, j] + t * g[rig, i, j + 1]
        far = (1 - t) * g[rig, i + 1, j] + t * g[rig, i + 1, j + 1]
        value = (1 - s) * near + s * far
        return value[..., 0], value[..., 1:]

    @classmethod
    def random(
        cls,
        *,
        seed: int,
        patch: float = 0.05,
        spread: float = 0.0,
        slope: float = 0.0,
        size: tuple[float, float] = SCREEN_SIZE_M,
        bow: tuple[float, float] = (0.0, 0.0),
    ) -> SurfaceMap:
        """A screen drawn at random: patches of differing friction, and waves.

        Args:
            seed: Which screen.
            patch: Distance of the grid's points in m, roughly the size of a patch.
            spread: Standard deviation of the logarithm of the relative friction, dimensionless.
            slope: Root mean square of the local slope in rad.
            size: Sides of the screen along x and y in m.
            bow: How it is bowed as a whole along x and y, 1/m.
        """
        lines = [max(2, round(side / patch) + 1) for side in size]
        rng = np.random.default_rng(seed)
        relative = np.exp(spread * rng.standard_normal(lines) - spread**2 / 2)
        if slope == 0:
            return cls(relative=relative, size=size, bow=bow)
        waves = cls(height=rng.standard_normal(lines), size=size)
        scale = slope / np.sqrt((waves.grids[..., 1:] ** 2).mean())
        assert waves.height is not None
        return cls(relative=relative, height=scale * waves.height, size=size, bow=bow)

    @classmethod
    def stacked(cls, maps: Sequence[SurfaceMap | None]) -> SurfaceMap | None:
        """The surfaces of N rigs, of one each, as one; None stands for an even, level one."""
        if all(each is maps[0] for each in maps):
            return maps[0]
        even = cls(relative=np.ones((2, 2)))
        given = [even if each is None else each for each in maps]
        sizes = np.array([each.size for each in given])
        steps = np.concatenate([each._steps for each in given])
        grids = np.zeros((len(given), *(steps.max(axis=0) + 1), 3))
        for all_of_it, each in zip(grids, given, strict=True):
            _, n, m, _ = each.grids.shape
            all_of_it[:n, :m] = each.grids[0]
        stacked = copy(even)
        object.__setattr__(stacked, "relative", None)
        object.__setattr__(stacked, "size", sizes)
        object.__setattr__(stacked, "grids", grids)
        object.__setattr__(stacked, "_steps", steps)
        return stacked


Grid = tuple[tuple[float, ...], ...]


ROLLING_FOLLOWERS = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=FREE,
    identify=FREE,
    symbols=FREE,
)
DWELL_FOLLOWERS = replace(ROLLING_FOLLOWERS, symbols="have the contact age of steady rolling")
PRESLIDING_FOLLOWERS = replace(
    DWELL_FOLLOWERS, identify="stops a ball within one time", symbols="smooth friction over a speed"
)
SURFACE_FOLLOWERS = replace(
    ROLLING_FOLLOWERS,
    source=GIVEN,
    identify="treats differences along the screen as noise",
    symbols="have an even screen",
).by("surface")


@dataclass(frozen=True, kw_only=True)
class SurfaceModel:
    """How a screen varies: drawn at random, or grids from edge to edge.

    Attributes:
        spread: Standard deviation of the logarithm of the friction, dimensionless.
        slope: Root mean square of the local slope in rad.
        patch: Length in m over which both change.
        seed: Which screen is drawn.
        relative: Friction relative to the ball's; rows along x, columns along y, both from
            the negative edge to the positive one; empty for none.
        height: Height in m over the same grid; empty for none.
        camber: Acceleration per length in 1/s^2 by which the ball of the scenario rolls off the
            middle of the level plate, along x and along y: x'' = camber x. Below 0 it rolls back.
    """

    spread: float = jump(
        "plant.surface.spread_percent",
        0.0,
        Unit.PERCENT,
        followed_by=SURFACE_FOLLOWERS,
        ge=0,
        le=100,
    )
    slope: float = jump(
        "plant.surface.slope_deg", 0.0, Unit.DEG, followed_by=SURFACE_FOLLOWERS, ge=0, le=2
    )
    patch: float = jump(
        "plant.surface.patch_mm",
        50.0,
        Unit.MM,
        followed_by=SURFACE_FOLLOWERS.by("surface", SHAPE),
        ge=5,
        le=300,
    )
    seed: int = jump(
        "plant.surface.seed", 0, followed_by=SURFACE_FOLLOWERS.by("surface", SHAPE), ge=0
    )
    relative: Grid = jump("plant.surface.relative", (), followed_by=SURFACE_FOLLOWERS, type=Grid)
    height: Grid = jump(
        "plant.surface.height_um", (), Unit.UM, followed_by=SURFACE_FOLLOWERS, type=Grid
    )
    camber: tuple[float, float] = jump(
        "plant.camber", (0.0, 0.0), followed_by=SURFACE_FOLLOWERS, ge=-20, le=20
    )

    def map(self, size: tuple[float, float], model: BallPlate) -> SurfaceMap | None:
        """The surface of a screen with sides in m under a ball; None if it is even and level."""
        push = model.c1 * model.gravity
        bow = self.camber[0] / push, self.camber[1] / push
        if self.relative or self.height or (any(bow) and not (self.spread or self.slope)):
            relative = np.array(self.relative) if self.relative else None
            height = np.array(self.height) if self.height else None
            if relative is None and height is None:
                relative = np.ones((2, 2))
            return SurfaceMap(relative=relative, height=height, size=size, bow=bow)
        if self.spread or self.slope:
            return SurfaceMap.random(
                seed=self.seed,
                patch=self.patch,
                spread=self.spread,
                slope=self.slope,
                size=size,
                bow=bow,
            )
        return None


def resist(
    limit: Any, velocity: tuple[Any, Any], free: tuple[Any, Any], by: Arithmetic = ARRAY_ARITHMETIC
) -> tuple[Any, Any]:
    """Acceleration (x'', y'') of a ball under friction with a limit, from the free one (m/s^2).

    A moving ball is slowed against its velocity; a resting one starts only when the free
    acceleration exceeds the limit. Numbers or arrays of one shape, to match ``by``.
    """
    (vx, vy), (ax, ay), where = velocity, free, by.where
    speed = by.sqrt(vx * vx + vy * vy)
    moving = speed > 0
    if by.all(moving):  # the same, without what only resting balls need
        drag = limit / speed
        return ax - drag * vx, ay - drag * vy
    push = by.sqrt(ax * ax + ay * ay)
    freed = (push > limit) & (push > 0)
    drag = where(moving, limit / where(moving, speed, 1.0), 0.0)
    share = where(freed, 1.0 - limit / where(freed, push, 1.0), 0.0)
    kept = where(moving, 1.0, share)
    return kept * ax - drag * vx, kept * ay - drag * vy


@dataclass(frozen=True, kw_only=True, eq=False)
class Friction:
    """A torque against the rolling: an arm times the force that presses the ball on the screen.

    The arm is the sum of the arm of steady rolling, the gain of a contact at rest, and a viscous
    part::

        arm = relative(x, y) rolling (1 + (breakaway_ratio - 1) age) + viscous v

    The age of the contact, 0 to 1, grows at rest and is rolled off in motion::

        dwell_time age' = 1 - age (1 + (v / stribeck_speed)^2)

    so that at rest it approaches 1 like 1 - exp(-t / dwell_time), and in steady rolling it is the
    Stribeck curve 1 / (1 + (v / stribeck_speed)^2) of Hess and Soom. With ``dwell_time`` 0 it
    always is. Fields are numbers, or arrays with one entry per rig.

    Attributes:
        rolling: Rolling resistance arm in m; a plate at rest tilted by less than
            arctan(arm / radius) holds the ball.
        breakaway_ratio: Resistance arm after a long rest, relative to a rolling ball's; >= 1.
        stribeck_speed: Speed in m/s at which half of the additional breakaway friction remains.
        dwell_time: Time constant in s with which the breakaway friction builds up at rest.
        viscous: Further arm per speed, m per m/s.
        presliding: Way in m over which the contact bends before it resists in full; 0
            for a ball that friction holds at once and entirely.
        map: How friction and level vary over the screen; None for neither.

    Raises:
        ModelError: If a number is out of range.
    """

    rolling: Number = ramp(
        "plant.friction.rolling_mm",
        0.18,
        Unit.MM,
        followed_by=ROLLING_FOLLOWERS.by("friction", 0.0),
        ge=0,
        le=10,
        otherwise=0.0,
    )
    breakaway_ratio: Number = ramp(
        "plant.friction.breakaway_ratio",
        1.0,
        followed_by=ROLLING_FOLLOWERS.by("breakaway"),
        ge=1,
        le=20,
    )
    stribeck_speed: Number = ramp(
        "plant.friction.stribeck_speed",
        0.005,
        followed_by=ROLLING_FOLLOWERS.by("breakaway", SHAPE),
        ge=1e-4,
        le=10,
    )
    dwell_time: Number = ramp(
        "plant.friction.dwell_time", 0.0, followed_by=DWELL_FOLLOWERS.by("breakaway", SHAPE), ge=0
    )
    viscous: Number = ramp(
        "plant.friction.viscous_mm",
        0.0,
        Unit.MM,
        followed_by=ROLLING_FOLLOWERS.by("friction"),
        ge=0,
        le=1000,
    )
    presliding: Number = setting(
        "plant.friction.presliding_um",
        0.0,
        Unit.UM,
        followed_by=PRESLIDING_FOLLOWERS.by("presliding"),
        ge=0,
        le=1000,
    )
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

        The model of Dahl (1968) in the plane: with the velocity v and the presliding distance s,

            z' = v - |v| z / s,

        so that along a straight way w it is z = s n + (z(0) - s n) exp(-w / s), n the heading;
        never longer than s if it was not. The friction is then -F z / s: F itself against the
        velocity once the ball has come far, a spring of stiffness F / s about the place where it
        rests. It stores less than it is given. Known of the model: under a lasting push a ball
        that is shaken creeps, however small the push.

        Args:
            bend: z at the beginning, m, shape (N, 2).
            velocity: Of the balls on the screen, m/s, shape (N, 2).
            time: In s.
        """
        distance = np.broadcast_to(self.presliding, bend.shape[:-1])[:, None]
        length = np.where(distance > 0, distance, 1.0)
        speed = np.sqrt((velocity * velocity).sum(axis=-1, keepdims=True))
        heading = velocity / np.where(speed > 0, speed, 1.0)
        # 1 - exp without loss of digits: a resting ball bends by v t
        after = bend - np.expm1(-speed * time / length) * (length * heading - bend)
        return np.where(distance > 0, after, 0.0)

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
        return 1 / (1 + (speed / np.asarray(self.stribeck_speed)) ** 2)

    def aged(self, age: Array, speed: Array, time: float, before: Array | None = None) -> Array:
        """Age after a time, shape (...): exact for a settled age that changes evenly.

        Args:
            age: At the beginning, shape (...).
            speed: Of the ball in m/s, shape (...).
            time: In s.
            before: Speed at the beginning, if ``speed`` is that at the end; None for a constant
                one.
        """
        goal = self.settled(speed)
        begin = goal if before is None else self.settled(before)
        with np.errstate(divide="ignore"):
            # at dwell_time 0 the exponent is -inf: the age is the settled one at once
            steps = time / ((begin + goal) / 2 * np.asarray(self.dwell_time))
        found = goal + (age - begin) * np.exp(-steps)
        return found if before is None else found + (goal - begin) * np.expm1(-steps) / steps

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
        return model.c1 * (arm / model.radius) * normal


class Contacts:
    """The contacts of N balls with the screen, and what is left in them of their way.

    Args:
        friction: Rolling resistance; None for none.
        rigs: Number of balls.

    Attributes:
        age: Of each contact, shape (N,); None where friction has no age.
        bend: How far each is bent, m, shape (N, 2); stays 0 of one that does not.
    """

    def __init__(self, friction: Friction | None, rigs: int) -> None:
        self.friction = friction
        self.age: Array | None = None
        self.bend: Array = np.zeros((rigs, 2))

    def begin(self, rigs: NDArray[np.integer], x: Array) -> None:
        """Begin with some rigs of the state x, (N, 8); a ball at rest has rested long."""
        before = self.age
        self.settle(x)
        if before is not None and self.age is not None:
            self.age = put(before, rigs, self.age[rigs])
        self.bend = put(self.bend, rigs, 0.0)

    def go_on(self, before: Contacts, x: Array) -> None:
        """Begin where other contacts of the same balls end, in the state x, (N, 8)."""
        self.settle(x, before.age)
        self.bend = before.bend

    def settle(self, x: Array, age: Array | None = None) -> None:
        """Let contacts be of an age, shape (N,); None for one long in the state x, (N, 8)."""
        if self.friction is not None and self.friction.ageing:
            long = self.friction.settled(np.hypot(x[:, 1], x[:, 5]))
            self.age = long if age is None else age
