"""Ranges of settings: written in their types, checked when an object is made."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Len, Lt

Positive = Annotated[float, Gt(0)]
"""A number above zero."""
NotNegative = Annotated[float, Ge(0)]
"""A number, 0 or more."""
Pair = float | tuple[float, float]
"""A number for both axes, or one for x and one for y."""

_BOUNDS: dict[type, tuple[Callable[[Any, Any], bool], str]] = {
    Gt: (operator.gt, "above {}"),
    Ge: (operator.ge, "{} or more"),
    Lt: (operator.lt, "below {}"),
    Le: (operator.le, "{} or less"),
}


def check(item: object) -> None:
    """Make sure that all settings of a dataclass's object are in the ranges that their types name.

    Numbers must be finite. Of other types than numbers, lists of them and words, all is taken.

    Raises:
        ValueError: If one is not: which, what is allowed, and what it is.
    """
    cls: Any = type(item)
    for name, hint in _hints(cls).items():
        value = getattr(item, name)
        if not _holds(hint, value):
            got = list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
            raise ValueError(f"{name} must be {_words(hint)}, got {got}")


@cache
def _hints(cls: Any) -> dict[str, Any]:
    """The types of the fields of a dataclass that are given to it."""
    hints = get_type_hints(cls, include_extras=True)
    return {each.name: hints[each.name] for each in fields(cls) if each.init}


def _holds(hint: Any, value: Any) -> bool:
    """Whether a value is what a type allows."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        marks = [mark for mark in parts[1:] if type(mark) in _BOUNDS]
        lengths = [mark.min_length for mark in parts[1:] if isinstance(mark, Len)]
        return (
            _holds(parts[0], value)
            and all(len(value) == length for length in lengths)
            and all(_BOUNDS[type(mark)][0](value, _bound(mark)) for mark in marks)
        )
    if origin in {Union, UnionType}:
        return any(_holds(part, value) for part in parts)
    if origin is tuple:
        several = hasattr(value, "__len__") and not isinstance(value, str)
        each = [parts[0]] * len(value) if several and parts[-1] is ... else parts
        return several and len(each) == len(value) and all(map(_holds, each, value))
    if hint in {float, int}:
        return isinstance(value, Real if hint is float else Integral) and math.isfinite(value)
    return {Literal: value in parts, NoneType: value is None}.get(origin or hint, True)


def _words(hint: Any, marks: tuple[Any, ...] = (), many: str | None = None) -> str:
    """What a type allows.

    Args:
        hint: The type.
        marks: Bounds of each number.
        many: How many numbers there must be, and a space; empty for any, None for one alone.
    """
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        own = tuple(mark for mark in parts[1:] if type(mark) in _BOUNDS)
        for mark in parts[1:]:
            if isinstance(mark, Len):  # of tuple[..., ...]
                return _words(get_args(parts[0])[0], marks, f"{mark.min_length} ")
        return _words(parts[0], (*own, *marks), many)
    if origin in {Union, UnionType}:
        known = [part for part in parts if part is not NoneType]
        return " or ".join(_words(part, marks, many) for part in known)
    if origin is tuple:
        count = "" if parts[-1] is ... else f"{len(parts)} "
        return ("" if many is None else "lists of ") + _words(parts[0], marks, count)
    if origin is Literal:
        return f"{many}of " * (many is not None) + " or ".join(f'"{part}"' for part in parts)
    whole = "whole number" if hint is int else "number"
    said = ", ".join(_BOUNDS[type(mark)][1].format(f"{_bound(mark):g}") for mark in marks)
    if many is None:
        short = {"": "a finite {}", "above 0": "a positive {}"}
        long = "a {}, " + said
    else:
        short = {"": "finite {}s", "above 0": "positive {}s"}
        long = "finite {}s, none negative" if said == "0 or more" else "{}s, each " + said
    return (many or "") + short.get(said, long).format(whole)


def _bound(mark: Any) -> float:
    """The number that a mark compares with."""
    return float(getattr(mark, type(mark).__name__.lower()))
