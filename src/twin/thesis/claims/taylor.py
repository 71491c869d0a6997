"""Taylor series in time of the model's flow and of its derivative by the starting state.

Lie derivatives and brackets are such coefficients. With phi_t the flow of f from x, Phi(t) its
derivative by x and v(t) the field g seen from there, Phi(t) v(t) = g(phi_t),

    d(L_f^k h)/dx = k! C Phi_k,        ad_f^k g = k! v_k

at x, where a subscript k means the coefficient of t^k. The coefficients follow from the model's own
equations, one after the other, by arithmetic on truncated series: no step, no truncation error, and
no second copy of the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate


class Series:
    """A polynomial in t whose coefficients carry their derivatives by the starting state.

    Args:
        c: Coefficients, shape (order + 1, 9, ...): after the order of t comes the value, followed
            by its derivatives by the eight states. Orders beyond the last are cut off.
    """

    def __init__(self, c: Array) -> None:
        self.c = c

    def __add__(self, other: Series | float) -> Series:
        if isinstance(other, Series):
            return Series(self.c + other.c)
        if isinstance(other, np.ndarray):
            return NotImplemented  # numpy goes through the array's elements
        c = self.c.copy()
        c[0, 0] += other
        return Series(c)

    __radd__ = __add__

    def __neg__(self) -> Series:
        return Series(-self.c)

    def __sub__(self, other: Series | float) -> Series:
        return self + (-other)

    def __rsub__(self, other: Series | float) -> Series:
        return -self + other

    def __mul__(self, other: Series | float) -> Series:
        if isinstance(other, np.ndarray):
            return NotImplemented
        if not isinstance(other, Series):
            return Series(self.c * other)
        c = np.zeros_like(self.c)
        for k in range(len(c)):
            for j in range(k + 1):
                c[k] += _product(self.c[j], other.c[k - j])
        return Series(c)

    __rmul__ = __mul__

    def __pow__(self, power: int) -> Series:
        if power != 2:
            raise ValueError(f"only squares are needed, got the power {power}")
        return self * self

    def sin(self) -> Series:
        """Sine; numpy calls it for arrays of such elements."""
        return self._sine_cosine()[0]

    def cos(self) -> Series:
        """Cosine; numpy calls it for arrays of such elements."""
        return self._sine_cosine()[1]

    def _sine_cosine(self) -> tuple[Series, Series]:
        """From s' = a' c and c' = -a' s, order by order."""
        a, s, c = self.c, np.zeros_like(self.c), np.zeros_like(self.c)
        s[0, 0], c[0, 0] = np.sin(a[0, 0]), np.cos(a[0, 0])
        s[0, 1:], c[0, 1:] = c[0, 0] * a[0, 1:], -s[0, 0] * a[0, 1:]
        for k in range(1, len(a)):
            for j in range(1, k + 1):
                s[k] += j / k * _product(a[j], c[k - j])
                c[k] -= j / k * _product(a[j], s[k - j])
        return Series(s), Series(c)


def _product(a: Array, b: Array) -> Array:
    """Product of two values with their derivatives, shape (9, ...)."""
    c: Array = a[0] * b
    c[1:] += a[1:] * b[0]
    return c


class Flow(NamedTuple):
    """Taylor coefficients in time of the motion from x under a constant input.

    Attributes:
        x: Of the state, shape (order + 1, ..., 8).
        Phi: Of its derivative by the starting state, shape (order + 1, ..., 8, 8).
        g: Of the input map along the motion, shape (order + 1, ..., 8, 2).
    """

    x: Array
    Phi: Array
    g: Array


def flow(model: BallPlate, x: Array, order: int, u: Sequence[float] = (0.0, 0.0)) -> Flow:
    """Expand the motion from the states x, shape (..., 8), to an order in time.

    Args:
        model: The exact model (5.9).
        x: Starting states, shape (..., 8).
        order: Highest power of t.
        u: Constant input in rad/s^2.
    """
    c = np.zeros((order + 1, 9, 8, *x.shape[:-1]))
    c[0, 0] = np.moveaxis(x, -1, 0)
    for i in range(8):
        c[0, 1 + i, i] = 1
    for k in range(order):
        c[k + 1] = _rate(model, c[: k + 1], u)[k] / (k + 1)
    drift = _rate(model, c, u)[:, 0]
    ahead = [_rate(model, c, np.add(u, unit))[:, 0] - drift for unit in np.eye(2)]
    return Flow(
        x=np.moveaxis(c[:, 0], 1, -1),
        Phi=np.moveaxis(c[:, 1:], (2, 1), (-2, -1)),
        g=np.moveaxis(np.array(ahead), (0, 2), (-1, -2)),
    )


def _rate(model: BallPlate, c: Array, u: Sequence[float] | Array) -> Array:
    """Series of f + g u along a motion given by its series, shape (order + 1, 9, 8, ...)."""
    state: Any = np.array([Series(c[:, :, i]) for i in range(8)], dtype=object)
    rates = model.derivative(state, np.asarray(u, dtype=float))
    out = np.zeros_like(c)
    for i, rate in enumerate(rates):
        if isinstance(rate, Series):
            out[:, :, i] = rate.c
        else:
            out[0, 0, i] = rate
    return out
