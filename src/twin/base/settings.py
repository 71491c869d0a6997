"""Settings: what a scenario may say of a dataclass's field, stated where the field is.

A field made by ``setting`` names the scenario key that sets it, the key's unit, range and default.
The tables of a scenario and the rigs made from it are both derived from these fields, so an effect
is one field, the code that uses it, and the statement of who follows it (``followers``).
"""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from functools import cache, partial
from operator import attrgetter
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from twin.base.errors import ModelError
from twin.base.followers import Followers

Model = TypeVar("Model")
KEY_DEFAULT = object()
"""Sentinel: the field has the default of its key."""


class Unit(Enum):
    """Units in which a person writes numbers; each knows the way of one or an array to SI."""

    # in tuples, because a bare function in an Enum is a method
    SI = (lambda value: value,)
    MM = (lambda value: value / 1000,)
    UM = (lambda value: value * 1e-6,)
    DEG = (lambda value: value * (math.pi / 180),)
    PERCENT = (lambda value: value / 100,)

    def to_si(self, value: Any) -> Any:
        """A number, an array, or a tuple of such of any depth, in SI; None stays None."""
        if value is None or self is Unit.SI:
            return value
        if isinstance(value, tuple):
            return tuple(map(self.to_si, value))
        convert: Callable[[Any], Any] = self.value[0]
        return convert(value)


@dataclasses.dataclass(frozen=True)
class Setting:
    """The setting of one field: key, unit, range and followers.

    Attributes:
        key: Dotted key, as ``plant.friction.rolling_mm``.
        default: Value of a scenario that does not give one, in the key's unit.
        unit: The key's unit.
        bounds: Range of the value, or of each of its numbers: any of ge, gt, le, lt.
        followed_by: Who acts on it, and who leaves it out and why.
        type: Its type; None for the type of the default.
        changes: How it may change while a rig runs: along a ``ramp``, at once (``jump``), or empty.
    """

    key: str
    default: Any
    unit: Unit
    bounds: dict[str, float]
    followed_by: Followers
    type: Any = None
    changes: str = ""

    def of(self, scenario: Any) -> Any:
        """Its value in a scenario, in the key's unit."""
        return value_of(scenario, self.key)


def value_of(scenario: Any, key: str) -> Any:
    """The value of a dotted key in a scenario."""
    return _reader(key)(scenario)


_reader = cache(attrgetter)
"""Reads a dotted key; made once, as N rigs are asked for hundreds of keys each."""


def setting(
    key: str,
    default: Any,
    unit: Unit = Unit.SI,
    *,
    followed_by: Followers,
    otherwise: Any = KEY_DEFAULT,
    type: Any = None,  # noqa: A002  the word for it
    changes: str = "",
    **bounds: float,
) -> Any:
    """A dataclass field that a scenario key sets.

    Args:
        key: The key.
        default: What a scenario has that does not give it, in the key's unit.
        unit: The key's unit; the field is in SI.
        followed_by: Who acts on it, and who leaves it out and why.
        otherwise: Default of the field itself, in SI; if not given, the default of the key.
        type: Type of the key; if not given, the type of the default.
        changes: How it may change while a rig runs.
        bounds: Range: ge, gt, le, lt.

    Raises:
        ModelError: If nothing is stated of one who may follow it.
    """
    if followed_by.unstated:
        parts = ", ".join(followed_by.unstated)
        raise ModelError(f"{key}: followed_by must state how or why not, and lacks {parts}")
    about = Setting(key, default, unit, bounds, followed_by, type, changes)
    own = unit.to_si(default) if otherwise is KEY_DEFAULT else otherwise
    return dataclasses.field(default=own, metadata={"setting": about})


ramp = partial(setting, changes="ramp")
"""A field that a scenario key sets, and that may change along a ramp while a rig runs."""
jump = partial(setting, changes="jump")
"""A field that a scenario key sets, and that may change at once while a rig runs."""


def settings_of(cls: Any) -> Mapping[str, Setting]:
    """The settings of a dataclass by the names of their fields."""
    return _settings_of(cls)


@cache
def _settings_of(cls: Any) -> Mapping[str, Setting]:
    found = {item.name: item.metadata.get("setting") for item in dataclasses.fields(cls)}
    return MappingProxyType({name: about for name, about in found.items() if about is not None})


def check(item: object) -> None:
    """Make sure that an object's numbers are finite and in the ranges of the keys that set them.

    Raises:
        ModelError: If one is not; the message has the key, the allowed range and the value.
    """
    for name, about in settings_of(type(item)).items():
        value = getattr(item, name)
        if value is None:
            continue
        numbers = np.asarray(value, float)
        inside = np.isfinite(numbers)
        for bound, limit in about.bounds.items():
            inside &= getattr(operator, bound)(numbers, about.unit.to_si(limit))
        if not inside.all():
            bounds = [
                f"{_BOUND_WORDS[bound]} {about.unit.to_si(limit):g}"
                for bound, limit in about.bounds.items()
            ]
            raise ModelError(f"{name} must be {' and '.join(bounds) or 'finite'}, got {value}")


_BOUND_WORDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


def per_rig(about: Setting, scenarios: Sequence[Any]) -> Any:
    """A setting in SI: one value if the scenarios agree, else an array with one entry per rig."""
    values = list(map(_reader(about.key), scenarios))
    if values.count(values[0]) == len(values):
        return about.unit.to_si(values[0])
    return about.unit.to_si(np.array(values))


def from_scenarios(cls: type[Model], scenarios: Sequence[Any], **more: Any) -> Model:
    """The dataclass of N rigs: fields in which their scenarios differ have one entry per rig.

    Args:
        cls: A dataclass with settings.
        scenarios: One per rig.
        more: Its other fields.
    """
    values = {name: per_rig(about, scenarios) for name, about in settings_of(cls).items()}
    return cls(**values | more)


def from_changes(cls: type[Model], scenario: Any) -> Model:
    """The dataclass of one rig with only those fields set that its scenario changes."""
    values = {
        name: about.unit.to_si(about.of(scenario))
        for name, about in settings_of(cls).items()
        if about.of(scenario) != about.default
    }
    return cls(**values)
