"""Compiled mechanisms: from the model file, with every name the plant needs, and to look at."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import mujoco
import numpy as np

from controllers.arrays import Array, Number
from twin.base.errors import ModelError
from twin.base.shipped import model_path
from twin.hal.interface import AXIS_NAMES
from twin.sim.plant.fitting import compile_with, fit_parts, on_rods
from twin.sim.plant.interface import Parts

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
"""Held while parts are fitted: mechanisms of one shape share their ``MjData``."""


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


def motor_ratio(model: mujoco.MjModel) -> Number:
    """Motor angle per plate angle about level, dimensionless; of rods (phi, theta)."""
    if on_rods(model):
        names = [[f"{of}_{axis}" for axis in AXIS_NAMES] for of in ("arm", "crank")]
        arms, cranks = ([np.linalg.norm(model.site(each).pos) for each in of] for of in names)
        return np.divide(arms, cranks)
    lever = np.abs(model.geom("wheel_phi").pos[0])
    return float(lever / np.hypot(*model.geom("cam_phi").pos[[0, 2]]))
