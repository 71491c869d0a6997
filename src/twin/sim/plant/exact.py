"""A ball that rolls on a plate with a given motion, as a plant: Newton and Euler, exactly.

Axes are the plate's, R = Rx(theta) Ry(phi); dots are rates of components in them. The plate turns
with w = (theta' cos phi, phi', theta' sin phi); the ball's centre is at p = (x, y, d); the ball
turns with W, and relative to the plate with s = W - w. F is the force of the contact on the ball,
g gravity, m, r and J mass, radius and moment of inertia. Then

    (R1)  rolling without slip       (x', y') = r (s_y, -s_x)
    (R2)  Newton                     m a = F + m g,  a = p'' + w' x p + 2 w x p' + w x (w x p)
    (R3)  Euler                      J (W' + w x W) = (0, 0, -r) x F = (r F_y, -r F_x, 0)

The third line of (R3) has no torque: the contact force acts through the normal that goes through
the centre, and nothing resists pivoting. So the spin n = W_z about the normal changes only because
the normal turns. With W_x = w_x - y'/r and W_y = w_y + x'/r of (R1),

    (R4)  spin                       n' = -(w x W)_z = -(w_x x' + w_y y') / r

F_x and F_y of (R2) put into the first lines of (R3) give the motion of the ball. With
c1 = m r^2 / (m r^2 + J), c2 = c1 d + (1 - c1) r and s_z = n - w_z,

    (R5)  x'' = c1 [g_x + (w_y^2 + w_z^2) x + (w_z' - w_x w_y) y - d w_x w_z]
                - c2 w_y' + (1 + c1) w_z y' + (1 - c1) r w_x s_z
          y'' = c1 [g_y - (w_z' + w_x w_y) x + (w_x^2 + w_z^2) y - d w_y w_z]
                + c2 w_x' - (1 + c1) w_z x' + (1 - c1) r w_y s_z

What is done with s_z is the ball's ``BallSpin``:

- ``free``: n is a state and obeys (R4), as on the mechanism but for its resistance to pivoting.
- ``locked``: s_z = 0. A torque about the normal, which the contact does not have, holds the ball.
- ``thesis``: (5.9) puts (R1) into the kinetic energy and takes Lagrange's equations. That is not
  allowed of a condition on velocities that cannot be integrated (a nonholonomic one): with s_z = 0
  it has 2 c1 w_z where (1 + c1) w_z is right. The laws of the thesis are designed on it.

A known case tells them apart: on a level turntable (w_z constant, w_x = w_y = 0) (R5) is
v' = (1 + c1) w_z (v_y, -v_x) + c1 w_z^2 p, so that in axes that stand still the ball circles at
(1 - c1) w_z: 2/7 of the table's rate for a solid ball. By (5.9) there is no circle: the ball
spirals outwards, growing as exp(sqrt(c1 (1 - c1)) w_z t).

The spin is kept as the speed q = sqrt(1 - c1) r n: its kinetic energy (m + J/r^2) q^2 / 2 is the
spin's J n^2 / 2. With h = sqrt(1 - c1) (w_x, w_y) its part of (R5) is h q, and (R4) q' = -h v: spin
and rolling exchange energy. The balls then move with resistance, by RK4.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.arrays import ARRAY_ARITHMETIC, NUMBER_ARITHMETIC, Array, Mask, Number, put
from controllers.ballplate import BallPlate
from twin.base.errors import ModelError
from twin.hal.interface import SCREEN_SIZE_M
from twin.hal.linkage import Transmitting
from twin.sim.plant.friction import Contacts, Friction, resist
from twin.sim.plant.interface import BallSpin, tilted_gravity
from twin.sim.plant.rim import Rim, Walls


class RollingModel(NamedTuple):
    """Constants of (R5) for one treatment of the spin; also of symbols.

    ``free`` has the constant part of s_z, -w_z, in the levers.
    """

    c1: Any
    """Share of gravity that accelerates the ball, (5.1)."""
    c2: Any
    """Lever of the plate's acceleration in m, (5.1)."""
    turn: Any
    """Factor of w_z in the coefficient of the velocity."""
    lever_x: Any
    """Factor of -c1 w_x w_z in x'', m."""
    lever_y: Any
    """Factor of -c1 w_y w_z in y'', including the factor of w_x', m."""
    share: Any
    """sqrt(1 - c1) if the ball's spin is a state, else 0."""

    @classmethod
    def of(cls, model: Any, spin: BallSpin) -> RollingModel:
        """The constants of a ball and plate.

        Args:
            model: A ``BallPlate``, or what has its ``constants``.
            spin: What its spin does.
        """
        c1, c2 = model.c1, model.c2
        if spin == "free":
            return cls(c1, c2, 1 + c1, model.c4, 2 * model.c4, (1 - c1) ** 0.5)
        return cls(c1, c2, 2 * c1 if spin == "thesis" else 1 + c1, model.d, model.c3, 0.0)


