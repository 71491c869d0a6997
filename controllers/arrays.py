"""Types of the project: arrays, and ranges of settings that are checked when an object is made.

The functions calculate one rig with plain numbers and many with arrays, by the same formula.
"""

from __future__ import annotations

import math
import operator
import typing
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import cache, partial
from itertools import repeat
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

import numpy as np
from annotated_types import Ge, Gt, Le, Len, Lt
from numpy.typing import NDArray

Array = NDArray[np.floating]
"""Numbers; the last axis is the vector, the leading axes are rigs."""
Mask = NDArray[np.bool_]
"""Yes or no, one per rig."""
Number = float | Array
"""A number for all rigs, or one per rig, shape (N,)."""
State = Array
"""State x = (x, x', phi, phi', y, y', theta, theta') of (5.5), shape (..., 8).

Positions x, y of the ball's centre in m and their rates in m/s, along the axes of the plate; the
origin is the plate's centre. Plate angles phi, theta in rad and their rates in rad/s; the rotation
from plate to world is Rx(theta) Ry(phi) (4.5). A positive phi accelerates the ball along +x, a
positive theta along -y."""
Output = Array
"""Measured output y = (x, phi, y, theta) of (5.3), shape (..., 4).

Ball in m, plate in rad, with the frames and signs of ``State``. A ``Measurement`` is an output
with its time, age and touch."""
Input = Array
"""Input u = (phi'', theta'') of (5.8), plate accelerations in rad/s^2, shape (..., 2).

Signs as in ``State``. Plate rates (phi', theta') in rad/s that are commanded have the same order
but are no input."""


def constant(value: Number) -> Array:
    """A number that arrays are often calculated with: as an array itself numpy reads it faster."""
    return np.asarray(value, float)


def column(value: Number) -> Number:
    """A number as it is; one per rig as a column (N, 1), to combine with arrays (N, axes)."""
    if isinstance(value, np.ndarray) and value.ndim:
        return value[:, None] if len(value) > 1 else float(value[0])
    return value


def every(mask: Mask) -> bool:
    """Whether a mask holds everywhere; of few rigs several times faster than the mask's ``all``."""
    return b"\0" not in mask.tobytes()


def some(values: Mask | Array) -> bool:
    """Whether any value is true, or not 0; of few rigs several times faster than its ``any``."""
    # of -0.0 not every byte is 0
    return values.tobytes() != bytes(values.nbytes) and bool(values.any())


def finite(values: Array) -> bool:
    """Whether all values are finite; of few rigs several times faster than to ask of each."""
    if values.size > 2:
        return every(np.isfinite(values))
    return all(map(math.isfinite, values.ravel().tolist()))


def put(array: Array, rigs: NDArray[np.integer], values: Number) -> Array:
    """A copy of an array of N rigs with the values of some of them, shape (k, ...), put in."""
    changed: Array = array.copy()
    changed[rigs] = values
    return changed


class Arithmetic(NamedTuple):
    """Arithmetic for one formula on a plain number and on an array of rigs alike."""

    sqrt: Callable[[Any], Any]
    where: Callable[[Any, Any, Any], Any]
    """The second argument where the first is true, else the third."""
    any: Callable[[Any], bool]
    """Whether any is true, to leave out a calculation that changes nothing where none is."""
    all: Callable[[Any], bool]
    """Whether all are true, for the same."""
    least: Callable[[Any, Any], Any]
    """The smaller of two; the first if it is not a number."""
    most: Callable[[Any, Any], Any]
    """The larger of two; the first if it is not a number."""
    sin: Callable[[Any], Any]
    """Sine; NaN for an angle that is not finite."""
    cos: Callable[[Any], Any]


NUMBER_ARITHMETIC = Arithmetic(
    math.sqrt,
    lambda condition, this, other: this if condition else other,
    bool,
    bool,
    lambda this, other: other if other < this else this,
    lambda this, other: other if other > this else this,
    lambda angle: math.sin(angle) if math.isfinite(angle) else math.nan,
    lambda angle: math.cos(angle) if math.isfinite(angle) else math.nan,
)
"""Arithmetic of plain numbers, several times faster than numpy's for one rig."""
ARRAY_ARITHMETIC = Arithmetic(
    np.sqrt, np.where, some, every, np.minimum, np.maximum, np.sin, np.cos
)


def arithmetic_of(rows: Array) -> Arithmetic:
    """The arithmetic for the ``components`` of an array, shape (N, k); it may bring its own."""
    own: Arithmetic | None = getattr(rows, "arithmetic", None)
    return own or (NUMBER_ARITHMETIC if len(rows) == 1 else ARRAY_ARITHMETIC)


def elementwise(
    formula: Callable[typing.Concatenate[Arithmetic, ...], Any], *arrays: Array
) -> Array:
    """A formula of plain numbers for every element of arrays, each shape (N, k).

    Args:
        formula: What to calculate, from an arithmetic and a number of each array. It is given the
            arrays themselves for several rigs, numbers for one.
        *arrays: The inputs of the calculation.
    """
    if len(arrays[0]) > 1:
        return formula(ARRAY_ARITHMETIC, *arrays)
    one = map(formula, repeat(NUMBER_ARITHMETIC), *[array.tolist()[0] for array in arrays])
    return np.array([list(one)])


def components(values: Array) -> Any:
    """The columns of an array, shape (N, k): k numbers for one rig, else k arrays (N,)."""
    return values[0].tolist() if len(values) == 1 else values.T.copy()


