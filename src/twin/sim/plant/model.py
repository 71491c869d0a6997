"""From the model file to a compiled mechanism: its names, and in what several ones differ."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from functools import lru_cache
from operator import attrgetter
from pathlib import Path
from threading import Lock

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS

from controllers.arrays import Array
from twin.errors import ModelError
from twin.paths import model_path
from twin.sim.plant.fitted import FITTED, fitted, shaped
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
    content, parts = path.read_bytes(), parts or Parts()
    try:
        if stands is None:
            return copy.copy(_standing(path, content, drawn, parts))
        return _fitted(path, content, drawn, parts, stands)
    except ValueError as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"model {path}: {' '.join(str(error).split())}") from error


@lru_cache(maxsize=1024)
def _standing(path: Path, content: bytes, drawn: bool, parts: Parts) -> mujoco.MjModel:
    """A mechanism, levelled once: laws that are compared run on the same ones. Never changed."""
    if parts == Parts():
        return _compiled(path, content, drawn)[1]
    return _fitted(path, content, drawn, parts, None)


def _fitted(
    path: Path, content: bytes, drawn: bool, parts: Parts, stands: mujoco.MjModel | None
) -> mujoco.MjModel:
    with _ONE_AT_A_TIME:
        before = _compiled(path, content, drawn)[1]
        model, data = _shaped(path, content, drawn, parts.compiled)
        return fitted(copy.copy(model), data, before, parts, stands)


@lru_cache(maxsize=64)
def _shaped(
    path: Path, content: bytes, drawn: bool, parts: Parts
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The mechanism with another ball and plate, compiled once. Never changed; and room for it."""
    model = shaped(_compiled(path, content, drawn)[0], parts)
    return model, mujoco.MjData(model)


@lru_cache(maxsize=8)
def _compiled(path: Path, content: bytes, drawn: bool) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """The model file with that content, read and compiled once. Never changed."""
    del content
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.discardvisual = not drawn
    model = spec.compile()
    _check(model, path)
    return spec, model


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


def fields_of(parts: Iterable[Parts]) -> Iterable[str]:
    """The model fields in which mechanisms of one file with some parts can differ."""
    return FITTED if len({each.compiled for each in parts}) == 1 else MODEL_FIELDS


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
