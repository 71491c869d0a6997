"""Poles of an axis: what a scenario may ask for, and the polynomial they are the roots of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from controllers.interfaces import Array

Pole = float | complex
"""A pole in 1/s as a scenario writes it: a number such as -2, or the text "-2+1j"."""


def stable_poles(poles: Sequence[Pole], count: int) -> tuple[Pole, ...]:
    """The poles as numbers, if they can be the poles of a real, stable system.

    Args:
        poles: Numbers, or text such as "-2+1j"; complex ones in conjugate pairs, in any order.
        count: How many there must be.

    Raises:
        ValueError: If their number is wrong, one is not left of the imaginary axis, or a complex
            one lacks its conjugate.
    """
    try:
        numbers = tuple(complex(pole) for pole in poles)
    except (TypeError, ValueError):
        raise ValueError(f"poles must be numbers such as -2 or '-2+1j', got {poles}") from None
    if len(numbers) != count:
        raise ValueError(f"poles must be {count} numbers, got {len(numbers)}")
    for pole in numbers:
        if not (np.isfinite(pole) and pole.real < 0):
            raise ValueError(f"poles must have a negative real part, got {listed([pole])}")
        if numbers.count(pole) != numbers.count(pole.conjugate()):
            raise ValueError(f"poles must come in conjugate pairs, got {listed(numbers)}")
    return tuple(pole if pole.imag else pole.real for pole in numbers)


def require_stable(coefficients: Array, gains: Sequence[float]) -> None:
    """Make sure that s^n + ... + c1 s + c0 has all its roots left of the imaginary axis.

    Args:
        coefficients: c0, c1, ... of the polynomial.
        gains: The setting they come from, for the message.

    Raises:
        ValueError: If a root is not there; the message names the roots.
    """
    poles = np.roots((1.0, *coefficients[::-1])).tolist()
    if not all(pole.real < 0 for pole in poles):
        raise ValueError(f"gains {listed(gains)} are unstable: they give the poles {listed(poles)}")


def gains_from(poles: Sequence[Pole]) -> Array:
    """Coefficients p0, p1, ... of the polynomial s^n + ... + p1 s + p0 with these roots, (6.56)."""
    return np.poly(poles)[:0:-1].real


def listed(numbers: Iterable[Pole]) -> str:
    """The numbers as a short text."""
    return ", ".join(f"{p:.4g}" if p.imag else f"{p.real:.4g}" for p in numbers)
