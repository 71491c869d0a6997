"""The MuJoCo plant: N mechanisms of ``models/`` stepped as one batch.

``Addresses`` has the places of everything of interest in the arrays of a batch, ``BallContact``
applies the friction to each rig's ball in the engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from controllers.arrays import Array, Mask, Number, constant, every
from twin.base.errors import ModelError
from twin.sim.plant.friction import Contacts, Friction
from twin.sim.plant.interface import (
    BallsInPlates,
    Parts,
    from_plate,
    in_own_axes,
    one_ball_in_plate,
    rolling_ball,
)
from twin.sim.plant.model import motor_ratio
from twin.sim.plant.rig_models import RigModels
from twin.sim.plant.rim import Rim, Walls

Indices = NDArray[np.integer]

TELEMETRY_SENSORS = {
    "wheel_phi_N": "wheel_phi_force",
    "wheel_theta_N": "wheel_theta_force",
    "ball_N": "ball_force",
    "torque_phi_Nm": "torque_phi",
    "torque_theta_Nm": "torque_theta",
    "spring_m": "spring_length",
    "motor_phi_rad": "motor_phi",
    "motor_theta_rad": "motor_theta",
}
"""Name in the record, and the sensor that has it as first number; a model need not have all."""


def channels_of(model: mujoco.MjModel) -> dict[str, int]:
    """The channels of ``TELEMETRY_SENSORS`` that a model has: name to place in ``sensordata``."""
    at = _sensors(model)
    return {name: at[sensor] for name, sensor in TELEMETRY_SENSORS.items() if sensor in at}


def _sensors(model: mujoco.MjModel) -> dict[str, int]:
    return {model.sensor(i).name: int(model.sensor_adr[i]) for i in range(model.nsensor)}


@dataclass(frozen=True)
class Addresses:
    """Places of a mechanism in the engine's arrays; axes are ordered phi, theta.

    Attributes:
        level: The keyframe that is level and at rest.
        ball_pose: In ``qpos`` the ball's centre; its orientation follows.
        ball_rate: In ``qvel`` the ball's velocity and angular velocity.
        poses: In ``qpos`` both plate angles and the ball's centre, shape (5,).
        rates: In ``qvel`` their rates, shape (5,).
        state: In ``sensordata`` the state in the order of (5.5), shape (8,).
        over: In ``sensordata`` whether the ball is on the screen.
        telemetry: In ``sensordata`` the channels of ``TELEMETRY``, shape (channels,).
        servo: In ``ctrl`` the motor rates.
        shaft: In ``qpos`` the motor shafts' angles.
    """

    level: int
    ball_pose: slice
    ball_rate: slice
    poses: Indices
    rates: Indices
    state: Indices
    over: int
    telemetry: Indices
    servo: slice | list[int]
    shaft: slice | list[int]

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Self:
        """Those of a model that has all names the plant asks for."""
        ball = model.joint("ball")
        plate = [model.joint(axis) for axis in ("phi", "theta")]
        pose, rate = ball.qposadr[0], ball.dofadr[0]
        at = _sensors(model)
        place, speed = at["ball_position"], at["ball_velocity"]
        along_x = place, speed, at["phi"], at["phi_rate"]
        along_y = place + 1, speed + 1, at["theta"], at["theta_rate"]
        return cls(
            level=model.key("level").id,
            ball_pose=slice(pose, pose + 3),
            ball_rate=slice(rate, rate + 6),
            poses=np.array([*(joint.qposadr[0] for joint in plate), *range(pose, pose + 3)]),
            rates=np.array([*(joint.dofadr[0] for joint in plate), *range(rate, rate + 3)]),
            state=np.array([*along_x, *along_y]),
            over=at["ball_on_plate"],
            telemetry=np.array(list(channels_of(model).values())),
            servo=_columns([model.actuator(f"servo_{axis}").id for axis in ("phi", "theta")]),
            shaft=_columns([model.joint(f"cam_{axis}").qposadr[0] for axis in ("phi", "theta")]),
        )


def _columns(ids: Sequence[int]) -> slice | list[int]:
    """Two columns as a slice where their order allows it: slices are cheap to read and write."""
    first, second = (int(i) for i in ids)
    if second > first:
        return slice(first, second + 1, second - first)
    return [first, second]


MIN_ROLLING_FRICTION_M = mujoco.mjMINMU
"""Smallest rolling friction in m the engine can simulate; it lifts anything below to this."""


class BallContact(Contacts):
    """The contact of ball and screen of every rig of a batch.

    Friction that is constant is written once and costs nothing; one that changes with the ball's
    speed, rest or place is updated by ``feel``. The engine knows no arm between 0 and 0.01 mm:
    a rig without any resistance rolls freely, the others have at least that much. Where a contact
    bends before it resists in full, the ball rolls freely in the engine and a force resists it.

    Args:
        batch: The rigs.
        friction: Their rolling resistance.
        gravity: Its amount in m/s^2.

    Raises:
        ModelError: If a rolling resistance is too small for the engine.
    """

    friction: Friction

    def __init__(self, batch: Batch, friction: Friction, gravity: float) -> None:
        super().__init__(friction, batch.nsim)
        model = batch.model
        roll = np.broadcast_to(np.asarray(friction.rolling, float), (batch.nsim,))
        free = np.broadcast_to(friction.absent, (batch.nsim,))
        if not np.all((roll == 0) | (roll >= MIN_ROLLING_FRICTION_M)):
            raise ModelError(
                f"rolling friction must be 0 or at least {MIN_ROLLING_FRICTION_M} m, "
                f"got {roll.min()}"
            )
        pair = model.pair("ball_plate").id
        self._arm = batch.expand("pair_friction")[:, pair, 3:5]
        self._arm[:] = np.maximum(roll, MIN_ROLLING_FRICTION_M)[:, None]
        rolls = free | (np.asarray(friction.presliding) > 0)
        batch.expand("pair_dim")[:, pair] = np.where(rolls, free_dimension(model), 6)
        self.varying = not friction.constant and not (free.all() and friction.map is None)
        """Whether ``feel`` has to be called."""
        self._sloping = friction.map is not None and friction.map.sloping
        ball = model.body("ball").id
        self._force = batch.bind("xfrc_applied")[:, ball, :3]
        self._forced = self._sloping or friction.bending
        if self._forced:
            mass = batch.expanded("body_mass")
            masses = model.body_mass if mass is None else mass
            self._weight = masses[..., ball] * gravity
            sizes = batch.expanded("geom_size")
            sizes = model.geom_size if sizes is None else sizes
            self._radius = sizes[..., model.geom("ball").id, 0]

    def go_on(self, before: Contacts, x: Array) -> None:
        """Begin where the contact ``before`` of the same balls ends, in the state x, (N, 8)."""
        super().go_on(before, x)
        self._force[:] = 0.0

    def feel(self, x: Array, time: float) -> None:
        """Set friction and slope for the state x, shape (N, 8), which will last a time in s."""
        friction = self.friction
        position, speed = x[:, 0::4], np.hypot(x[:, 1], x[:, 5])
        if self.age is not None:
            self.age = friction.aged(self.age, speed, time)
        arm = friction.arm(speed, position, self.age)
        self._arm[:] = np.maximum(arm, MIN_ROLLING_FRICTION_M)[:, None]
        if not self._forced:
            return
        phi, theta = x[:, 2], x[:, 6]
        normal = (self._weight * np.cos(phi) * np.cos(theta))[:, None]
        along = np.zeros((len(x), 3))
        if self._sloping:
            assert friction.map is not None
            along[:, :2] = -normal * friction.map(position)[1]
        if friction.bending:
            self.bend = friction.bent(self.bend, x[:, 1::4], time)
            along[:, :2] -= normal * (arm / self._radius)[:, None] * friction.share(self.bend)
        self._force[:] = from_plate(along, phi, theta)


def free_dimension(model: mujoco.MjModel) -> int:
    """Dimension of the contact of a ball that rolls freely: 4 resists spin, 3 only slides."""
    return 4 if model.pair_friction[model.pair("ball_plate").id, 2] > MIN_ROLLING_FRICTION_M else 3


_VECTORISED_FROM_RIGS = 16
"""From this number of rigs on, numpy sees where the balls are faster than the engine's sensors."""