class Rolling(NamedTuple):
    """The ball's equations at an instant at which the plate's motion is given.

    They are linear in the ball's own position and velocity (plate axes, m and m/s) and in the
    speed q of its spin (m/s)::

        x'' = xx x + xy y + turn y' + px + hx q
        y'' = yx x + yy y - turn x' + py + hy q
        q'  = -hx x' - hy y'

    Numbers for one rig, arrays of one shape for several.
    """

    xx: Any
    xy: Any
    yx: Any
    yy: Any
    """Coefficients of the position in 1/s^2."""
    turn: Any
    """Coefficient of the velocity in 1/s."""
    px: Any
    py: Any
    """What is left of a ball at rest on the middle, m/s^2."""
    hx: Any
    hy: Any
    """Coefficients of the spin in 1/s; 0 of one that is no state."""
    normal: Any
    """Force per mass that presses the ball on the plate, without the plate's motion, m/s^2."""

    def free(self, x: Any, vx: Any, y: Any, vy: Any, q: Any) -> tuple[Any, Any]:
        """Acceleration (x'', y'') of a ball without resistance, m/s^2."""
        xx, xy, yx, yy, turn, px, py, hx, hy, _ = self
        return (
            xx * x + xy * y + turn * vy + px + hx * q,
            yx * x + yy * y - turn * vx + py + hy * q,
        )


def rolling(
    model: RollingModel,
    sines: Iterable[Any],
    cosines: Iterable[Any],
    rates: Iterable[Any],
    u: Iterable[Any],
    gravity: Iterable[Any],
) -> Rolling:
    """(R5) and (R4) gathered for the ball, where the plate's motion is given.

    Each argument is taken apart into plain numbers, or arrays of one shape, per component.

    Args:
        model: Of ball and plate.
        sines: Of (phi, theta).
        cosines: Of (phi, theta).
        rates: (phi', theta') in rad/s.
        u: (phi'', theta'') in rad/s^2.
        gravity: Gravity (x, y, z) in the axes of the base, m/s^2; (0, 0, -g) if it is level.
    """
    (s3, s7), (c3, c7), (wy, w7), (u1, u2) = sines, cosines, rates, u
    gx, gy, gz = gravity
    c1, c2, turn, lever_x, lever_y, share = model
    wx, wz, down = w7 * c3, w7 * s3, c7 * gz - s7 * gy
    xy = c1 * s3 * u2
    return Rolling(
        c1 * (wz * wz + wy * wy),
        xy,
        -2 * c1 * wx * wy - xy,
        c1 * w7 * w7,
        turn * wz,
        c1 * (c3 * gx - s3 * down - lever_x * wx * wz) - c2 * u1,
        c1 * (c7 * gy + s7 * gz - lever_y * wy * wz) + c2 * c3 * u2,
        share * wx,
        share * wy,
        -s3 * gx - c3 * down,
    )


