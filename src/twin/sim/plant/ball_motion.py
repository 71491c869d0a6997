"""How balls move on plates whose motion is given: the rows of (5.9a), resistance and RK4."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import ARRAYS, NUMBERS, Array, put
from controllers.ballplate import BallPlate
from twin.sim.plant.friction import Friction, resisted
from twin.sim.plant.rolling import Rolling


class BallMotion:
    """The balls of N rigs: their acceleration, and their contacts with the screen.

    A ball is (x, x', y, y') in plate axes, m and m/s: numbers where ``single``, else arrays (N,).

    Args:
        model: Parameters of ball and plate.
        friction: Rolling resistance; None for the thesis's frictionless ball.
        rigs: Number of balls.
        step: Physics step in s.
    """

    def __init__(
        self, model: BallPlate, friction: Friction | None, *, rigs: int, step: float
    ) -> None:
        self.model, self.friction = model, friction
        self.single = rigs == 1 and (friction is None or friction.constant)
        """Whether plain numbers do."""
        self.by = NUMBERS if self.single else ARRAYS
        self.age: Array | None = None
        """Age of each contact, shape (N,), where friction has one."""
        self.bend: Array = np.zeros((rigs, 2))
        """How far each contact is bent, m, shape (N, 2); stays 0 of one that does not."""
        self._rigs, self._step = rigs, step
        self._ageing = friction is not None and friction.ageing
        self._bending = friction is not None and friction.bending
        surface = None if friction is None else friction.map
        self._slope = surface if surface is not None and surface.sloping else None
        self._grip: Any = None
        """Deceleration by friction over the normal acceleration, where it is constant."""
        if friction is not None and friction.constant:
            grip = model.c1 * (np.asarray(friction.rolling) / model.radius)
            self._grip = grip.item() if self.single else grip

    def start(self, x: Array) -> None:
        """Begin with the state x, (N, 8); a ball at rest is taken to have rested long."""
        self.settle(x)
        self.straighten()

    def begin(self, rigs: NDArray[np.integer], x: Array) -> None:
        """Begin with some rigs of the state x, (N, 8), anew."""
        if self.age is not None:
            self.age = put(self.age, rigs, self._settled(x)[rigs])
        self.bend = put(self.bend, rigs, np.zeros((len(rigs), 2)))

    def go_on(self, before: BallMotion, x: Array) -> None:
        """Begin where other contacts of the same balls end, in the state x, (N, 8)."""
        self.settle(x, before.age)
        self.bend = before.bend

    def settle(self, x: Array, age: Array | None = None) -> None:
        """Let contacts be of an age, shape (N,); None for one long in the state x, (N, 8)."""
        if self._ageing:
            self.age = self._settled(x) if age is None else age

    def straighten(self) -> None:
        """Let no contact be bent."""
        self.bend = np.zeros((self._rigs, 2))

    def _settled(self, x: Array) -> Array:
        """Age of contacts that have long been in the state x, shape (N,)."""
        assert self.friction is not None
        return self.friction.settled(np.hypot(x[:, 1], x[:, 5]))

    def step(self, ball: Any, begin: Rolling, middle: Rolling, end: Rolling) -> tuple[Any, ...]:
        """The balls (x, x', y, y') after one step of RK4, by the equations within it."""
        h, half = self._step, self._step / 2
        x, vx, y, vy = ball
        if self._bending:
            self._bend_on(ball, half)
        acceleration = self._free if self.friction is None else self._resisted
        ax, ay = acceleration(begin, x, vx, y, vy)
        vx2, vy2 = vx + half * ax, vy + half * ay
        ax2, ay2 = acceleration(middle, x + half * vx, vx2, y + half * vy, vy2)
        vx3, vy3 = vx + half * ax2, vy + half * ay2
        ax3, ay3 = acceleration(middle, x + half * vx2, vx3, y + half * vy2, vy3)
        vx4, vy4 = vx + h * ax3, vy + h * ay3
        ax4, ay4 = acceleration(end, x + h * vx3, vx4, y + h * vy3, vy4)
        after_x = x + h / 6 * (vx + 2 * (vx2 + vx3) + vx4)
        after_y = y + h / 6 * (vy + 2 * (vy2 + vy3) + vy4)
        after_vx = vx + h / 6 * (ax + 2 * (ax2 + ax3) + ax4)
        after_vy = vy + h / 6 * (ay + 2 * (ay2 + ay3) + ay4)
        if self.friction is not None:
            held, where = self._held(ball, begin), self.by.where
            after_vx, after_vy = where(held, 0.0, after_vx), where(held, 0.0, after_vy)
            if self._bending:
                self._bend_on((after_x, after_vx, after_y, after_vy), half)
            if self.age is not None:
                speed = np.hypot(vx + after_vx, vy + after_vy) / 2
                self.age = self.friction.aged(self.age, speed, h)
        return after_x, after_vx, after_y, after_vy

    def _bend_on(self, ball: Any, time: float) -> None:
        """Bend the contacts for a time in s at the speed of the balls."""
        assert self.friction is not None
        velocity = np.array(ball[1::2]).reshape(2, self._rigs).T
        self.bend = self.friction.bent(self.bend, velocity, time)

    def _free(self, at: Rolling, x: Any, vx: Any, y: Any, vy: Any) -> tuple[Any, Any]:
        """Acceleration of the ball without resistance."""
        xx, xy, yx, yy, turn, px, py, normal = at
        ax = xx * x + xy * y + turn * vy + px
        ay = yx * x + yy * y - turn * vx + py
        if self._slope is not None:
            slope = self.model.c1 * normal * self._slope(np.stack((x, y), axis=-1))[1].T
            return ax - slope[0], ay - slope[1]
        return ax, ay

    def _resisted(self, at: Rolling, x: Any, vx: Any, y: Any, vy: Any) -> tuple[Any, Any]:
        """Acceleration of the ball with resistance."""
        assert self.friction is not None
        ax, ay = self._free(at, x, vx, y, vy)
        limit = self._limit(at, x, vx, y, vy)
        stiff = resisted(limit, (vx, vy), (ax, ay), self.by)
        if not self._bending:
            return stiff
        share, bends = self.friction.share(self.bend).T, np.asarray(self.friction.presliding) > 0
        soft = ax - limit * share[0], ay - limit * share[1]
        return np.where(bends, soft[0], stiff[0]), np.where(bends, soft[1], stiff[1])

    def _limit(self, at: Rolling, x: Any, vx: Any, y: Any, vy: Any) -> Any:
        """Largest acceleration in m/s^2 that friction can take away."""
        if self._grip is not None:
            return self._grip * at.normal
        assert self.friction is not None
        level = 0.0 * x
        state = np.array((x, vx, level, level, y, vy, level, level)).T.copy()
        return self.friction.deceleration(self.model, state, self.age, at.normal)

    def _held(self, ball: Any, at: Rolling) -> Any:
        """Whether friction takes away a ball's last speed within this step and holds the ball."""
        x, vx, y, vy = ball
        reach = self._limit(at, x, vx, y, vy) * self._step
        slow = vx * vx + vy * vy <= reach * reach
        if self._bending:
            assert self.friction is not None
            slow = slow & (np.asarray(self.friction.presliding) == 0)
        if not self.by.any(slow):
            return slow
        rest = 0.0 * x
        ax, ay = self._free(at, x, rest, y, rest)
        hold = self._limit(at, x, rest, y, rest)
        return slow & (ax * ax + ay * ay <= hold * hold)
