"""From the model file and the parts that differ to a compiled mechanism, standing level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS

from controllers.arrays import Array
from twin.errors import ModelError
from twin.paths import model_path
from twin.sim.plant.level import tilted_gravity
from twin.sim.plant.parts import Parts

NAMES = {
    "joint": ("theta", "phi", "cam_theta", "cam_phi", "ball"),
    "geom": ("plate", "ball", "wheel_phi", "wheel_theta", "cam_phi", "cam_theta"),
    "body": ("plate", "ball", "motor_phi", "motor_theta"),
    "tendon": ("spring",),
    "actuator": ("servo_phi", "servo_theta"),
    "pair": ("ball_plate", "cam_phi", "cam_theta"),
    "key": ("level",),
    "sensor": (
        "ball_position",
        "ball_velocity",
        "ball_on_plate",
        "phi",
        "phi_rate",
        "theta",
        "theta_rate",
        "motor_phi",
        "motor_theta",
        "wheel_phi_force",
        "wheel_theta_force",
        "ball_force",
        "torque_phi",
        "torque_theta",
        "spring_length",
    ),
}
"""What the plant asks of a model, by kind; the contract of the model file."""

_AXES = ("phi", "theta")


def load_model(
    path: Path | None = None,
    parts: Parts | None = None,
    *,
    drawn: bool = True,
    stands: mujoco.MjModel | None = None,
) -> mujoco.MjModel:
    """Compile a mechanism and check that it has every name the plant needs.

    Args:
        path: The MJCF file; None for the packaged one.
        parts: What differs from the file.
        drawn: Whether it is to be seen; without what only a viewer needs it moves by the same bits.
        stands: A mechanism from before parts were exchanged: it is not levelled again, its shafts
            stay at their heights. None levels one whose balance the parts change.

    Raises:
        ModelError: If the file cannot be read or compiled, or lacks names.
    """
    path = model_path() if path is None else path
    if not path.is_file():
        raise ModelError(f"model {path}: no such file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = not drawn
        model = spec.compile()
        _check(model, path)
        if parts is not None and parts != Parts():
            model = _build(spec, model, parts, stands)
    except ValueError as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"model {path}: {' '.join(str(error).split())}") from error
    return model


def _check(model: mujoco.MjModel, path: Path) -> None:
    missing = [
        f"{kind} {name}"
        for kind, names in NAMES.items()
        for name in names
        if mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name) < 0
    ]
    if missing:
        raise ModelError(f"model {path}: missing {', '.join(missing)}")


def cam_ratio(model: mujoco.MjModel) -> float:
    """Motor angle per plate angle about level, dimensionless."""
    lever = np.abs(model.geom("wheel_phi").pos[0])
    return float(lever / np.hypot(*model.geom("cam_phi").pos[[0, 2]]))


def differing(models: Sequence[mujoco.MjModel]) -> dict[str, Array]:
    """The model fields in which compiled mechanisms differ, one value per mechanism, (N, ...).

    Raises:
        ModelError: If they differ in more than numbers, so that they cannot run side by side.
    """
    found: dict[str, Array] = {}
    if all(model is models[0] for model in models):
        return found
    for name in MODEL_FIELDS:
        values = [value_of(model, name) for model in models]
        if any(value.shape != values[0].shape for value in values):
            raise ModelError(
                "plant.ball.offset_mm: rigs side by side must all have a ball out of balance or "
                "none"
            )
        if any(not np.array_equal(value, values[0]) for value in values):
            found[name] = np.stack(values)
    return found


def value_of(model: mujoco.MjModel, name: str) -> Array:
    """A model field as ``differing`` names it."""
    owner, _, field = name.rpartition(".")
    return np.asarray(getattr(model.opt if owner else model, field))


def _build(
    spec: mujoco.MjSpec, before: mujoco.MjModel, parts: Parts, stands: mujoco.MjModel | None
) -> mujoco.MjModel:
    """The mechanism with other parts than before, standing level, or as it stands."""
    higher = _shape(spec, parts)
    model = spec.compile()
    model.key_qpos[:, model.joint("ball").qposadr[0] + 2] += higher
    _couple(model, before, parts)
    slide, spin = parts.sliding, parts.spinning
    friction = model.pair("ball_plate").friction
    if slide is not None:
        friction[:2] = slide
    if spin is not None:
        friction[2] = spin
    if parts.preload is not None:
        spring = model.tendon("spring").id
        length = _at_level(model).ten_length[spring]
        model.tendon_lengthspring[spring] = length - parts.preload / model.tendon_stiffness[spring]
    if parts.torque is not None:
        model.actuator_forcerange[:] = -parts.torque, parts.torque
    if parts.speed is not None:
        model.actuator_ctrlrange[:] = -parts.speed, parts.speed
    if parts.level is not None:
        model.opt.gravity = tilted_gravity(parts.level, -model.opt.gravity[2])
    if stands is not None:
        model.body_pos[:] = stands.body_pos
        model.key_qpos[:], model.key_act[:] = stands.key_qpos, stands.key_act
    elif not parts.balanced:
        _stand_level(model)
    if parts.joint_friction is not None:
        # last: it would keep the plate from coming to rest level
        for axis in _AXES:
            model.dof_frictionloss[model.joint(axis).dofadr[0]] = parts.joint_friction
    return model


def _shape(spec: mujoco.MjSpec, parts: Parts) -> float:
    """Change ball and plate; return by how much higher the ball's middle lies, m."""
    ball, geom = spec.body("ball"), spec.geom("ball")
    if parts.mass is not None:
        ball.mass = parts.mass
    if parts.inertia is not None:
        ball.inertia = [parts.inertia] * 3
    if parts.offset is not None:
        ball.ipos = parts.offset
        for name in ("ball_position", "ball_velocity"):
            # the screen feels the ball's middle, not its centre of mass
            spec.sensor(name).objtype = mujoco.mjtObj.mjOBJ_XBODY
    if parts.plate_centre is not None:
        plate = spec.body("plate")
        plate.ipos = [*parts.plate_centre, plate.ipos[2]]
    nominal = geom.size[0]
    radius = parts.radius or nominal
    upright = radius - (parts.oval or 0.0) / 2
    if upright <= 0:
        raise ModelError(f"mechanism: oval cannot be {parts.oval} at a radius of {radius}")
    geom.size = [radius, radius, upright]
    if upright < radius:
        geom.type = mujoco.mjtGeom.mjGEOM_ELLIPSOID
        # An ellipsoid's contact is searched for; at the usual tolerance the ball rocks untrue.
        spec.option.ccd_tolerance = 1e-12
        spec.option.ccd_iterations = 200
    return float(upright - nominal)