class BallMotion(Contacts):
    """The balls of N rigs: their acceleration, and their contacts with the screen.

    A ball is (x, x', y, y') in plate axes, m and m/s: numbers where ``single``, else arrays (N,).

    Args:
        model: Parameters of ball and plate.
        friction: Rolling resistance; None for the thesis's frictionless ball.
        rigs: Number of balls.
        step: Physics step in s.
        spin: What the balls' spin does.
        rim: Walls that stop the balls; None for none.
        rounded: Whether the plates are round, shape () or (N,).
    """

    def __init__(
        self,
        model: BallPlate,
        friction: Friction | None,
        *,
        rigs: int,
        step: float,
        spin: BallSpin = "free",
        rim: Rim | None = None,
        rounded: ArrayLike = False,
    ) -> None:
        super().__init__(friction, rigs)
        self.model = model
        self.equations = RollingModel.of(model, spin)
        self.single = rigs == 1 and (friction is None or friction.constant)
        """Whether plain numbers do."""
        self.by = NUMBER_ARITHMETIC if self.single else ARRAY_ARITHMETIC
        self._rigs, self._step = rigs, step
        self._spin_speed: Any = 0.0 if self.single else np.zeros(rigs)
        """The speed q of the spin, m/s; stays 0 where it is no state."""
        self._bending = friction is not None and friction.bending
        surface = None if friction is None else friction.map
        self._slope = surface if surface is not None and surface.sloping else None
        self._free = Rolling.free if self._slope is None else self._downhill
        self._acceleration = self._free if friction is None else self._resisted
        self._grip: Any = None
        """Deceleration by friction over the normal acceleration, where it is constant."""
        if friction is not None and friction.constant:
            grip = model.c1 * (np.asarray(friction.rolling) / model.radius)
            self._grip = grip.item() if self.single else grip
        self.walls: Walls | None = None
        """Walls that stop the balls."""
        if rim is not None and rim.given:
            self.walls = Walls(rim, model.radius, rounded, rigs=rigs, single=self.single)
            if friction is None:
                self._acceleration = self._supported

    @property
    def spin(self) -> Array:
        """Rates n of the balls about the plate's normal, rad/s, (N,); 0 where they are no state."""
        scale = self.equations.share * self.model.radius
        found = np.broadcast_to(self._spin_speed, (self._rigs,))
        return np.zeros(self._rigs) if scale == 0 else found / scale

    @spin.setter
    def spin(self, rate: Number) -> None:
        speed = np.broadcast_to(rate, (self._rigs,)) * (self.equations.share * self.model.radius)
        self._spin_speed = speed.item() if self.single else speed

    def go_on(self, before: Contacts, x: Array) -> None:
        """Begin where the motion ``before`` of the same balls ends, in the state x, (N, 8)."""
        super().go_on(before, x)
        if isinstance(before, BallMotion):
            self.spin = before.spin

    def step(self, ball: Any, begin: Rolling, middle: Rolling, end: Rolling) -> tuple[Any, ...]:
        """The balls (x, x', y, y') after one step of RK4, by the equations within it."""
        h, half = self._step, self._step / 2
        x, vx, y, vy = ball
        if self._bending:
            self._bend_on(ball, half)
        acceleration = self._acceleration
        q, hx, hy = self._spin_speed, middle.hx, middle.hy
        ax, ay = acceleration(begin, x, vx, y, vy, q)
        vx2, vy2, lost = vx + half * ax, vy + half * ay, begin.hx * vx + begin.hy * vy
        ax2, ay2 = acceleration(middle, x + half * vx, vx2, y + half * vy, vy2, q - half * lost)
        vx3, vy3, lost2 = vx + half * ax2, vy + half * ay2, hx * vx2 + hy * vy2
        ax3, ay3 = acceleration(middle, x + half * vx2, vx3, y + half * vy2, vy3, q - half * lost2)
        vx4, vy4, lost3 = vx + h * ax3, vy + h * ay3, hx * vx3 + hy * vy3
        ax4, ay4 = acceleration(end, x + h * vx3, vx4, y + h * vy3, vy4, q - h * lost3)
        sixth, lost4 = h / 6, end.hx * vx4 + end.hy * vy4
        after_x = x + sixth * (vx + 2 * (vx2 + vx3) + vx4)
        after_y = y + sixth * (vy + 2 * (vy2 + vy3) + vy4)
        after_vx = vx + sixth * (ax + 2 * (ax2 + ax3) + ax4)
        after_vy = vy + sixth * (ay + 2 * (ay2 + ay3) + ay4)
        self._spin_speed = q - sixth * (lost + 2 * (lost2 + lost3) + lost4)
        if self.walls is not None and self.by.any(self.walls.met(after_x, after_y)):
            after = after_x, after_vx, after_y, after_vy
            after_x, after_vx, after_y, after_vy = self.walls.rebound(h, ball, after)
        if self.friction is not None:
            held, where = self._held(ball, begin, q), self.by.where
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

    def _downhill(self, at: Rolling, x: Any, vx: Any, y: Any, vy: Any, q: Any) -> tuple[Any, Any]:
        """Acceleration of the ball without resistance on a screen that slopes."""
        assert self._slope is not None
        ax, ay = at.free(x, vx, y, vy, q)
        slope = self.model.c1 * at.normal * self._slope(np.stack((x, y), axis=-1))[1].T
        return ax - slope[0], ay - slope[1]

    def _supported(self, at: Rolling, x: Any, vx: Any, y: Any, vy: Any, q: Any) -> tuple[Any, Any]:
        """Acceleration of the ball without resistance, where a wall takes what pushes on it."""
        free = self._free(at, x, vx, y, vy, q)
        return free if self.walls is None else self.walls.support(x, vx, y, vy, free)

    def _resisted(self, at: Rolling, x: Any, vx: Any, y: Any, vy: Any, q: Any) -> tuple[Any, Any]:
        """Acceleration of the ball with resistance."""
        assert self.friction is not None
        limit = self._limit(at, x, vx, y, vy)
        supported = self._supported(at, x, vx, y, vy, q)
        stiff = resist(limit, (vx, vy), supported, self.by)
        if not self._bending:
            return stiff
        share, bends = self.friction.share(self.bend).T, np.asarray(self.friction.presliding) > 0
        ax, ay = self._free(at, x, vx, y, vy, q)
        soft = ax - limit * share[0], ay - limit * share[1]
        if self.walls is not None:
            soft = self.walls.support(x, vx, y, vy, soft)
        return np.where(bends, soft[0], stiff[0]), np.where(bends, soft[1], stiff[1])

    def _limit(self, at: Rolling, x: Any, vx: Any, y: Any, vy: Any) -> Any:
        """Largest acceleration in m/s^2 that friction can take away."""
        if self._grip is not None:
            return self._grip * at.normal
        assert self.friction is not None
        level = 0.0 * x
        state = np.array((x, vx, level, level, y, vy, level, level)).T.copy()
        return self.friction.deceleration(self.model, state, self.age, at.normal)

    def _held(self, ball: Any, at: Rolling, q: Any) -> Any:
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
        ax, ay = self._supported(at, x, rest, y, rest, q)
        hold = self._limit(at, x, rest, y, rest)
        return slow & (ax * ax + ay * ay <= hold * hold)


