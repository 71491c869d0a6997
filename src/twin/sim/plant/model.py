"""Compiled mechanisms of N rigs: from the model file, with other parts, brought to rest level."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from operator import attrgetter
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from controllers.arrays import Array, Mask, Number
from twin.base.errors import ModelError
from twin.base.shipped import model_path
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


MODEL_NAMES = {
    "joint": ("theta", "phi", "cam_theta", "cam_phi", "ball"),
    "geom": ("plate", "ball"),
    "body": ("plate", "ball", "motor_phi", "motor_theta"),
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
        "motor_phi",
        "motor_theta",
        "ball_force",
        "torque_phi",
        "torque_theta",
    ),
}
"""Names that the plant needs in a model, by kind; the contract of the model file."""
ON_CAMS = {
    "geom": ("wheel_phi", "wheel_theta", "cam_phi", "cam_theta"),
    "tendon": ("spring",),
    "pair": ("cam_phi", "cam_theta"),
    "sensor": ("wheel_phi_force", "wheel_theta_force", "spring_length"),
}
"""Further names of a model with cams; one with rods is of this installation."""
RODS_FILE = "ballplate_rods.xml"

_ONE_AT_A_TIME = Lock()
"""Mechanisms that are fitted share the room for it."""

_readers = {name: attrgetter(name) for name in MODEL_FIELDS}


def load_model(
    path: Path | None = None,
    parts: Parts | None = None,
    *,
    drawn: bool = True,
    stands: mujoco.MjModel | None = None,
) -> mujoco.MjModel:
    """Compile a mechanism and check that it has every name the plant needs.

    Args:
        path: The MJCF file; None for the packaged one with the parts' linkage, or with cams.
        parts: What differs from the file.
        drawn: Whether it is to be seen; without what only a viewer needs it moves by the same bits.
        stands: The mechanism before parts were exchanged: it is not levelled again, its shafts stay
            at their heights. None levels it if the parts change its balance.

    Raises:
        ModelError: If the file cannot be read or compiled, or lacks names.
    """
    parts = parts or Parts()
    if path is None:
        path = model_path() if parts.linkage is None else model_path(RODS_FILE)
    if not path.is_file():
        raise ModelError(f"model {path}: no such file")
    content = path.read_bytes()
    try:
        if stands is None:
            return copy.copy(_level_model(path, content, drawn, parts))
        return _fit_model(path, content, drawn, parts, stands)
    except ValueError as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"model {path}: {' '.join(str(error).split())}") from error


MECHANISM_PREFIXES = ("cam_", "motor_", "shaft_", "spring_", "wheel_")
"""Beginnings of the names of what moves the plate of the model file, and no other."""
HIDDEN_GROUP = 4
"""A group of geoms and tendons that nobody draws."""


def drawn_model(
    parts: Parts, size: tuple[float, float], area: tuple[float, float], *, rounded: bool = False
) -> mujoco.MjModel:
    """A mechanism to look at, with the screen and the operating area of a rig.

    The drive of a plate other than the model file's is unknown: only the plate, its cardan joint
    and their post are drawn.

    Args:
        parts: What differs from the model file.
        size: Sides of the screen along x and y, m.
        area: Operating area |x|, |y|, m.
        rounded: Whether the screen is round.

    Raises:
        ModelError: If a number is out of range.
    """
    known, (x, y) = load_model(parts=parts), area
    share = np.divide(size, 2 * screen_of(known).half)
    whole = replace(parts, size=size, rounded=rounded)
    same = bool((share == 1).all()) and rounded == parts.rounded
    model = known if same else load_model(parts=whole, stands=known)
    for name, axis, place in (("front", 1, -y), ("rear", 1, y), ("left", 0, -x), ("right", 0, x)):
        line = model.geom(f"area_{name}")
        line.pos[axis], line.size[1 - axis] = place, area[1 - axis]
    if same:
        return model
    model.geom("base").size[:2] *= np.minimum(share, 1)
    for geom in map(model.geom, range(model.ngeom)):
        if geom.name.startswith(MECHANISM_PREFIXES):
            geom.group[:] = HIDDEN_GROUP
    model.tendon_group[:] = HIDDEN_GROUP
    return model


@lru_cache(maxsize=1024)
def _level_model(path: Path, content: bytes, drawn: bool, parts: Parts) -> mujoco.MjModel:
    """A mechanism, levelled once: laws that are compared run on the same ones. Never changed."""
    if parts == Parts():
        return _compile_file(path, content, drawn)[1]
    return _fit_model(path, content, drawn, parts, None)


def _fit_model(
    path: Path, content: bytes, drawn: bool, parts: Parts, stands: mujoco.MjModel | None
) -> mujoco.MjModel:
    with _ONE_AT_A_TIME:
        before = _compile_file(path, content, drawn)[1]
        model, data = _shape_model(path, content, drawn, parts.compiled)
        return fit_parts(copy.copy(model), data, before, parts, stands)


@lru_cache(maxsize=64)
def _shape_model(
    path: Path, content: bytes, drawn: bool, parts: Parts
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The mechanism with ball and plate exchanged, compiled once and never changed; its data."""
    model = compile_with(_compile_file(path, content, drawn)[0], parts)
    return model, mujoco.MjData(model)


