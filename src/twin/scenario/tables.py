"""Tables of a scenario, derived from the dataclasses whose settings they are."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, create_model

from twin.settings import Setting, settings_of

STRICT = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Section(BaseModel):
    """A table of a scenario: unknown keys, wrong types and non-finite numbers are refused."""

    model_config = STRICT
    sources: ClassVar[dict[str, tuple[type, str]]] = {}
    """Of keys that set a dataclass's field: key to dataclass and name of the field."""


if TYPE_CHECKING:

    class Derived(Section):
        """What a type checker knows of a derived table: it has keys."""

        def __init__(self, **keys: Any) -> None: ...

        def __getattr__(self, name: str) -> Any: ...


def tables(*classes: type, bases: Mapping[str, type[Section]], module: str) -> dict[str, Any]:
    """The models of all tables that settings of some dataclasses lie in, by dotted name.

    Args:
        classes: Dataclasses with settings.
        bases: What some tables have besides: fields of their own and checks. Tables and the keys of
            each are in the order in which they are named, here first.
        module: Where each model stands under its name, so that it can be sent to other processes:
            ``plant.ball`` is ``PlantBallTable``.
    """
    fields: dict[str, dict[str, Any]] = {name: {} for name in bases}
    sources: dict[str, dict[str, tuple[type, str]]] = {name: {} for name in bases}
    for cls in classes:
        for field, about in settings_of(cls).items():
            path, _, key = about.key.rpartition(".")
            fields.setdefault(path, {})[key] = (_hint(about), about.default)
            sources.setdefault(path, {})[key] = (cls, field)
    inner: dict[str, dict[str, Any]] = {}
    found: dict[str, Any] = {}
    for path in sorted(fields, key=lambda path: -path.count(".")):
        title = "".join(part.capitalize() for part in path.split(".")) + "Table"
        own: dict[str, Any] = inner.get(path, {}) | fields[path]
        made = create_model(title, __base__=bases.get(path, Section), __module__=module, **own)
        made.sources = sources[path]
        outer, _, name = path.rpartition(".")
        inner.setdefault(outer, {})[name] = (made, made())
        found[path] = made
    return found


def _hint(about: Setting) -> Any:
    """The type of a key: that of its default, every number of it within the bounds."""
    default = about.default
    if about.type is not None:
        return about.type if default is not None else about.type | None
    at = about.bounds.get
    number = Field(ge=at("ge"), gt=at("gt"), le=at("le"), lt=at("lt"))
    if isinstance(default, tuple):
        return tuple[(Annotated[float, number],) * len(default)]  # type: ignore[misc]
    if isinstance(default, int):
        return Annotated[int, number]
    bounded = Annotated[float, number]
    return bounded | None if default is None else bounded


def model_of(cls: type, without: Collection[str] = ()) -> type[BaseModel]:
    """A strict model of a frozen dataclass and of those in it."""
    hints = typing.get_type_hints(cls, include_extras=True)
    fields: dict[str, Any] = {}
    for item in dataclasses.fields(cls):
        if item.name in without or not item.init:
            continue
        hint = hints[item.name]
        kind = dataclass_of(hint)
        if kind is not None:
            inner = model_of(kind)
            fields[item.name] = (inner | None, None)
        elif item.default is not dataclasses.MISSING:
            fields[item.name] = (hint, item.default)
        elif item.default_factory is not dataclasses.MISSING:
            fields[item.name] = (hint, Field(default_factory=item.default_factory))
        else:
            fields[item.name] = (hint, ...)
    return create_model(cls.__name__, __config__=STRICT, **fields)


def dataclass_of(hint: Any) -> type | None:
    """The dataclass that a field holds, also one that may be None; None for any other field."""
    for each in (hint, *typing.get_args(hint)):
        if isinstance(each, type) and dataclasses.is_dataclass(each):
            return each
    return None
