"""A mechanism with other parts than the model file's, standing level."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from twin.errors import ModelError
from twin.sim.plant.level import tilted_gravity
from twin.sim.plant.parts import Parts
from twin.sim.plant.standing import AXES, balance, put_level, settle

FITTED = (
    "actuator_ctrlrange",
    "actuator_forcerange",
    "body_pos",
    "dof_frictionloss",
    "geom_size",
    "key_act",
    "key_qpos",
    "opt.gravity",
    "pair_friction",
    "pair_solref",
    "tendon_lengthspring",
)
"""The model fields that ``fitted`` changes, and sizes that a sphere has but does not use: all in
which mechanisms of the same ball and plate differ."""


def fitted(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    before: mujoco.MjModel,
    parts: Parts,
    stands: mujoco.MjModel | None = None,
) -> mujoco.MjModel:
    """Fit parts to a mechanism and let it stand level.

    Args:
        model: Has the parts' ball and plate; is changed and returned.
        data: For models like it; what it holds does not matter.
        before: The mechanism of the model file.
        parts: What differs of it.
        stands: A mechanism at whose heights the shafts stay; None levels one whose balance the
            parts change.

    Raises:
        ModelError: If the mechanism does not come to rest level.
    """
    _couple(model, data, before, parts)
    slide, spin = parts.sliding, parts.spinning
    friction = model.pair("ball_plate").friction
    if slide is not None:
        friction[:2] = slide
    if spin is not None:
        friction[2] = spin
    if parts.preload is not None:
        spring = model.tendon("spring").id
        put_level(model, data)
        length = data.ten_length[spring]
        model.tendon_lengthspring[spring] = length - parts.preload / model.tendon_stiffness[spring]
    if parts.torque is not None:
        model.actuator_forcerange[:] = -parts.torque, parts.torque
    if parts.speed is not None:
        model.actuator_ctrlrange[:] = -parts.speed, parts.speed
    if stands is not None:
        model.body_pos[:] = stands.body_pos
        model.key_qpos[:], model.key_act[:] = stands.key_qpos, stands.key_act
    elif not parts.balanced:
        settle(model, data)
    if parts.level is not None:
        model.opt.gravity = tilted_gravity(parts.level, -model.opt.gravity[2])
        if stands is None:
            balance(model, data)
    if parts.joint_friction is not None:
        # last: it would keep the plate from coming to rest level
        for axis in AXES:
            model.dof_frictionloss[model.joint(axis).dofadr[0]] = parts.joint_friction
    return model


def shaped(spec: mujoco.MjSpec, parts: Parts) -> mujoco.MjModel:
    """Compile a mechanism with another ball and plate.

    Args:
        spec: That of the model file; it stays as it is.
        parts: What differs; of them ball and plate.

    Raises:
        ModelError: If the ball is too oval.
        ValueError: If it cannot be compiled.
    """
    spec = spec.copy()
    higher = _shape(spec, parts)
    model = spec.compile()
    model.key_qpos[:, model.joint("ball").qposadr[0] + 2] += higher
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


def _couple(
    model: mujoco.MjModel, data: mujoco.MjData, before: mujoco.MjModel, parts: Parts
) -> None:
    """Give the wheels' contact its stiffness and damping, whatever the masses are now.

    The engine divides both by its estimate of the inverse masses (``models/ballplate.xml``).
    """
    inertia = np.zeros((model.nv, model.nv))
    put_level(model, data)
    mujoco.mj_fullM(model, data, inertia)
    for axis in AXES:
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
