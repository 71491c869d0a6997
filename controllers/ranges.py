"""Ranges of settings: written in their types, checked when an object is made."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Len, Lt

Positive = Annotated[float, Gt(0)]
"""A number above zero."""
NotNegative = Annotated[float, Ge(0)]
"""A number, 0 or more."""


@dataclass(frozen=True)
class _Range:
    """What a setting may be.

    Attributes:
        marks: Bounds of each number.
        count: How many numbers there must be; 0 for any, None for one number that is no list.
    """

    marks: tuple[Any, ...]
    count: int | None

    def holds(self, value: float | Sequence[float]) -> bool:
        """Whether a value is in the range."""
        if isinstance(value, int | float):
            return math.isfinite(value) and self._within(value)
        return self.count in {None, 0, len(value)} and all(map(self.holds, value))

    def _within(self, value: float) -> bool:
        return all(_BOUNDS[type(mark)][0](value, _bound(mark)) for mark in self.marks)

    @property
    def words(self) -> str:
        """What is allowed."""
        if self.count is not None and self.marks == (Ge(0),):
            return f"{self.count or ''} finite numbers, none negative".strip()
        if self.marks == (Gt(0),):
            many = self.count is not None
            return f"{self.count or ''} positive numbers".strip() if many else "a positive number"
        said = [_BOUNDS[type(mark)][1].format(f"{_bound(mark):g}") for mark in self.marks]
        return ", ".join(["a number", *said])


_BOUNDS: dict[type, tuple[Callable[[float, float], bool], str]] = {
    Gt: (operator.gt, "above {}"),
    Ge: (operator.ge, "{} or more"),
    Lt: (operator.lt, "below {}"),
    Le: (operator.le, "{} or less"),
}


def _bound(mark: Any) -> float:
    """The number that a mark compares with."""
    return float(getattr(mark, type(mark).__name__.lower()))


def check(item: object) -> None:
    """Make sure that all settings of an object are in the ranges that their types name.

    Raises:
        ValueError: If one is not: which, what is allowed, and what it is.
    """
    cls: Any = type(item)
    for name, its in _ranges(cls).items():
        value = getattr(item, name)
        if value is not None and not its.holds(value):
            got = value if isinstance(value, int | float) else list(value)
            raise ValueError(f"{name} must be {its.words}, got {got}")


@cache
def _ranges(cls: Any) -> dict[str, _Range]:
    """Of the fields of a dataclass, those with a range."""
    hints = get_type_hints(cls, include_extras=True)
    found = {each.name: _range(hints[each.name]) for each in fields(cls) if each.init}
    return {name: its for name, its in found.items() if its.marks}


def _range(hint: Any) -> _Range:
    """The range of a type: of its numbers, whether it is one, a list of them, or may be none."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        inner, marks = _range(parts[0]), parts[1:]
        lengths = [mark.min_length for mark in marks if isinstance(mark, Len)]
        count = lengths[0] if lengths else inner.count
        return _Range((*inner.marks, *(m for m in marks if not isinstance(m, Len))), count)
    if origin in {Union, UnionType}:
        (first, *_) = sorted(
            (_range(part) for part in parts if part is not NoneType), key=lambda r: not r.marks
        )
        return first
    if origin is tuple:
        return _Range(_range(parts[0]).marks, 0 if parts[-1] is ... else len(parts))
    return _Range((), None)
