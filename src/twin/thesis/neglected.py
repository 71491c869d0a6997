"""How large the terms are that the flat model (6.44) leaves out, (6.42) and Figure 8.6."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.analysis import PlainRow, number
from controllers.arrays import Array
from controllers.ballplate import ACCELERATION, BallPlate


class Terms(NamedTuple):
    """Accelerations over c1 along a motion, each of shape (..., 2) for x and y, in m/s^2.

    Attributes:
        main: g sin(phi) and -g sin(theta), the right of (6.42).
        neglected: Centrifugal and gyroscopic terms, the left of (6.42).
        unlisted: What (6.44) leaves out and (6.42) does not name: the plate accelerations and
            cos(theta) beside sin(phi).
    """

    main: Array
    neglected: Array
    unlisted: Array


class Size(NamedTuple):
    """Size of terms beside the main ones over a motion, each of shape (2,) for x and y.

    Attributes:
        largest: Largest magnitude in m/s^2.
        peak_ratio: Largest magnitude over the largest of the main term.
        rms_ratio: Root mean square over that of the main term.
    """

    largest: Array
    peak_ratio: Array
    rms_ratio: Array


def terms(model: BallPlate, x: Array, u: Array) -> Terms:
    """Split the ball's acceleration along a motion.

    Args:
        model: The exact model.
        x: States, shape (..., 8).
        u: Plate accelerations in rad/s^2, shape (..., 2).
    """
    exact = model.derivative(x, u)[..., ACCELERATION] / model.c1
    main = model.flat(x, u)[..., ACCELERATION] / model.c1
    drift = model.f(x)[..., ACCELERATION] / model.c1
    gravity = main.copy()
    gravity[..., 0] *= np.cos(x[..., 6])
    return Terms(main, drift - gravity, exact - main - (drift - gravity))


def size(part: Array, main: Array) -> Size:
    """Compare a part of the acceleration with the main term.

    The ratio at each instant, as (6.42) reads, has no bound: both sides pass through zero, and not
    together. Hence peaks and root mean squares; a ratio to a main term of zero is infinite or nan.

    Args:
        part: Along a motion, shape (K, 2).
        main: The same, shape (K, 2).
    """
    peaks = np.abs(part).max(axis=0), np.abs(main).max(axis=0)
    squares = (part**2).mean(axis=0), (main**2).mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Size(peaks[0], peaks[0] / peaks[1], np.sqrt(squares[0] / squares[1]))


def neglected_rows(model: BallPlate, x: Array, u: Array) -> list[PlainRow]:
    """Terms the flat model leaves out beside the main ones along a motion, (6.42).

    Args:
        model: The exact model.
        x: States, shape (K, 8).
        u: Plate accelerations in rad/s^2, shape (K, 2).
    """
    parts = terms(model, x, u)
    rows = []
    for axis, equation in enumerate(("6.42a", "6.42b")):
        for name in ("neglected", "unlisted"):
            found = size(getattr(parts, name), parts.main)
            rows.append(
                {
                    "equation": equation,
                    "terms": name,
                    "main_max": number(np.abs(parts.main[:, axis]).max()),
                    "max": number(found.largest[axis]),
                    "peak_ratio": number(found.peak_ratio[axis]),
                    "rms_ratio": number(found.rms_ratio[axis]),
                }
            )
    return rows
