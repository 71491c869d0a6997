"""Other parts fitted to a mechanism: ball, plate, linkage and contact; then it rests level."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from controllers.arrays import Array
from twin.base.errors import ModelError
from twin.hal.interface import AXIS_NAMES
from twin.hal.linkage import Linkage
from twin.sim.plant.interface import Parts, tilted_gravity

_SENSOR_FEATURE = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
"""Sensors are disabled while the static equilibrium is computed."""

_NEVER_LEVEL = "mechanism: these parts do not come to rest level"

_BALANCE_STEP = 1e-6
"""Steps of the unknowns of the balance for its derivatives, m and rad."""
_BALANCE_TOLERANCE = 1e-10
"""Newton steps of the balance smaller than this are the last, m and rad."""


def put_level(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Put a mechanism to its keyframe, everything worked out."""
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    mujoco.mj_forward(model, data)


def balance(model: mujoco.MjModel, data: mujoco.MjData, rounds: int = 8) -> None:
    """Set the shafts' heights and the servos' set points so that all angles are 0 at rest.

    Level and at rest, the accelerations of plate, motors and height of the ball are 0. Newton's
    method solves that for the shafts' heights, the set points and the height of the ball. The ball
    does not roll off; its height is not waited for, as it moves nothing else and comes slowly
    where the ball slides.

    Raises:
        ModelError: If there is no such balance.
    """
    key = model.key("level")
    hinges = [model.joint(name) for axis in AXIS_NAMES for name in (axis, f"cam_{axis}")]
    ball = model.joint("ball")
    height = ball.qposadr[0] + 2
    moving = [*(hinge.dofadr[0] for hinge in hinges), ball.dofadr[0] + 2]
    shafts = [model.body(f"motor_{axis}").id for axis in AXIS_NAMES]
    servos = [model.actuator(f"servo_{axis}").actadr[0] for axis in AXIS_NAMES]

    def acceleration(x: Array) -> Array:
        model.body_pos[shafts, 2], data.act[servos], data.qpos[height] = x[:2], x[2:4], x[4]
        mujoco.mj_forward(model, data)
        return np.array(data.qacc[moving])

    flags = model.opt.disableflags
    model.opt.disableflags |= _SENSOR_FEATURE
    key.qpos[[hinge.qposadr[0] for hinge in hinges]] = 0.0
    put_level(model, data)
    x = np.array([*model.body_pos[shafts, 2], *data.act[servos], data.qpos[height]])
    for _ in range(rounds):
        now = acceleration(x)
        slopes = [
            (acceleration(x + nudge) - now) / _BALANCE_STEP
            for nudge in _BALANCE_STEP * np.eye(len(x))
        ]
        try:
            step = np.linalg.solve(np.transpose(slopes), now)
        except np.linalg.LinAlgError:  # more does not help a motor that gives all it can
            raise ModelError(_NEVER_LEVEL) from None
        x = x - step
        if np.abs(step[:4]).max() < _BALANCE_TOLERANCE:
            break
    else:
        raise ModelError(_NEVER_LEVEL)
    model.body_pos[shafts, 2], key.act[servos], key.qpos[height] = x[:2], x[2:4], x[4]
    model.opt.disableflags = flags


def on_rods(model: mujoco.MjModel) -> bool:
    """Whether a mechanism has cranks and rods in place of cams, wheels and spring."""
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, "rod_phi") >= 0)


