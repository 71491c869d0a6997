"""The MuJoCo plant: N mechanisms of ``models/ballplate.xml`` stepped as one batch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask, Number, constant
from twin.sim.plant.addresses import TELEMETRY, Addresses
from twin.sim.plant.ball_contact import BallContact
from twin.sim.plant.friction import Friction
from twin.sim.plant.kinematics import ball_in_plate
from twin.sim.plant.model import cam_ratio
from twin.sim.plant.parts import Parts
from twin.sim.plant.placing import BallPlacing
from twin.sim.plant.rig_models import RigModels

_MANY = 16
"""From this number of rigs on, numpy sees where the balls are faster than the engine's sensors."""

_UNUSED = int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
"""What a mechanism of few contacts never needs."""

_ISLANDS = int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
"""Solving ball and plate apart, which they seldom are; without it rounding differs."""

_NOTHING = constant(0.0)

_VELOCITY_STAGE = int(mujoco.mjtStage.mjSTAGE_VEL)


class Mechanism:
    """N simulated rigs: plate on its cardan joint, cams, wheels, spring, servos and ball.

    Args:
        path: The MJCF file; None for the packaged model.
        rigs: Number N of mechanisms.
        step: Physics step in s; None for the model's own.
        threads: Threads to step on, 0 for one a processor; one rig needs only one.
        friction: Rolling resistance of the ball; None for the model's own.
        parts: What differs from the model file, one for all or one a rig.

    Raises:
        ModelError: If the model cannot be used, or a number is out of range.
    """

    channels = tuple(TELEMETRY)

    def __init__(
        self,
        path: Path | None = None,
        rigs: int = 1,
        step: float | None = None,
        threads: int = 0,
        friction: Friction | None = None,
        parts: Parts | Sequence[Parts] | None = None,
    ) -> None:
        self.rigs = rigs
        self._sensing = rigs < _MANY
        one = Parts() if parts is None else parts
        disabled = _UNUSED | (0 if self._sensing else _ISLANDS)
        self._models = RigModels(path, rigs, one, step, disabled)
        model = self._models.first
        self.step = float(model.opt.timestep)
        self.ratio = cam_ratio(model)
        # persistent: each rig goes on from the stages `advance` has computed, instead of again
        self._batch = self._models.batch(threads, persistent=self._sensing)
        self._at = Addresses.of(model)
        self._live: Array = self._batch.bind("sensordata")
        self._sensed: Array = self._live
        self._ctrl: Array = self._batch.bind("ctrl")
        self._qpos: Array = self._batch.bind("qpos")
        self._qvel: Array = self._batch.bind("qvel")
        screen = model.geom("plate")
        self._surface = float(screen.pos[2] + screen.size[2])
        self._half = screen.size[:2, None]
        self._placing = BallPlacing(self._batch, self._at, self._surface, self._models.heights())
        self._contact = None if friction is None else BallContact(self._batch, friction)
        # how often friction that changes with speed or place is updated: every 2 ms
        self._stride = max(1, round(0.002 / self.step))
        self._varying = self._contact is not None and self._contact.varying
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
        self, rigs: NDArray[np.integer], parts: Sequence[Parts], friction: Friction
    ) -> None:
        """Build some rigs anew, as others; ``begin`` must follow.

        Args:
            rigs: Their numbers, shape (k,).
            parts: What of each of them differs from the model file.
            friction: Of all rigs.

        Raises:
            ModelError: If a number is out of range.
        """
        self._models.rebuild(self._batch, rigs, parts)
        self._placing.change(rigs, self._models.heights(rigs))
        self._exchange_friction(friction)

    def _exchange_friction(self, friction: Friction) -> None:
        """Let the balls roll on with other friction."""
        before, self._contact = self._contact, BallContact(self._batch, friction)
        if before is not None:
            self._contact.go_on(before, self.state)
        self._varying = self._contact.varying

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put every plate level and at rest with its ball rolling at (x, x', y, y'), shape (N, 4).

        Positions in m, speeds in m/s, in plate axes; ``spin`` is the ball's rate about the
        vertical in rad/s.
        """
        batch = self._batch
        batch.reset(keyframe=self._at.level, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._placing.level(slice(None), np.broadcast_to(ball, (self.rigs, 4)), spin)
        batch.forward()
        self._sensed = self._live
        self._look()
        if self._contact is not None:
            self._contact.start(self.state)

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some rigs to the start as ``start`` does, the others as they are."""
        batch = self._batch
        batch.reset(rigs, keyframe=self._at.level, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._placing.level(rigs, np.broadcast_to(ball, (len(rigs), 4)), spin)
        batch.warning[rigs] = 0
        batch.forward(rigs)
        self._sensed = self._live
        self._look()
        if self._contact is not None:
            self._contact.begin(rigs, self.state)

    def place(self, ball: Array) -> None:
        """Put the balls, rolling, at (x, x', y, y') on plates that stay as they are, (N, 4)."""
        self._placing.tilted(np.broadcast_to(ball, (self.rigs, 4)))
        if self._sensing:
            self._batch.forward(None, _VELOCITY_STAGE)
        self._look()

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Hold the motor speeds (rad/s, shape (N, 2), order phi, theta) for physics steps."""
        self._ctrl[:, self._at.servo] = motor_rate
        if not self._varying:
            self._step(steps)
            return
        assert self._contact is not None
        while steps > 0:
            stride = min(steps, self._stride)
            self._contact.feel(self.state, stride * self.step)
            self._step(stride)
            steps -= stride

    def _step(self, steps: int) -> None:
        if self._sensing:
            # sensors lag one step behind unless their stage is computed again at the new state
            self._batch.step(None, steps, _VELOCITY_STAGE)
        else:
            self._batch.step(None, steps)
            self._look()
        self._sensed = self._live

    def _look(self) -> None:
        """Work out state and whereabouts of all balls from joint positions and speeds."""
        pose, rate = self._qpos.T[self._at.poses], self._qvel.T[self._at.rates]
        seen = ball_in_plate(pose[:2], rate[:2], pose[2:], rate[2:])
        self._seen = np.empty((8, self.rigs)).T
        self._seen.T[:] = seen[0], seen[3], pose[0], rate[0], seen[1], seen[4], pose[1], rate[1]
        inside = np.abs(seen[:2]) <= self._half
        self._inside = inside[0] & inside[1] & (seen[2] >= self._surface)

    def saved_state(self) -> dict[str, Any]:
        """The engine's integration state and what is read of it, all arrays."""
        contact = self._contact
        age = {} if contact is None else {"age": contact.age, "bend": contact.bend}
        state = {"rows": self._batch.state, "warning": self._batch.warning, "sensed": self._sensed}
        return {name: np.array(each) for name, each in (state | age).items()}

    def restore_state(self, state: dict[str, Any]) -> None:
        """Go on from a state that ``saved_state`` gave."""
        self._batch.state[:] = state["rows"]
        self._batch.warning[:] = state["warning"]
        if self._contact is not None:
            self._contact.age = state["age"]
            # of a snapshot from before contacts could bend there is nothing
            self._contact.bend = state.get("bend", np.zeros((self.rigs, 2)))
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
        return self._sensed[:, self._at.over] > _NOTHING if self._sensing else self._inside

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
        return self._sensed.take(self._at.told, axis=1)