@lru_cache(maxsize=8)
def _compile_file(path: Path, content: bytes, drawn: bool) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """The model file with that content, read and compiled once. Never changed."""
    del content
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.discardvisual = not drawn
    model = spec.compile()
    _check(model, path)
    return spec, model


def _check(model: mujoco.MjModel, path: Path) -> None:
    asked = [*MODEL_NAMES.items(), *(() if on_rods(model) else ON_CAMS.items())]
    missing = [
        f"{kind} {name}"
        for kind, names in asked
        for name in names
        if mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name) < 0
    ]
    if missing:
        raise ModelError(f"model {path}: missing {', '.join(missing)}")


class Screen(NamedTuple):
    """Half sides of a plate's surface along x and y, m, its height, m, and whether it is round."""

    half: Array
    height: float
    rounded: bool


def screen_of(model: mujoco.MjModel) -> Screen:
    """The surface on which the ball rolls."""
    plate = model.geom("plate")
    rounded = bool(plate.type[0] == mujoco.mjtGeom.mjGEOM_CYLINDER)
    thick = plate.size[1 if rounded else 2]
    return Screen(plate.size[[0, 0 if rounded else 1]], float(plate.pos[2] + thick), rounded)


def on_rods(model: mujoco.MjModel) -> bool:
    """Whether a mechanism has cranks and rods in place of cams, wheels and spring."""
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, "rod_phi") >= 0)


def motor_ratio(model: mujoco.MjModel) -> Number:
    """Motor angle per plate angle about level, dimensionless; of rods (phi, theta)."""
    if on_rods(model):
        names = [[f"{of}_{axis}" for axis in AXIS_NAMES] for of in ("arm", "crank")]
        arms, cranks = ([np.linalg.norm(model.site(each).pos) for each in of] for of in names)
        return np.divide(arms, cranks)
    lever = np.abs(model.geom("wheel_phi").pos[0])
    return float(lever / np.hypot(*model.geom("cam_phi").pos[[0, 2]]))


def fields_of(parts: Iterable[Parts]) -> Iterable[str]:
    """The model fields in which mechanisms of one file with some parts can differ."""
    return FITTED_FIELDS if len({each.compiled for each in parts}) == 1 else MODEL_FIELDS


def differing(
    models: Sequence[mujoco.MjModel], among: Iterable[str] = MODEL_FIELDS
) -> dict[str, Array]:
    """The model fields in which compiled mechanisms differ, one value per mechanism, (N, ...).

    Args:
        models: One per mechanism.
        among: The fields in which they may.

    Raises:
        ModelError: If they differ in more than numbers, so that they cannot run side by side.
    """
    found: dict[str, Array] = {}
    each = {model: place for place, model in enumerate(dict.fromkeys(models))}
    if len(each) == 1:
        return found
    which = [each[model] for model in models]
    for name in among:
        values = [value_of(model, name) for model in each]
        if len({value.shape for value in values}) > 1:
            raise ModelError(
                "plant.ball.offset_mm: rigs side by side must all have a ball out of balance or "
                "none"
            )
        if len({value.tobytes() for value in values}) > 1:
            found[name] = np.stack(values)[which]
    return found