FITTED_FIELDS = (
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
"""The model fields that ``fit_parts`` changes, and sizes that a sphere has but does not use: all in
which mechanisms of the same ball and plate differ."""


def fit_parts(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    before: mujoco.MjModel,
    parts: Parts,
    stands: mujoco.MjModel | None = None,
) -> mujoco.MjModel:
    """Fit parts to a mechanism and let it stand level.

    Args:
        model: Has the parts' ball and plate; is changed and returned.
        data: For models like it; its content does not matter.
        before: The mechanism of the model file.
        parts: What differs of it.
        stands: The shafts stay at the heights of this mechanism; None levels it if the parts
            change its balance.

    Raises:
        ModelError: If the mechanism does not come to rest level.
    """
    if not on_rods(model):
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
    if parts.level is not None:
        model.opt.gravity = tilted_gravity(parts.level, -model.opt.gravity[2])
    if stands is None and not (parts.balanced and parts.level is None):
        balance(model, data)
    if parts.joint_friction is not None:
        # last: it would keep the plate from coming to rest level
        for axis in AXIS_NAMES:
            model.dof_frictionloss[model.joint(axis).dofadr[0]] = parts.joint_friction
    return model


def compile_with(spec: mujoco.MjSpec, parts: Parts) -> mujoco.MjModel:
    """Compile a mechanism with its ball and plate exchanged.

    Args:
        spec: Specification in the model file; it stays as it is.
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
    if parts.linkage is not None:
        _link(spec, parts.linkage)
    higher = 0.0 if parts.height is None else _raise(spec, parts.height)
    if parts.size is not None:
        _cut(spec, parts.size, parts.rounded)
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
    return float(upright - nominal) + higher


def _raise(spec: mujoco.MjSpec, height: float) -> float:
    """Move the surface and what is drawn on it to a height over the axes; by how much, m."""
    plate = spec.geom("plate")  # still the file's box
    higher = float(height - plate.pos[2] - plate.size[2])
    drawn = "screen_back", "centre_mark", "area_front", "area_rear", "area_left", "area_right"
    for each in (plate, spec.site("over_plate"), *map(spec.geom, drawn)):
        if each is not None:
            each.pos[2] += higher
    return higher


def _cut(spec: mujoco.MjSpec, size: tuple[float, float], rounded: bool) -> None:
    """Change the plate's sides or shape; mass and second moments go with them, as of a slab.

    Of a slab the second moments along its sides are m a^2 / 12, of a disc m d^2 / 16.
    """
    plate, body = spec.geom("plate"), spec.body("plate")
    sides = np.divide(size, 2 * plate.size[:2])
    more = sides.prod() * (math.pi / 4 if rounded else 1)
    plate.mass *= more
    if body.explicitinertial:
        moments = body.inertia.sum() / 2 - body.inertia
        moments *= more * np.append(sides**2 * (0.75 if rounded else 1), 1)
        body.mass *= more
        body.inertia = moments.sum() - moments
    for each in (plate, spec.site("over_plate"), spec.geom("screen_back")):
        if each is None:  # what only a viewer needs may be left out
            continue
        each.size[:2] *= sides
        if rounded:
            each.type = mujoco.mjtGeom.mjGEOM_CYLINDER
            each.size = [each.size[0], each.size[2], 0]


def _link(spec: mujoco.MjSpec, linkage: Linkage) -> None:
    """Change cranks, rods and arms."""
    depth, ways = linkage.depth, ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    for i, (axis, way) in enumerate(zip(AXIS_NAMES, ways, strict=True)):
        crank, arm = np.multiply(linkage.crank[i], way), np.multiply(linkage.arm[i], way)
        spec.body(f"motor_{axis}").pos = np.multiply(linkage.distance[i], way) - (0, 0, depth[i])
        for name, end in (("crank", crank), ("arm", arm)):
            spec.site(f"{name}_{axis}").pos = end
            if drawn := spec.geom(f"{name}_{axis}"):  # what only a viewer needs may be left out
                drawn.fromto = [*end, 0, 0, 0]


def _couple(
    model: mujoco.MjModel, data: mujoco.MjData, before: mujoco.MjModel, parts: Parts
) -> None:
    """Give the wheels' contact its stiffness and damping, whatever the masses are now.

    The engine divides both by its estimate of the inverse masses (``models/ballplate.xml``).
    """
    inertia = np.zeros((model.nv, model.nv))
    put_level(model, data)
    mujoco.mj_fullM(model, data, inertia)
    for axis in AXIS_NAMES:
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
