"""The MuJoCo plant: N mechanisms of ``models/ballplate.xml`` stepped as one batch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike, NDArray

from twin.errors import ModelError
from twin.models import model_path
from twin.plant.interface import Array, Mask
from twin.plant.kinematics import ball_in_plate

_NAMES = {
    "joint": ("theta", "phi", "cam_theta", "cam_phi", "ball"),
    "geom": ("plate", "ball", "wheel_phi", "wheel_theta", "cam_phi", "cam_theta"),
    "body": ("plate", "ball"),
    "tendon": ("spring",),
    "actuator": ("servo_phi", "servo_theta"),
    "pair": ("ball_plate",),
    "key": ("level",),
    "sensor": (
        "ball_position",
        "ball_velocity",
        "ball_on_plate",
        "phi",
        "phi_rate",
        "theta",
        "theta_rate",
        "wheel_phi_force",
        "wheel_theta_force",
        "ball_force",
        "torque_phi",
        "torque_theta",
        "spring_length",
    ),
}
"""What this plant asks of a model, by kind; the contract of the model file."""

_TELEMETRY = {
    "wheel_phi_N": "wheel_phi_force",
    "wheel_theta_N": "wheel_theta_force",
    "ball_N": "ball_force",
    "torque_phi_Nm": "torque_phi",
    "torque_theta_Nm": "torque_theta",
    "spring_m": "spring_length",
}
"""Name in the record, and the sensor whose first number it is."""

_LEAST_ROLLING = mujoco.mjMINMU
"""Smallest rolling friction in m the engine can simulate; it lifts anything below to this."""

_MANY = 16
"""From this number of rigs on, numpy sees where the balls are faster than the engine's sensors."""

_VELOCITY_STAGE = int(mujoco.mjtStage.mjSTAGE_VEL)


def load_model(path: Path | None = None) -> mujoco.MjModel:
    """Compile a mechanism and check that it has every name the plant needs.

    Args:
        path: The MJCF file; None for the packaged one.

    Raises:
        ModelError: If the file cannot be read or compiled, or lacks names.
    """
    path = model_path() if path is None else path
    if not path.is_file():
        raise ModelError(f"model {path}: no such file")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ModelError(f"model {path}: {' '.join(str(error).split())}") from error
    missing = [
        f"{kind} {name}"
        for kind, names in _NAMES.items()
        for name in names
        if mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name) < 0
    ]
    if missing:
        raise ModelError(f"model {path}: missing {', '.join(missing)}")
    return model