_UNUSED_FEATURES = int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
"""What a mechanism of few contacts never needs."""

_ISLAND_FEATURE = int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
"""Solving ball and plate apart, which they seldom are; without it rounding differs."""

_ZERO_CONSTANT = constant(0.0)

BALL_COLUMNS = (0, 1, 4, 5)
"""Columns of (x, x', y, y') in the state."""

_VELOCITY_STAGE = int(mujoco.mjtStage.mjSTAGE_VEL)


class Mechanism:
    """N simulated rigs: plate on its cardan joint, cams, wheels, spring or rods, servos and ball.

    Args:
        rigs: Number N of mechanisms.
        step: Physics step in s; None for the model's own.
        threads: Threads to step on, 0 for one a processor; one rig needs only one.
        friction: Rolling resistance of the ball; None for the model's own.
        parts: What differs from the model file, one for all or one a rig.
        rim: Walls that stop the balls; None for none. They are no contacts of the engine, which are
            soft and bounce by step and damping: a ball that has met one is given the speed of
            ``rim.Walls`` after each physics step, as it slides, spins and lifts then.
        sensing: Whether the engine's sensors see the balls; numpy does otherwise, which rounds
            differently. None for what is faster with so many rigs.

    Raises:
        ModelError: If the model cannot be used, or a number is out of range.
    """

    def __init__(
        self,
        rigs: int = 1,
        step: float | None = None,
        threads: int = 0,
        friction: Friction | None = None,
        parts: Parts | Sequence[Parts] | None = None,
        *,
        rim: Rim | None = None,
        sensing: bool | None = None,
    ) -> None:
        self.rigs = rigs
        self._sensing = rigs < _VECTORISED_FROM_RIGS if sensing is None else sensing
        one = Parts() if parts is None else parts
        disabled = _UNUSED_FEATURES | (0 if self._sensing else _ISLAND_FEATURE)
        self._models = RigModels(rigs, one, step, disabled)
        model = self._models.first
        self.step = float(model.opt.timestep)
        self.ratio: Number = motor_ratio(model)
        self.channels = tuple(channels_of(model))
        # persistent: each rig goes on from the stages `advance` has computed, instead of again
        self._batch = self._models.batch(threads, persistent=self._sensing)
        self._at = Addresses.of(model)
        self._live: Array = self._batch.bind("sensordata")
        self._sensed: Array = self._live
        self._ctrl: Array = self._batch.bind("ctrl")
        self._qpos: Array = self._batch.bind("qpos")
        self._qvel: Array = self._batch.bind("qvel")
        self._balls = BallsInPlates(rigs, self._at.poses, self._at.rates)
        self._places = np.empty((3, rigs))
        """Distances of the balls from the middle along x and y, and below the joint, m."""
        self._all = np.ones(rigs, bool)
        self._rim = rim
        self._height = self._models.heights()
        self._shape()
        self._contact = None if friction is None else self._touching(friction)
        # how often friction that changes with speed or place is updated: every 2 ms
        self._stride = max(1, round(0.002 / self.step))
        self.start(np.zeros((rigs, 4)))

    def foresee(self, parts: Sequence[Parts]) -> None:
        """Make ready for a ``change`` to other parts, one a rig, so that it takes no time.

        Raises:
            ModelError: If a number is out of range.
        """
        self._models.foresee(parts)

    def change(self, friction: Friction, parts: Sequence[Parts]) -> None:
        """Go on with other friction and parts, one a rig; nothing is levelled again.

        Raises:
            ModelError: If a number is out of range.
        """
        self._models.exchange(self._batch, parts)
        self._exchange_friction(friction)
        if self._sensing:
            self._batch.forward(None, _VELOCITY_STAGE)

    def rebuild(
        self,
        rigs: NDArray[np.integer],
        parts: Sequence[Parts],
        friction: Friction,
        rim: Rim | None = None,
    ) -> None:
        """Build some rigs anew, as others; ``begin`` must follow.

        Args:
            rigs: Their numbers, shape (k,).
            parts: What of each of them differs from the model file.
            friction: Of all rigs.
            rim: Of all rigs.

        Raises:
            ModelError: If a number is out of range.
        """
        self._models.rebuild(self._batch, rigs, parts)
        self._height[rigs] = self._models.heights(rigs)
        self._rim = rim
        self._shape()
        self._exchange_friction(friction)

    def _shape(self) -> None:
        self._half, self._surface, self._rounded = self._models.shapes()
        self._bounds = np.vstack((self._half, -self._surface))
        self._any_round = bool(self._rounded.any())
        self._walls: Walls | None = None
        if self._rim is not None and self._rim.given:
            radius = self._height - self._surface
            self._walls = Walls(self._rim, radius, self._rounded, rigs=self.rigs)

    def _exchange_friction(self, friction: Friction) -> None:
        """Let the balls roll on with other friction."""
        before, self._contact = self._contact, self._touching(friction)
        if before is not None:
            self._contact.go_on(before, self.state)

    def _touching(self, friction: Friction) -> BallContact:
        """The contacts of all balls with a friction."""
        return BallContact(self._batch, friction, self._models.gravity)

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put every plate level and at rest with its ball rolling at (x, x', y, y'), shape (N, 4).

        Positions in m, speeds in m/s, in plate axes; ``spin`` is the ball's rate about the
        vertical in rad/s.
        """
        self._put_level(None, np.broadcast_to(ball, (self.rigs, 4)), spin)
        if self._contact is not None:
            self._contact.begin(np.arange(self.rigs), self.state)

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some rigs to the start as ``start`` does, the others as they are."""
        self._batch.warning[rigs] = 0
        self._put_level(rigs, np.broadcast_to(ball, (len(rigs), 4)), spin)
        if self._contact is not None:
            self._contact.begin(rigs, self.state)

    def _put_level(self, rigs: NDArray[np.integer] | None, ball: Array, spin: Number) -> None:
        """Put rigs, all by default, level and at rest with their balls as in ``start``."""
        batch = self._batch
        batch.reset(rigs, keyframe=self._at.level, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        which = slice(None) if rigs is None else rigs
        x, vx, y, vy = ball.T
        zero, radius = np.zeros(len(ball)), self._height[which] - self._surface[which]
        self._qpos[which, self._at.ball_pose] = np.stack((x, y, self._height[which]), axis=-1)
        turn = (-vy / radius, vx / radius, zero + spin)
        self._qvel[which, self._at.ball_rate] = np.stack((vx, vy, zero, *turn), axis=-1)
        batch.forward(rigs)
        self._sensed = self._live
        self._look()

    def place(self, ball: Array) -> None:
        """Put the balls, rolling, at (x, x', y, y') on plates that stay as they are, (N, 4)."""
        ball = np.broadcast_to(ball, (self.rigs, 4)).T
        angles, rates = self._qpos.T[self._at.poses[:2]], self._qvel.T[self._at.rates[:2]]
        radius = self._height - self._surface
        centre, velocity, turning = rolling_ball(angles, rates, ball, self._height, radius)
        pose, rate = self._at.ball_pose.start, self._at.ball_rate.start
        self._qpos[:, pose : pose + 3] = centre
        # upright, so that its own axes are those of the rig
        self._qpos[:, pose + 3 : pose + 7] = 1.0, 0.0, 0.0, 0.0
        self._qvel[:, rate : rate + 3] = velocity
        self._qvel[:, rate + 3 : rate + 6] = turning
        if self._contact is not None:
            self._contact.bend = np.zeros((self.rigs, 2))
        if self._sensing:
            self._batch.forward(None, _VELOCITY_STAGE)
        self._look()

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Hold the motor speeds (rad/s, shape (N, 2), order phi, theta) for physics steps."""
        self._ctrl[:, self._at.servo] = motor_rate
        if self._contact is None or not self._contact.varying:
            self._step(steps)
            return
        while steps > 0:
            stride = min(steps, self._stride)
            self._contact.feel(self.state, stride * self.step)
            self._step(stride)
            steps -= stride

    def _step(self, steps: int) -> None:
        walls = self._walls
        if walls is None or not walls.near(self.state[:, BALL_COLUMNS].T, steps * self.step).any():
            self._roll(steps)
            return
        for _ in range(steps):
            before = self.state[:, BALL_COLUMNS].T
            self._roll(1)
            after = self.state[:, BALL_COLUMNS].T
            met = walls.met(after[0], after[2])
            if met.any():
                stopped = np.array(walls.rebound(self.step, before, after))
                self._throw(np.flatnonzero(met), (stopped - after)[:, met])

    def _throw(self, rigs: NDArray[np.integer], change: Array) -> None:
        """Add to (x, x', y, y') of some balls, (4, k); slip, spin and lift stay as they are."""
        at = self._at
        angles, rates = self._qpos[rigs].T[at.poses[:2]], self._qvel[rigs].T[at.rates[:2]]
        zero, radius = np.zeros(len(rigs)), (self._height - self._surface)[rigs]
        _, _, plate = rolling_ball(angles, rates, np.zeros((4, len(rigs))), zero, radius)
        centre, velocity, turning = rolling_ball(angles, rates, change, zero, radius)
        pose, rate = at.ball_pose.start, at.ball_rate.start
        faces = self._qpos[rigs, pose + 3 : pose + 7]
        self._qpos[rigs, pose : pose + 3] += centre
        self._qvel[rigs, rate : rate + 3] += velocity
        self._qvel[rigs, rate + 3 : rate + 6] += in_own_axes(turning - plate, faces)
        if self._sensing:
            self._batch.forward(rigs, _VELOCITY_STAGE)
        self._look()

    def _roll(self, steps: int) -> None:
        if self._sensing:
            # sensors lag one step behind unless their stage is computed again at the new state
            self._batch.step(None, steps, _VELOCITY_STAGE)
        else:
            self._batch.step(None, steps)
            self._look()
        self._sensed = self._live

    def _look(self) -> None:
        """Work out state and whereabouts of all balls from joint positions and speeds."""
        if self.rigs == 1:
            self._look_at_one()
            return
        seen, height = self._balls.look(self._qpos, self._qvel)
        self._seen, places = seen.T, self._places
        np.abs(seen[0], places[0])
        np.abs(seen[4], places[1])
        # below is as far beyond as to the side
        np.negative(height, places[2])
        within = places <= self._bounds
        self._inside = self._all if every(within) else within[0] & within[1] & within[2]
        if self._any_round:
            beyond = seen[0] ** 2 + seen[4] ** 2 > self._half[0] ** 2
            self._inside = self._inside & ~(self._rounded & beyond)

    def _look_at_one(self) -> None:
        """The same of one rig in plain numbers, several times faster."""
        phi, theta, *centre = self._qpos[0].take(self._at.poses).tolist()
        phi_rate, theta_rate, *velocity = self._qvel[0].take(self._at.rates).tolist()
        (x, vx), (y, vy), (height, _) = one_ball_in_plate(
            (phi, theta), (phi_rate, theta_rate), centre, velocity
        )
        self._seen = np.array([[x, vx, phi, phi_rate, y, vy, theta, theta_rate]])
        (half_x,), (half_y,) = self._half.tolist()
        inside = abs(x) <= half_x and abs(y) <= half_y and height >= self._surface[0]
        if self._any_round and x * x + y * y > half_x * half_x:
            inside = False
        self._inside = np.array([inside])

    def saved_state(self) -> dict[str, Any]:
        """The engine's integration state and what is read of it, arrays but for no age."""
        contact = self._contact
        state = {"rows": self._batch.state, "warning": self._batch.warning, "sensed": self._sensed}
        kept = {} if contact is None else {"age": contact.age, "bend": contact.bend}
        return {name: np.array(each) for name, each in state.items()} | kept

    def restore_state(self, state: dict[str, Any]) -> None:
        """Go on from a state that ``saved_state`` gave."""
        self._batch.state[:] = state["rows"]
        self._batch.warning[:] = state["warning"]
        if self._contact is not None:
            self._contact.age, self._contact.bend = state["age"], state["bend"]
        if self._sensing:
            self._batch.forward(None, _VELOCITY_STAGE)
        self._look()
        # forces are those of the step that led here, until the next one
        self._sensed = state["sensed"]

    @property
    def state(self) -> Array:
        """True state in the order of (5.5), shape (N, 8), at the present instant."""
        return self._sensed.take(self._at.state, axis=1) if self._sensing else self._seen

    @property
    def motor(self) -> Array:
        """Motor shaft angles in rad, shape (N, 2), in the order phi, theta."""
        return self._qpos[:, self._at.shaft].copy()

    @property
    def on_plate(self) -> Mask:
        """Whether the ball's centre is over the screen and not below its surface, shape (N,)."""
        return self._sensed[:, self._at.over] > _ZERO_CONSTANT if self._sensing else self._inside

    @property
    def warnings(self) -> NDArray[np.integer]:
        """How many warnings the engine has counted for each rig since it was built, shape (N,)."""
        # of each kind the last information, then the number
        return np.asarray(self._batch.warning[:, :, 1].sum(axis=1))

    @property
    def diverged(self) -> Mask:
        """Whether the engine has counted a warning: it sets such a rig back, shape (N,)."""
        return self.warnings > 0

    def telemetry(self) -> Array:
        """Contact forces in N, motor torques in N m, spring length in m, motor angles in rad.

        Shape (N, channels). Forces and torques are those of the last physics step.
        """
        return self._sensed.take(self._at.telemetry, axis=1)