def _couple(model: mujoco.MjModel, before: mujoco.MjModel, parts: Parts) -> None:
    """Give the wheels' contact its stiffness and damping, whatever the masses are now.

    The engine divides both by its estimate of the inverse masses (``models/ballplate.xml``).
    """
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, _at_level(model), inertia)
    for axis in _AXES:
        pair = model.pair(f"cam_{axis}")
        stiffness, damping = -pair.solref / _scale(before, axis)
        if parts.stiffness is not None:
            damping *= math.sqrt(parts.stiffness / stiffness)
            stiffness = parts.stiffness
        if parts.damping_ratio is not None:
            own = inertia[(model.joint(axis).dofadr[0],) * 2]
            lever = np.abs(model.geom(f"wheel_{axis}").pos[:2]).max()
            damping = 2 * parts.damping_ratio * math.sqrt(stiffness * own) / lever
        pair.solref[:] = np.multiply((-stiffness, -damping), _scale(model, axis))


def _scale(model: mujoco.MjModel, axis: str) -> float:
    masses = model.body("plate").invweight0[0] + model.body(f"motor_{axis}").invweight0[0]
    return float(masses * (1 - model.pair(f"cam_{axis}").solimp[0]))


def _at_level(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    mujoco.mj_forward(model, data)
    return data


def _stand_level(model: mujoco.MjModel, time: float = 0.1, rounds: int = 4) -> None:
    """Set the shafts' heights and the servos' set points so that all angles are 0 at rest.

    Raises:
        ModelError: If the mechanism does not come to rest level.
    """
    key = model.key("level")
    damping = model.dof_damping.copy()
    joints = [model.joint(axis) for axis in _AXES]
    shafts = [model.joint(f"cam_{axis}") for axis in _AXES]
    ball = model.joint("ball")
    place, speed = ball.qposadr[0], ball.dofadr[0]
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    for joint in joints:
        model.dof_damping[joint.dofadr[0]] = 20.0  # near critical: rests within a few periods
    for _ in range(rounds):
        data = _at_level(model)
        middle, turn = data.qpos[place : place + 2], data.qpos[place + 3 : place + 7]
        slide, spin = data.qvel[speed : speed + 2], data.qvel[speed + 3 : speed + 6]
        for _ in range(round(time / model.opt.timestep)):
            mujoco.mj_step(model, data)
            middle[:] = slide[:] = spin[:] = 0.0
            turn[:] = upright
        angles = data.qpos[[joint.qposadr[0] for joint in joints]]
        key.qpos[:] = data.qpos
        key.act[:] = data.act
        for axis, joint, shaft, angle in zip(_AXES, joints, shafts, angles, strict=True):
            lever = np.abs(model.geom(f"wheel_{axis}").pos[:2]).max()
            model.body(f"motor_{axis}").pos[2] -= lever * angle
            servo = model.actuator(f"servo_{axis}")
            key.act[servo.actadr[0]] -= data.qpos[shaft.qposadr[0]]
            key.qpos[[joint.qposadr[0], shaft.qposadr[0]]] = 0.0
    model.dof_damping[:] = damping
    if not np.abs(angles).max() < 1e-5:
        raise ModelError("mechanism: these parts do not come to rest level")
