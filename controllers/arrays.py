"""The two array types of the project, numbers and yes or no, and how one rig is calculated fast."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import repeat
from typing import Any, Concatenate, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
"""Numbers; the last axis is the vector, the leading axes are rigs."""
Mask = NDArray[np.bool_]
"""Yes or no, one per rig."""
Number = float | Array
"""A number for all rigs, or one per rig, shape (N,)."""


def constant(value: Number) -> Array:
    """A number that arrays are often calculated with: as an array itself numpy reads it faster."""
    return np.asarray(value, float)


def column(value: Number) -> Number:
    """A number as it is, one per rig as a column, shape (N, 1), beside arrays (N, axes)."""
    if isinstance(value, np.ndarray) and value.ndim:
        return value[:, None] if len(value) > 1 else float(value[0])
    return value


def every(mask: Mask) -> bool:
    """Whether a mask holds everywhere; of one rig several times faster than the mask's ``all``."""
    return all(mask.ravel().tolist())


def some(values: Mask | Array) -> bool:
    """Whether any value is true, or not 0; of one rig several times faster than its ``any``."""
    return any(values.ravel().tolist())


def finite(values: Array) -> bool:
    """Whether all values are finite; of one rig faster than to ask numpy of each."""
    return all(map(math.isfinite, values.ravel().tolist()))


def put(array: Array, rigs: NDArray[np.integer], values: Number) -> Array:
    """A copy of an array of N rigs with the values of some of them, shape (k, ...), put in."""
    changed: Array = array.copy()
    changed[rigs] = values
    return changed


class Arithmetic(NamedTuple):
    """What one formula needs to hold for a plain number and for an array of rigs alike."""

    sqrt: Callable[[Any], Any]
    where: Callable[[Any, Any, Any], Any]
    """The second argument where the first is true, else the third."""
    any: Callable[[Any], bool | np.bool_]
    least: Callable[[Any, Any], Any]
    """The smaller of two; the first if it is not a number."""
    most: Callable[[Any, Any], Any]
    """The larger of two; the first if it is not a number."""


NUMBERS = Arithmetic(
    math.sqrt,
    lambda condition, this, other: this if condition else other,
    bool,
    lambda this, other: other if other < this else this,
    lambda this, other: other if other > this else this,
)
"""Of plain numbers, several times faster than numpy's for one rig."""
ARRAYS = Arithmetic(np.sqrt, np.where, np.any, np.minimum, np.maximum)


def elementwise(formula: Callable[Concatenate[Arithmetic, ...], Any], *arrays: Array) -> Array:
    """A formula of plain numbers for every element of arrays, each shape (N, k).

    Args:
        formula: What to calculate, from an arithmetic and a number of each array. It is given the
            arrays themselves for several rigs, numbers for one.
        *arrays: What it is calculated from.
    """
    if len(arrays[0]) > 1:
        several: Array = formula(ARRAYS, *arrays)
        return several
    one = map(formula, repeat(NUMBERS), *[array.tolist()[0] for array in arrays])
    return np.array([list(one)])


def square_of(v: Array) -> Array:
    """|v|^2 of vectors of two, shape (..., 1)."""
    x, y = v[..., :1], v[..., 1:]
    return x * x + y * y
