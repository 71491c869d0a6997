"""The ball as the tilting plate sees it, and gravity as a base that is not level sees it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from controllers.arrays import Array


def tilted_gravity(level: ArrayLike, gravity: float) -> Array:
    """Gravity in the axes of a rig that stands tilted, m/s^2, shape (..., 3).

    Args:
        level: Tilt of the base about y and x, (phi, theta) in rad, shape (..., 2), with the signs
            of the plate's own angles: positive phi lowers the +x side, positive theta lifts +y.
        gravity: Its amount in m/s^2.
    """
    angles = np.moveaxis(np.asarray(level, float), -1, 0)
    return np.stack(gravity_in_rig(np.sin(angles), np.cos(angles), gravity), axis=-1)


def gravity_in_rig(sines: Any, cosines: Any, gravity: Any) -> tuple[Any, Any, Any]:
    """The same from sines and cosines of the tilt (phi, theta); also of symbols."""
    (s_phi, s_theta), (c_phi, c_theta) = sines, cosines
    return gravity * s_phi * c_theta, -gravity * s_theta, -gravity * c_phi * c_theta


def from_plate(vector: Array, phi: Array, theta: Array) -> Array:
    """A vector of plate axes in rig axes, R v with R = Rx(theta) Ry(phi), shape (..., 3)."""
    a, b, c = vector[..., 0], vector[..., 1], vector[..., 2]
    x = np.cos(phi) * a + np.sin(phi) * c
    z = np.cos(phi) * c - np.sin(phi) * a
    y = np.cos(theta) * b - np.sin(theta) * z
    return np.stack((x, y, np.sin(theta) * b + np.cos(theta) * z), axis=-1)


def ball_in_plate(plate: Array, plate_rate: Array, ball: Array, ball_rate: Array) -> Array:
    """Position and velocity of the ball in plate axes, (x, y, z, x', y', z').

    Plate axes are those of R = Rx(theta) Ry(phi) (4.5), so the position is R' r, and its rate
    R' (v - w x r) with the plate's angular velocity w = (theta', phi' cos theta, phi' sin theta)
    in world axes.

    Args:
        plate: Plate angles (phi, theta) in rad, shape (2, N).
        plate_rate: Their rates in rad/s, shape (2, N).
        ball: Ball centre in world axes from the cardan joint, m, shape (3, N).
        ball_rate: Its velocity in world axes, m/s, shape (3, N).

    Returns:
        Shape (6, N), in m and m/s.
    """
    sin_phi, sin_theta = np.sin(plate)
    cos_phi, cos_theta = np.cos(plate)
    phi_rate, theta_rate = plate_rate
    across, along = phi_rate * cos_theta, phi_rate * sin_theta
    x, y, z = ball
    # Velocity relative to the turning plate, still in world axes.
    vx = ball_rate[0] - across * z + along * y
    vy = ball_rate[1] - along * x + theta_rate * z
    vz = ball_rate[2] - theta_rate * y + across * x
    out = np.empty((6, plate.shape[1]))
    for first, (along_x, along_y, along_z) in ((0, ball), (3, (vx, vy, vz))):
        down = cos_theta * along_z - sin_theta * along_y
        out[first] = cos_phi * along_x - sin_phi * down
        out[first + 1] = cos_theta * along_y + sin_theta * along_z
        out[first + 2] = sin_phi * along_x + cos_phi * down
    return out


def rolling_ball(
    plate: Array, plate_rate: Array, ball: Array, height: Array, radius: Array
) -> tuple[Array, Array, Array]:
    """Position, velocity and angular velocity in world axes of balls that roll on the plate.

    Args:
        plate: Plate angles (phi, theta) in rad, shape (2, N).
        plate_rate: Their rates in rad/s, shape (2, N).
        ball: (x, x', y, y') in plate axes, m and m/s, shape (4, N).
        height: Of their centres over the cardan joint, m, shape (N,).
        radius: Of the balls, m, shape (N,).

    Returns:
        Three arrays (N, 3), in m, m/s and rad/s.
    """
    (phi, theta), (phi_rate, theta_rate) = plate, plate_rate
    x, vx, y, vy = ball
    zero = np.zeros_like(height)
    centre = from_plate(np.stack((x, y, height), axis=-1), phi, theta)
    # the plate's own angular velocity
    turn = np.stack((theta_rate, phi_rate * np.cos(theta), phi_rate * np.sin(theta)), axis=-1)
    along = from_plate(np.stack((vx, vy, zero), axis=-1), phi, theta)
    roll = from_plate(np.stack((-vy / radius, vx / radius, zero), axis=-1), phi, theta)
    return centre, along + np.cross(turn, centre), turn + roll