class Mechanism:
    """N simulated rigs: plate on its cardan joint, cams, wheels, spring, servos and ball.

    Args:
        path: The MJCF file; None for the packaged model.
        rigs: Number N of mechanisms.
        step: Physics step in s; None for the model's own.
        threads: Threads to step on, 0 for one a processor; one rig needs only one.
        rolling: Rolling friction of the ball in m, one for all or shape (N,); 0 is frictionless
            rolling, None the model's own.

    Raises:
        ModelError: If the model cannot be used, or a number is out of range.
    """

    channels = tuple(_TELEMETRY)

    def __init__(
        self,
        path: Path | None = None,
        rigs: int = 1,
        step: float | None = None,
        threads: int = 0,
        rolling: ArrayLike | None = None,
    ) -> None:
        model = load_model(path)
        if rigs < 1:
            raise ModelError(f"rigs must be 1 or more, got {rigs}")
        if step is not None:
            if not 0 < step <= 0.002:
                raise ModelError(f"physics step must be in (0, 0.002] s, got {step}")
            model.opt.timestep = step
        self.rigs = rigs
        self.step = float(model.opt.timestep)
        lever = np.abs(model.geom("wheel_phi").pos[0])
        self.ratio = float(lever / np.hypot(*model.geom("cam_phi").pos[[0, 2]]))
        self._sensing = rigs < _MANY
        # persistent: each rig goes on from the stages `advance` has computed, instead of again
        self._batch = Batch(model, rigs, threads if rigs > 1 else 1, persistent=self._sensing)
        if rolling is not None:
            self._roll(rolling)
        self._resolve(model)
        self.start(np.zeros((rigs, 4)))

    def _resolve(self, model: mujoco.MjModel) -> None:
        """Find, once, where everything of interest stands in the batch's arrays."""
        ball = model.joint("ball")
        self._level = model.key("level").id
        self._height = float(model.key("level").qpos[ball.qposadr[0] + 2])
        self._ball_pose = slice(ball.qposadr[0], ball.qposadr[0] + 3)
        self._ball_rate = slice(ball.dofadr[0], ball.dofadr[0] + 6)
        plate = [model.joint(axis) for axis in ("phi", "theta")]
        at_pose, at_rate = ball.qposadr[0], ball.dofadr[0]
        self._poses = np.array(
            [*(joint.qposadr[0] for joint in plate), *range(at_pose, at_pose + 3)]
        )
        self._rates = np.array(
            [*(joint.dofadr[0] for joint in plate), *range(at_rate, at_rate + 3)]
        )
        screen = model.geom("plate")
        self._surface = float(screen.pos[2] + screen.size[2])
        self._half = screen.size[:2, None]
        self._radius = self._height - self._surface
        at = {name: int(model.sensor(name).adr[0]) for name in _NAMES["sensor"]}
        position, velocity = at["ball_position"], at["ball_velocity"]
        self._over = at["ball_on_plate"]
        self._state = np.array(
            [
                position,
                velocity,
                at["phi"],
                at["phi_rate"],
                position + 1,
                velocity + 1,
                at["theta"],
                at["theta_rate"],
            ]
        )
        self._told = np.array([at[sensor] for sensor in _TELEMETRY.values()])
        self._servo = _columns([model.actuator(f"servo_{axis}").id for axis in ("phi", "theta")])
        self._shaft = _columns([model.joint(f"cam_{axis}").qposadr[0] for axis in ("phi", "theta")])
        self._sensed: Array = self._batch.bind("sensordata")
        self._ctrl: Array = self._batch.bind("ctrl")
        self._qpos: Array = self._batch.bind("qpos")
        self._qvel: Array = self._batch.bind("qvel")

    def _roll(self, friction: ArrayLike) -> None:
        """Give each rig its rolling friction; 0 leaves rolling out of the contact."""
        roll = np.broadcast_to(np.asarray(friction, dtype=float), (self.rigs,))
        free = roll == 0
        if not np.all(free | (np.isfinite(roll) & (roll >= _LEAST_ROLLING))):
            raise ModelError(
                f"rolling friction must be 0 or at least {_LEAST_ROLLING} m, got {friction!r}"
            )
        pair = self._batch.model.pair("ball_plate").id
        self._batch.expand("pair_friction")[:, pair, 3:5] = roll[:, None]
        self._batch.expand("pair_dim")[:, pair] = np.where(free, 3, 6)

    def start(self, ball: Array) -> None:
        """Put every plate level and at rest with its ball rolling at (x, x', y, y'), shape (N, 4).

        Positions in m, speeds in m/s, in plate axes.
        """
        batch = self._batch
        batch.reset(keyframe=self._level, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        x, vx, y, vy = np.broadcast_to(ball, (self.rigs, 4)).T
        zero = np.zeros(self.rigs)
        self._qpos[:, self._ball_pose] = np.stack((x, y, zero + self._height), axis=-1)
        spin = (-vy / self._radius, vx / self._radius, zero)
        self._qvel[:, self._ball_rate] = np.stack((vx, vy, zero, *spin), axis=-1)
        batch.forward()
        self._look()

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Hold the motor speeds (rad/s, shape (N, 2), order phi, theta) for physics steps."""
        self._ctrl[:, self._servo] = motor_rate
        if self._sensing:
            # sensors lag one step behind unless their stage is computed again at the new state
            self._batch.step(None, steps, _VELOCITY_STAGE)
        else:
            self._batch.step(None, steps)
            self._look()

    def _look(self) -> None:
        """Work out state and whereabouts of all balls from joint positions and speeds."""
        pose, rate = self._qpos.T[self._poses], self._qvel.T[self._rates]
        seen = ball_in_plate(pose[:2], rate[:2], pose[2:], rate[2:])
        rows = (seen[0], seen[3], pose[0], rate[0], seen[1], seen[4], pose[1], rate[1])
        self._seen = np.stack(rows, axis=1)
        inside = np.abs(seen[:2]) <= self._half
        self._inside = inside[0] & inside[1] & (seen[2] >= self._surface)

    @property
    def state(self) -> Array:
        """True state in the order of (5.5), shape (N, 8), at the present instant."""
        return self._sensed.take(self._state, axis=1) if self._sensing else self._seen

    @property
    def motor(self) -> Array:
        """Motor shaft angles in rad, shape (N, 2), in the order phi, theta."""
        return self._qpos[:, self._shaft].copy()

    @property
    def on_plate(self) -> Mask:
        """Whether the ball's centre is over the screen and not below its surface, shape (N,)."""
        return self._sensed[:, self._over] > 0 if self._sensing else self._inside

    @property
    def warnings(self) -> NDArray[np.integer]:
        """How many warnings the engine has counted for each rig since it was built, shape (N,)."""
        return np.asarray(self._batch.warning.sum(axis=1))

    def telemetry(self) -> Array:
        """Wheel and ball contact forces in N, motor torques in N m, spring length in m.

        Shape (N, channels). Forces and torques are those of the last physics step.
        """
        return self._sensed.take(self._told, axis=1)


def _columns(ids: Sequence[int]) -> slice | list[int]:
    """Two columns as a slice where their order allows it: slices are cheap to read and write."""
    first, second = (int(i) for i in ids)
    if second > first:
        return slice(first, second + 1, second - first)
    return [first, second]
