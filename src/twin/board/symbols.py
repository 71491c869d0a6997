"""Numpy arrays of CasADi symbols: laws and observers calculate with them as with numbers.

Laws and observers are written with numpy, so their code runs unchanged on an array of symbols. Each
arithmetic operation adds a node to an expression graph. A comparison gives a symbol that must not
decide a branch: ``if`` on it raises ``NoSymbolicFormError``; ``np.where`` and ``np.minimum`` work.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from controllers.arrays import Arithmetic


class NoSymbolicFormError(TypeError):
    """An equation decides by a value that is known at run time only."""


def _expression(value: Any) -> Any:
    """The CasADi expression of a symbol, a number or an array of one of them."""
    if isinstance(value, np.ndarray):
        value = value.item()
    if isinstance(value, Symbol):
        return value.expression
    return ca.SX(float(value))


def _choose(condition: Any, this: Any, other: Any) -> Any:
    """One of two values by a condition, which is a symbol or known; the other may be NaN."""
    if not isinstance(condition, Symbol):
        return this if condition else other
    return Symbol(ca.if_else(*map(_expression, (condition, this, other))))


def _is_infinite(value: Any) -> bool:
    return bool(value.is_constant() and math.isinf(float(value)))


def _add(a: Any, b: Any) -> Any:
    """A sum; with an infinite number, as of a sample that counts nothing, it is infinite."""
    return next((each for each in (a, b) if _is_infinite(each)), a + b)


def _divide(a: Any, b: Any) -> Any:
    """A quotient; by an infinite number it is zero."""
    return ca.SX(0.0) if _is_infinite(b) else a / b


UFUNCS: dict[Any, Callable[..., Any]] = {
    np.add: _add,
    np.subtract: lambda a, b: a - b,
    np.multiply: lambda a, b: a * b,
    np.divide: _divide,
    np.power: lambda a, b: a**b,
    np.negative: lambda a: -a,
    np.positive: lambda a: a,
    np.absolute: ca.fabs,
    np.square: lambda a: a * a,
    np.sqrt: ca.sqrt,
    np.sin: ca.sin,
    np.cos: ca.cos,
    np.tan: ca.tan,
    np.arcsin: ca.asin,
    np.sign: ca.sign,
    np.radians: lambda a: a * (math.pi / 180),
    np.minimum: ca.fmin,
    np.maximum: ca.fmax,
    np.not_equal: lambda a, b: a != b,
    np.less: lambda a, b: a < b,
    np.less_equal: lambda a, b: a <= b,
    np.greater: lambda a, b: a > b,
    np.greater_equal: lambda a, b: a >= b,
    np.logical_and: ca.logic_and,
    np.bitwise_and: ca.logic_and,
    np.logical_or: ca.logic_or,
    np.bitwise_or: ca.logic_or,
    np.logical_not: ca.logic_not,
    np.invert: ca.logic_not,
}
"""Numpy's functions that have a form in C, and what they are of CasADi's expressions."""


def _calculate(ufunc: Any, *values: Any) -> Symbol:
    """One function of symbols and numbers.

    Raises:
        NoSymbolicFormError: If there is no such function of symbols.
    """
    if ufunc not in UFUNCS:
        raise NoSymbolicFormError(f"numpy's {ufunc.__name__} has no symbolic form")
    return Symbol(UFUNCS[ufunc](*map(_expression, values)))


class Symbol(np.lib.mixins.NDArrayOperatorsMixin):
    """A real number that is known at run time only.

    Args:
        expression: A CasADi expression, shape (1, 1).
    """

    __slots__ = ("expression",)

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    def __array_ufunc__(self, ufunc: Any, method: str, *values: Any, **how: Any) -> Any:
        """A function of numpy, of this symbol and others, elementwise for arrays."""
        arrays = [value for value in values if isinstance(value, np.ndarray) and value.ndim]
        if arrays or method != "__call__":
            return as_symbols(self).__array_ufunc__(
                ufunc, method, *(as_symbols(v) if v is self else v for v in values), **how
            )
        return _calculate(ufunc, *values)

    def __array_function__(self, *how: Any) -> Any:
        """A function of numpy, of this symbol and arrays of numbers."""
        return as_symbols(self).__array_function__(*how)

    def __bool__(self) -> bool:
        """Raise: the value is not known."""
        raise NoSymbolicFormError("it decides by a value that is known at run time only")

    def __float__(self) -> float:
        """Raise: the value is not known."""
        raise NoSymbolicFormError(
            "it needs a value that is known at run time only as a plain number"
        )


class Setting(Symbol):
    """A constant of the C code that is not zero, and so decides a branch."""

    __slots__ = ()

    def __bool__(self) -> bool:
        """True: it is not zero."""
        return True


class SymbolArray(np.ndarray[Any, np.dtype[Any]]):
    """An array with symbols and numbers as its elements.

    Attributes:
        arithmetic: Arithmetic of its elements, as ``controllers.arrays.arithmetic_of`` finds it.
    """

    arithmetic: ClassVar[Arithmetic]

    def __array_ufunc__(
        self, ufunc: Any, method: str, *values: Any, out: Any = None, **how: Any
    ) -> Any:
        """A function of numpy, elementwise; reductions and products by sums and products."""
        plain = [np.asarray(value, object) for value in values]
        if method == "__call__" and ufunc is not np.matmul:
            each = np.frompyfunc(lambda *of: _calculate(ufunc, *of), len(plain), 1)
            result = each(*plain)
        else:
            result = getattr(ufunc, method)(*plain, **how)
        result = as_symbols(result)
        if out is None:
            return result
        out[0][...] = result
        return out[0]

    def __array_function__(self, func: Any, types: Iterable[type], args: Any, kwargs: Any) -> Any:
        """A function of numpy; those that decide by values are made of symbols."""
        if func is np.where:
            return as_symbols(
                np.frompyfunc(_choose, 3, 1)(*(np.asarray(each, object) for each in args))
            )
        if func is np.clip:
            return np.minimum(np.maximum(args[0], args[1]), args[2])
        return super().__array_function__(func, types, args, kwargs)

    def dot(self, other: Any) -> Self:  # type: ignore[override]
        """The product with a matrix or vector, summed in the order of the elements."""
        return as_symbols(np.dot(np.asarray(self), np.asarray(other, object)))  # type: ignore[return-value]


def as_symbols(values: Any) -> SymbolArray:
    """Numbers and symbols as an array of symbols, without a copy where they are one."""
    if isinstance(values, Symbol):
        found = np.empty((), object)
        found[()] = values
        return found.view(SymbolArray)
    return np.asarray(values, object).view(SymbolArray)


def new_symbols(name: str, *shape: int, kind: type[Symbol] = Symbol) -> tuple[Any, SymbolArray]:
    """New symbols.

    Args:
        name: Their common name.
        shape: Of the array.
        kind: Of each.

    Returns:
        The column of all of them for CasADi, shape (product of ``shape``, 1), and the array.
    """
    column = ca.SX.sym(name, int(np.prod(shape)))
    found = np.empty(len(ca.vertsplit(column)), object)
    for i in range(len(found)):
        found[i] = kind(column[i])
    return column, found.reshape(shape).view(SymbolArray)


def expressions(values: Any) -> list[Any]:
    """The CasADi expressions of an array of symbols and numbers, in order."""
    return [_expression(value) for value in np.asarray(values, object).ravel()]


SYMBOL_ARITHMETIC = Arithmetic(
    np.sqrt,
    _choose,
    lambda condition: not _expression(condition).is_zero(),
    lambda condition: bool(_expression(condition).is_one()),
    np.minimum,
    np.maximum,
    np.sin,
    np.cos,
)
"""Of symbols, next to those of numbers and of arrays. What is not known is taken as true by ``any``
and as false by ``all``, so that nothing is left out."""
SymbolArray.arithmetic = SYMBOL_ARITHMETIC
