"""The models of the rigs of a batch: the fields in which they differ, and parts exchanged."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import attrgetter

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from twin.base.errors import ModelError
from twin.base.shipped import model_path
from twin.sim.plant.fitting import FITTED_FIELDS
from twin.sim.plant.interface import Parts, tilted_gravity
from twin.sim.plant.model import RODS_FILE, load_model, screen_of

_readers = {name: attrgetter(name) for name in MODEL_FIELDS}


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

    The ``warnings`` of a plant report them.
    """
    config = mujoco.MjLogConfig.get()
    config.logto_console = config.logto_file = False
    config.set()