def value_of(model: mujoco.MjModel, name: str) -> Array:
    """A model field as ``differing`` names it."""
    return np.asarray(_readers[name](model))


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
"""The model fields that ``fitted`` changes, and sizes that a sphere has but does not use: all in
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


class RigModels:
    """A model for each rig: as it was built, and with what has been exchanged since.

    A batch has one model and, of the fields in which its rigs differ, a value for each.

    Args:
        rigs: How many.
        parts: What differs from the model file, one for all or one a rig.
        step: Physics step in s; None for the model's own.
        disabled: The engine's ``mjtDisableBit`` flags to set.

    Raises:
        ModelError: If the model cannot be used, or a number is out of range.
    """

    def __init__(
        self,
        rigs: int,
        parts: Parts | Sequence[Parts],
        step: float | None,
        disabled: int,
    ) -> None:
        if rigs < 1:
            raise ModelError(f"rigs must be 1 or more, got {rigs}")
        if step is not None and not 0 < step <= 0.002:
            raise ModelError(f"physics step must be in (0, 0.002] s, got {step}")
        _keep_quiet()
        self._parts = [parts] * rigs if isinstance(parts, Parts) else list(parts)
        if len(self._parts) != rigs:
            raise ModelError(f"{rigs} rigs cannot have {len(self._parts)} sets of parts")
        self._step, self._disabled = step, disabled
        file = model_path() if self._parts[0].linkage is None else model_path(RODS_FILE)
        self.gravity = float(-load_model(file, drawn=False).opt.gravity[2])
        """Gravity in m/s^2 from the file, as the components of a tilted base are rounded."""
        self._built = self._compiled(self._parts)
        self._now = self._built
        self._exchanged: dict[tuple[Parts, Parts], mujoco.MjModel] = {}
        self._own: set[str] = set()
        """Names of the model fields in which the rigs differ, or once did."""

    @property
    def first(self) -> mujoco.MjModel:
        """Model of the first rig as it was built."""
        return self._built[0]

    def heights(self, rigs: NDArray[np.integer] | None = None) -> Array:
        """Height of the ball's centre on the level plate in m, of all rigs or of some."""
        models = self._built if rigs is None else [self._built[rig] for rig in rigs.tolist()]
        height = self.first.joint("ball").qposadr[0] + 2
        return np.array([model.key("level").qpos[height] for model in models])

    def shapes(self) -> tuple[Array, Array, Mask]:
        """Half sides of the plates in m, (2, N), heights in m and whether they are round, (N,)."""
        half, surface, rounded = zip(*map(screen_of, self._built), strict=True)
        return np.transpose(half), np.array(surface), np.array(rounded)

    def batch(self, threads: int, *, persistent: bool) -> Batch:
        """A batch of the rigs, with what each has of its own.

        Args:
            threads: To step on, 0 for one a processor; one rig needs only one.
            persistent: Whether each rig goes on from the stages that are computed of it.
        """
        rigs = len(self._built)
        batch = Batch(self.first, rigs, threads if rigs > 1 else 1, persistent=persistent)
        fields = differing(self._built, fields_of(self._parts))
        for name, values in fields.items():
            batch.expand(name)[:] = values
        self._own = set(fields)
        return batch

    def foresee(self, parts: Sequence[Parts]) -> None:
        """Compile the models with other parts, one a rig, so that ``exchange`` takes no time.

        Raises:
            ModelError: If a number is out of range.
        """
        for own, stands, other in zip(self._parts, self._built, parts, strict=True):
            wanted = _at_level_of(own, other)
            if (own, wanted) not in self._exchanged:
                as_it_was = stands if wanted == own else self._compile(wanted, stands)
                self._exchanged[own, wanted] = as_it_was

    def exchange(self, batch: Batch, parts: Sequence[Parts]) -> None:
        """Give a batch other parts, one a rig; nothing is levelled again.

        Raises:
            ModelError: If a number is out of range.
        """
        self.foresee(parts)
        models = [
            self._exchanged[own, _at_level_of(own, other)]
            for own, other in zip(self._parts, parts, strict=True)
        ]
        fields = differing([*self._built, *self._now, *models])
        fields.pop("opt.gravity", None)
        for name, values in fields.items():
            batch.expand(name)[:] = values[-len(models) :]
        self._now = models
        levels = [part.level or (0.0, 0.0) for part in parts]
        batch.expand("opt.gravity")[:] = tilted_gravity(levels, self.gravity)

    def rebuild(self, batch: Batch, rigs: NDArray[np.integer], parts: Sequence[Parts]) -> None:
        """Build some rigs of a batch anew, with other parts, one each.

        Raises:
            ModelError: If a number is out of range.
        """
        models = self._compiled(parts)
        among = fields_of([self._parts[0], *parts])
        self._own |= set(differing([self.first, *models], among))
        for name in self._own:
            batch.expand(name)[rigs] = [value_of(model, name) for model in models]
        for rig, part, model in zip(rigs.tolist(), parts, models, strict=True):
            self._parts[rig], self._built[rig] = part, model

    def _compiled(self, parts: Sequence[Parts]) -> list[mujoco.MjModel]:
        """One model a rig; rigs of the same parts share theirs."""
        made = {part: self._compile(part) for part in dict.fromkeys(parts)}
        return [made[part] for part in parts]

    def _compile(self, parts: Parts, stands: mujoco.MjModel | None = None) -> mujoco.MjModel:
        model = load_model(parts=parts, drawn=False, stands=stands)
        model.opt.disableflags |= self._disabled
        if self._step is not None:
            model.opt.timestep = self._step
        return model


def _at_level_of(own: Parts, other: Parts) -> Parts:
    """Other parts on a rig's own base, which may tilt without anything being exchanged."""
    return replace(other, level=own.level)


def _keep_quiet() -> None:
    """Keep the engine from writing MUJOCO_LOG.TXT and lines on the terminal.

    A plant's ``warnings`` tell.
    """
    config = mujoco.MjLogConfig.get()
    config.logto_console = config.logto_file = False
    config.set()