def together(values: Sequence[Any], rigs: int) -> Array:
    """The reverse, shape (N, k)."""
    return np.array([values]) if rigs == 1 else np.array(values).T.copy()


def numbers(values: Array | Mask) -> Any:
    """A value of each rig, shape (...,): a number for one rig, else an array (N,)."""
    return values.item() if values.size == 1 else values.reshape(-1)


def multiply_rows(rows: Array, matrix: Array) -> Array:
    """The product of each row with a matrix, with the same bits as for this row alone.

    One product of all rows is rounded differently: BLAS adds a row's terms in a different order
    when it multiplies several at a time.

    Args:
        rows: Shape (..., n); the vectors of N rigs.
        matrix: Shape (n, m).

    Returns:
        Shape (..., m).
    """
    if rows.size == len(matrix):  # one rig: the same product without the cost of a stack
        return rows.dot(matrix)
    if not matrix.flags.forc:  # a part of a larger one: ``dot`` multiplies with a copy
        matrix = matrix.copy()
    product: Array = (rows[..., np.newaxis, :] @ matrix)[..., 0, :]
    return product


def square_of(v: Array) -> Array:
    """|v|^2 of vectors of two, shape (..., 1)."""
    x, y = v[..., :1], v[..., 1:]
    return x * x + y * y


Positive = Annotated[float, Gt(0)]
"""A number above zero."""
NotNegative = Annotated[float, Ge(0)]
"""A number, 0 or more."""
Pair = float | tuple[float, float]
"""A number for both axes, or one for x and one for y."""

_BOUND_MARKS: dict[type, tuple[str, Callable[[Any, Any], bool], str]] = {
    Gt: ("gt", operator.gt, "above {:g}"),
    Ge: ("ge", operator.ge, "{:g} or more"),
    Lt: ("lt", operator.lt, "below {:g}"),
    Le: ("le", operator.le, "{:g} or less"),
    Len: ("min_length", lambda value, count: len(value) == count, "{} of them"),
}
"""Marks of a type: where the bound stands, whether a value keeps it, and it in words."""


def check(item: object) -> None:
    """Make sure that all settings of a dataclass's object are in the ranges that their types name.

    Numbers must be finite. Of other types than numbers, lists of them and words, all is taken.

    Raises:
        ValueError: If a value is not allowed; the message has its name, the allowed range and the
            value.
    """
    cls: Any = type(item)
    for name, (hint, holds) in _tests(cls).items():
        value = getattr(item, name)
        if not holds(value):
            got = list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
            raise ValueError(f"{name} must be {_words(hint)}, got {got}")


Test = Callable[[Any], bool]
"""Whether a value is what a type allows."""


@cache
def _tests(cls: Any) -> dict[str, tuple[Any, Test]]:
    """The types of the fields of a dataclass that are given to it, and their tests."""
    hints = typing.get_type_hints(cls, include_extras=True)
    its = {each.name: hints[each.name] for each in fields(cls) if each.init}
    return {name: (hint, _test_of(hint)) for name, hint in its.items()}


def _test_of(hint: Any) -> Test:
    """The test of a type, made once."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        kind, bounds = _test_of(parts[0]), _bounds(parts)
        return lambda value: kind(value) and all(holds(value, bound) for holds, _, bound in bounds)
    if origin in {typing.Union, UnionType}:
        several = list(map(_test_of, parts))
        return lambda value: any(holds(value) for holds in several)
    if origin is tuple:
        any_number = parts[-1] is ...
        each = [_test_of(part) for part in parts if part is not ...]
        return partial(_hold_each, each, any_number=any_number)
    if hint in {float, int}:
        kinds = Real if hint is float else Integral
        return lambda value: isinstance(value, kinds) and math.isfinite(value)
    if origin is Literal:
        return lambda value: value in parts
    return (lambda value: value is None) if hint is NoneType else (lambda _: True)


def _hold_each(tests: list[Test], value: Any, *, any_number: bool) -> bool:
    """Whether a list has a value for each test, or any number for the only one, and all hold."""
    if not hasattr(value, "__len__") or isinstance(value, str):
        return False
    each = tests * len(value) if any_number else tests
    return len(each) == len(value) and all(
        holds(item) for holds, item in zip(each, value, strict=True)
    )


def _words(hint: Any) -> str:
    """Describe the values that a type allows."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        bounds = [words.format(bound) for _, words, bound in _bounds(parts)]
        return ", ".join([_words(parts[0]), *bounds])
    if origin in {typing.Union, UnionType}:
        return " or ".join(_words(part) for part in parts if part is not NoneType)
    if origin is tuple:
        count = "" if parts[-1] is ... else f" of {len(parts)}"
        return f"a list{count}, each {_words(parts[0])}"
    if origin is Literal:
        return " or ".join(f'"{part}"' for part in parts)
    return "a whole number" if hint is int else "a finite number"


def _bounds(parts: Sequence[Any]) -> list[tuple[Callable[[Any, Any], bool], str, Any]]:
    """Whether a value keeps each bound of an annotated type, the bound in words, and itself."""
    known = [(mark, *_BOUND_MARKS[type(mark)]) for mark in parts[1:] if type(mark) in _BOUND_MARKS]
    return [(holds, words, getattr(mark, name)) for mark, name, holds, words in known]
