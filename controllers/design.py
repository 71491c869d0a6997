"""Tools of linear design: poles as a scenario writes them, sampling, and pole placement.

With two inputs, poles do not fix a gain: each eigenvector may lie anywhere in a plane. The search
turns them away from each other, pair by pair: A. L. Tits and Y. Yang, Globally convergent
algorithms for robust pole assignment by state feedback, IEEE Trans. Automatic Control 41 (1996),
1432-1452. It takes the steps of ``scipy.signal.place_poles`` and ends with its gain; importing that
takes as long as a fifth of a run, for it brings scipy.stats along.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from controllers.arrays import Array

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
            raise ValueError(f"poles must have a negative real part, got {format_numbers([pole])}")
        if numbers.count(pole) != numbers.count(pole.conjugate()):
            raise ValueError(f"poles must come in conjugate pairs, got {format_numbers(numbers)}")
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
        raise ValueError(
            f"gains {format_numbers(gains)} are unstable: "
            f"they give the poles {format_numbers(poles)}"
        )


def gains_from(poles: Sequence[Pole]) -> Array:
    """Coefficients p0, p1, ... of the polynomial s^n + ... + p1 s + p0 with these roots, (6.56)."""
    return np.poly(poles)[:0:-1].real


def format_numbers(numbers: Iterable[Pole]) -> str:
    """The numbers as a short text."""
    return ", ".join(f"{p:.4g}" if p.imag else f"{p.real:.4g}" for p in numbers)


def sample(A: Array, B: Array, T: float) -> tuple[Array, Array]:
    """Exact step x[k+1] = Ad x[k] + Bd u[k] of x' = A x + B u with u held over a period.

    Args:
        A: State matrix, shape (n, n).
        B: Input matrix, shape (n, m).
        T: Period in s.

    Returns:
        Ad, shape (n, n), and Bd, shape (n, m).
    """
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    step = scipy.linalg.expm(block * T)
    return step[:n, :n], step[:n, n:]


Complex = NDArray[Any]
"""Real or complex numbers."""

MAX_SWEEPS = 30
"""Most times that all pairs are turned."""
VOLUME_TOLERANCE = 1e-3
"""Relative change of the eigenvectors' volume in a sweep at which the search ends."""
SWEEP_PAIRS = {
    0: ((3, 0), (1, 2), (0, 1), (2, 3), (0, 2), (1, 3)),
    1: ((1, 0), (2, 3), (0, 1), (2, 3), (2, 3), (2, 3), (0, 1), (2, 3)),
    2: ((0, 1), (2, 3)) * 5,
}
"""The pairs of a sweep by the number of conjugate pairs among the poles, real poles first."""


def place_poles(A: Array, B: Array, poles: Sequence[Pole] | Array) -> Array:
    """Gain K that gives A - B K four poles, with eigenvectors that span a large volume.

    Args:
        A: State matrix, shape (4, 4).
        B: Input matrix with orthonormal columns, shape (4, 2).
        poles: Real or in conjugate pairs, none more than twice, shape (4,).

    Returns:
        Shape (2, 4).
    """
    real = sorted(pole.real for pole in poles if not pole.imag)
    lower = sorted((pole for pole in poles if pole.imag < 0), key=lambda p: (p.real, p.imag))
    unreached = scipy.linalg.qr(B)[0][:, 2:]
    planes: list[Complex] = []
    columns: list[Array] = []
    for pole in (*real, *lower):
        plane = scipy.linalg.qr((A - pole * np.eye(4)).T @ unreached)[0][:, 2:]
        begin = plane.sum(axis=1) / np.linalg.norm(plane.sum(axis=1))
        # a conjugate pair stands as real and imaginary part of one vector
        parts = (begin.real, begin.imag) if pole.imag else (begin,)
        columns += parts
        planes += [plane] * len(parts)
    X = np.stack(columns, axis=1)
    for _ in range(MAX_SWEEPS):
        before = abs(np.linalg.det(X))
        for i, j in SWEEP_PAIRS[len(lower)]:
            turn = _turn_eigenvectors if i < len(real) else _turned_conjugates
            others = scipy.linalg.qr(np.delete(X, (i, j), axis=1))[0]
            X[:, i], X[:, j] = turn(X[:, i], X[:, j], planes[i], planes[j], *others.T[2:])
        volume = abs(np.linalg.det(X))
        if abs(volume - before) < VOLUME_TOLERANCE * volume:
            break
    V = X.astype(complex)
    values = [complex(pole) for pole in real]
    for pole in lower:
        i = len(values)
        V[:, i], V[:, i + 1] = X[:, i] - 1j * X[:, i + 1], X[:, i] + 1j * X[:, i + 1]
        values += [pole, pole.conjugate()]
    closed = np.linalg.solve(V.T, np.diag(values) @ V.T).T
    return B.T @ (A - closed.real)


def _turn_eigenvectors(
    x: Array, y: Array, P: Array, Q: Array, u: Array, v: Array
) -> tuple[Array, Array]:
    """The eigenvectors x, y of two real poles in their planes P, Q that span most with the others.

    Args:
        x: Shape (4,).
        y: Shape (4,).
        P: Orthonormal columns, shape (4, 2).
        Q: Orthonormal columns, shape (4, 2).
        u: With v an orthonormal basis of what is orthogonal to the other two, shape (4,).
        v: Shape (4,).
    """
    left, size, right = np.linalg.svd(P.T @ (np.outer(u, v) - np.outer(v, u)) @ Q)
    if np.allclose(*size):
        basis = scipy.linalg.block_diag(P, Q) @ np.concatenate([left, right.T])
    else:
        basis = np.concatenate([P @ left[:, :1], Q @ right[:1].T])
    found = _nearest(np.concatenate([x, y]), basis, np.sqrt(2))
    return found[:4], found[4:]


def _turned_conjugates(
    x: Array, y: Array, P: Complex, _: Complex, u: Array, v: Array
) -> tuple[Array, Array]:
    """The same for a conjugate pair: real part x, imaginary part y, in the complex plane P."""
    w = np.sqrt(2) * (u + 1j * v)
    size, directions = np.linalg.eig(
        P.conj().T @ (np.outer(w, w.conj()) - np.outer(w.conj(), w)) @ P
    )
    largest = np.argsort(-np.abs(size))[: 2 if np.allclose(*np.abs(size)) else 1]
    found = _nearest(x + 1j * y, P @ directions[:, largest])
    return found.real, found.imag


def _nearest(x: Complex, basis: Complex, length: float = 1.0) -> Complex:
    """The projection of x on basis columns, made as long; the first of them if it is none."""
    near = basis @ basis.conj().T @ x
    chosen = basis[:, 0] if np.allclose(near, 0) else near
    return length * chosen / np.linalg.norm(chosen)