class ExactPlant:
    """N balls on plates with a given motion, (R5), integrated by RK4 at the physics step.

    The servos are ideal: within one call of ``advance`` each plate rate runs linearly from its
    present value to the commanded one, so the plate acceleration is constant over a control period
    and the plate's motion is known in closed form. Servos with cranks turn those so; the plate's
    angles and rates are then those of the linkage at each end of the period, and between them the
    cubic that joins these.

    One formula is calculated with arrays for several rigs and, where nothing depends on the ball's
    place or past, with plain numbers for one: several times faster and the same to the last bit.

    Args:
        model: Parameters of ball and plate.
        rigs: Number of copies.
        step: Physics step in s.
        friction: Rolling resistance; None for the thesis's frictionless ball.
        level: Tilt (phi, theta) in rad of the base the plate angles are measured against, shape
            (2,) or (N, 2).
        size: Sides of the screen along x and y in m, shape (2,) or (N, 2).
        rounded: Whether it is round, with the first side as its diameter, shape () or (N,).
        linkage: What lies between servos and plate; None for servos on the plate's axes.
        ball_spin: What the spin of the balls about the plate's normal does.
        rim: Walls that stop the balls; None for plates that they may fall off.
    """

    channels: tuple[str, ...] = ()

    def __init__(
        self,
        model: BallPlate | None = None,
        *,
        rigs: int = 1,
        step: float = 0.001,
        friction: Friction | None = None,
        level: ArrayLike = (0.0, 0.0),
        size: ArrayLike = SCREEN_SIZE_M,
        rounded: ArrayLike = False,
        linkage: Transmitting | None = None,
        ball_spin: BallSpin = "free",
        rim: Rim | None = None,
    ) -> None:
        self.rigs = rigs
        self.ratio: Number = 1.0 if linkage is None else linkage.ratio
        self.linkage = linkage
        self.step = step
        self._shape(size, rounded)
        self._equip(model or BallPlate(), friction, level, ball_spin, rim)
        self._x: Array = np.zeros((rigs, 8))
        self._fallen = np.zeros(rigs, bool)
        self.start(np.zeros((rigs, 4)))

    def change(self, size: ArrayLike, rounded: ArrayLike, **equations: Any) -> None:
        """Go on with a new screen, ball, friction and level; arguments as in the constructor."""
        before = self._balls
        self._shape(size, rounded)
        self._equip(**equations)
        self._balls.go_on(before, self._x)

    def _shape(self, size: ArrayLike, rounded: ArrayLike) -> None:
        self._sides = np.broadcast_to(np.asarray(size, float), (self.rigs, 2))
        self._rounded = np.broadcast_to(np.asarray(rounded, bool), (self.rigs,))
        self._round = bool(self._rounded.any())

    def _equip(
        self,
        model: BallPlate,
        friction: Friction | None,
        level: ArrayLike,
        ball_spin: BallSpin = "free",
        rim: Rim | None = None,
    ) -> None:
        self.model, self.friction, self.ball_spin = model, friction, ball_spin
        self._balls = BallMotion(
            model,
            friction,
            rigs=self.rigs,
            step=self.step,
            spin=ball_spin,
            rim=rim,
            rounded=self._rounded,
        )
        self._single = self._balls.single
        self._half = self._components(self._sides / 2)
        gravity = tilted_gravity(level, model.gravity).T
        self._gravity: Any = gravity.ravel().tolist() if self._single else gravity

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put every plate level and at rest with its ball at (x, x', y, y'), shape (N, 4).

        A ball at rest is taken to have rested long.

        Args:
            ball: Positions in m and speeds in m/s of the rolling balls.
            spin: Their rates about the vertical, rad/s.

        Raises:
            ModelError: If a ball is to spin and its spin is no state.
        """
        self.begin(np.arange(self.rigs), ball, spin)

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some rigs to the start as ``start`` does, the others as they are.

        Raises:
            ModelError: If a ball is to spin and its spin is no state.
        """
        if np.any(spin) and self.ball_spin != "free":
            raise ModelError(f"a ball with '{self.ball_spin}' spin cannot start with a spin")
        fresh = np.zeros((len(rigs), 8))
        fresh[:, (0, 1, 4, 5)] = ball
        self._x = put(self._x, rigs, fresh)
        self._balls.begin(rigs, self._x)
        self._balls.spin = put(self._balls.spin, rigs, spin)
        self._fallen[rigs] = False

    def place(self, ball: Array) -> None:
        """Put the balls at (x, x', y, y') on plates that stay as they are, shape (N, 4).

        About the normal they turn with their plates.
        """
        self._x = self._x.copy()
        self._x[:, (0, 1, 4, 5)] = ball
        self._balls.spin = self._turning()
        self._balls.bend = np.zeros((self.rigs, 2))
        self._fallen = np.zeros(self.rigs, bool)

    def resume(self, x: Array, age: Array | None = None, spin: Array | None = None) -> None:
        """Go on from any states x of (5.5), shape (N, 8), the balls on the screen.

        Args:
            x: The states.
            age: Ages of the contacts, shape (N,), where friction has them; None for long settled.
            spin: Rates of the balls about the plate's normal, rad/s, shape (N,); None for balls
                that turn with their plates.
        """
        self._x = np.array(x, float)
        self._fallen = np.zeros(self.rigs, bool)
        self._balls.settle(self._x, None if age is None else np.array(age, float))
        self._balls.spin = self._turning() if spin is None else np.array(spin, float)

    def _turning(self) -> Array:
        """Rates of the plates about their normals, theta' sin(phi), rad/s, shape (N,)."""
        return np.asarray(self._x[:, 7] * np.sin(self._x[:, 2]))

    @property
    def spin(self) -> Array:
        """Rates of the balls about the plate's normal, seen from the base, rad/s, shape (N,)."""
        return self._balls.spin if self.ball_spin == "free" else self._turning()

    @property
    def age(self) -> Array | None:
        """Ages of the contacts, shape (N,), where friction has them."""
        return self._balls.age

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Ramp to the plate rates (rad/s, shape (N, 2)) over a number of physics steps."""
        x, vx, phi, phi_rate, y, vy, theta, theta_rate = self._components(self._x)
        to_phi, to_theta = self._components(motor_rate)
        period, half = steps * self.step, self.step / 2
        u = (to_phi - phi_rate) / period, (to_theta - theta_rate) / period
        jerk = 0.0, 0.0
        if self.linkage is not None:
            u, jerk = map(self._components, self._through(self.linkage, motor_rate, period))
        plate = (phi, theta), (phi_rate, theta_rate), u, jerk
        equations = self._along(plate, [half * i for i in range(2 * steps + 1)])
        for i in range(0, 2 * steps, 2):
            x, vx, y, vy = self._balls.step((x, vx, y, vy), *equations[i : i + 3])
        (phi, theta), (phi_rate, theta_rate), _ = _plate_after(plate, period)
        self._x = self._state(x, vx, phi, phi_rate, y, vy, theta, theta_rate)
        off = (abs(x) > self._half[0]) | (abs(y) > self._half[1])
        if self._round:
            off = off | (self._rounded & (x * x + y * y > self._half[0] * self._half[0]))
        if self._balls.by.any(off):
            self._fallen |= off

    def _through(self, linkage: Transmitting, rate: Array, period: float) -> tuple[Array, Array]:
        """Initial acceleration, and jerk, of plates with cranks that ramp to rates in rad/s."""
        angle, before = self._x[:, 2::4], self._x[:, 3::4]
        motor = linkage.motor(angle)
        motor += period / 2 * (linkage.motor_rate(angle, motor, before) + rate)
        there = linkage.plate(motor)
        after, mean = linkage.plate_rate(there, motor, rate), (there - angle) / period
        acceleration = (6 * mean - 4 * before - 2 * after) / period
        return acceleration, 6 * (before + after - 2 * mean) / period**2

    @property
    def state(self) -> Array:
        """True state in the order of (5.5), shape (N, 8)."""
        return self._x

    @property
    def motor(self) -> Array:
        """Angles of the cranks; without, of the plate, which the servos turn itself, (N, 2)."""
        angle = self._x[:, 2::4]
        return angle if self.linkage is None else self.linkage.motor(angle)

    @property
    def on_plate(self) -> Mask:
        """Whether the ball has never left the screen, shape (N,)."""
        return ~self._fallen

    @property
    def diverged(self) -> Mask:
        """Whether the state is no longer finite, shape (N,)."""
        return np.asarray(~np.isfinite(self._x).all(axis=1))

    def telemetry(self) -> Array:
        """Nothing beyond the state, shape (N, 0)."""
        return self._x[:, :0]

    def _components(self, array: Array) -> Any:
        """The columns of an array (N, k): k numbers for one rig, else k arrays (N,)."""
        return array[0].tolist() if self._single else array.T.copy()

    def _state(self, *components: Any) -> Array:
        """The reverse for a state, shape (N, 8)."""
        if self._single:
            return np.array([components])
        return np.array(components).T.copy()

    def _along(self, plate: Any, times: list[float]) -> list[Rolling]:
        """The ball's equations at each time of the plate's (angles, rates, accelerations)."""
        model = self._balls.equations
        if not self._single:
            angle, rate, u = _plate_after(plate, np.array(times)[:, None])
            table = rolling(model, np.sin(angle), np.cos(angle), rate, u, self._gravity)
            return [Rolling(*each) for each in zip(*table, strict=True)]
        angles, rates, u = zip(*(_plate_after(plate, time) for time in times), strict=True)
        # numpy's sine here too: the math module's need not have the same last bits
        all_angles = np.array(angles)
        sines, cosines = np.sin(all_angles).tolist(), np.cos(all_angles).tolist()
        moving = zip(sines, cosines, rates, u, strict=True)
        return [rolling(model, *each, self._gravity) for each in moving]


def _plate_after(plate: Any, time: Any) -> tuple[Any, Any, Any]:
    """Plate angles, rates and accelerations, each of (phi, theta), after a time of constant jerk.

    Args:
        plate: Angles, rates, accelerations and jerks of (phi, theta) to begin with.
        time: In s.
    """
    (phi, theta), (wy, w7), (u1, u2), (j1, j2) = plate
    return (
        (
            phi + time * (wy + time / 2 * (u1 + time / 3 * j1)),
            theta + time * (w7 + time / 2 * (u2 + time / 3 * j2)),
        ),
        (wy + time * (u1 + time / 2 * j1), w7 + time * (u2 + time / 2 * j2)),
        (u1 + time * j1, u2 + time * j2),
    )
