"""Tables of a scenario, derived from the dataclasses whose settings they are."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Collection
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


def table(name: str, *classes: type, module: str, base: type[Section] = Section) -> Any:
    """The model of a table: all settings of some dataclasses whose keys lie directly in it.

    Args:
        name: Dotted name, as ``plant.friction``; the model is called ``FrictionTable``.
        classes: Dataclasses with settings.
        module: Where the model stands under its name, so that it can be sent to other processes.
        base: What the model has besides, fields of its own and checks.
    """
    fields: dict[str, Any] = {}
    sources: dict[str, tuple[type, str]] = {}
    for cls in classes:
        for field, about in settings_of(cls).items():
            path, _, key = about.key.rpartition(".")
            if path == name:
                fields[key] = (_hint(about), about.default)
                sources[key] = (cls, field)
    title = f"{name.rpartition('.')[2].capitalize()}Table"
    derived = create_model(title, __base__=base, __module__=module, **fields)
    derived.sources = sources
    return derived


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
