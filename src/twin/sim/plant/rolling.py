"""The rows of the ball in the exact model (5.9), gathered for a plate whose motion is given."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from controllers.ballplate import BallPlate


class Rolling(NamedTuple):
    """The ball's equations at an instant at which the plate's motion is given.

    They are linear in the ball's own position and velocity (plate axes, m and m/s)::

        x'' = xx x + xy y + turn y' + px
        y'' = yx x + yy y - turn x' + py

    Numbers for one rig, arrays of one shape for several.
    """

    xx: Any
    xy: Any
    yx: Any
    yy: Any
    """Coefficients of the position in 1/s^2."""
    turn: Any
    """Coefficient of the velocity in 1/s."""
    px: Any
    py: Any
    """What is left of a ball at rest on the middle, m/s^2."""
    normal: Any
    """Force per mass that presses the ball on the plate, without the plate's motion, m/s^2."""


def rolling(
    model: BallPlate,
    sines: Iterable[Any],
    cosines: Iterable[Any],
    rates: Iterable[Any],
    u: Iterable[Any],
    gravity: Iterable[Any],
) -> Rolling:
    """Rows x'' and y'' of (5.9a) gathered for the ball, where the plate's motion is given.

    Each argument is taken apart into plain numbers, or arrays of one shape, per component.

    Args:
        model: Ball and plate.
        sines: Of (phi, theta).
        cosines: Of (phi, theta).
        rates: (phi', theta') in rad/s.
        u: (phi'', theta'') in rad/s^2.
        gravity: Gravity (x, y, z) in the axes of the base, m/s^2; (0, 0, -g) if it is level.
    """
    (s3, s7), (c3, c7), (wy, w7), (u1, u2) = sines, cosines, rates, u
    gx, gy, gz = gravity
    wx, wz, down = w7 * c3, w7 * s3, c7 * gz - s7 * gy
    c1, xy = model.c1, model.c1 * s3 * u2
    return Rolling(
        c1 * (wz * wz + wy * wy),
        xy,
        -2 * c1 * wx * wy - xy,
        c1 * w7 * w7,
        2 * c1 * wz,
        c1 * (c3 * gx - s3 * down - model.d * wx * wz) - model.c2 * u1,
        c1 * (c7 * gy + s7 * gz - model.c3 * wy * wz) + model.c2 * c3 * u2,
        -s3 * gx - c3 * down,
    )
