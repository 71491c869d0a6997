"""Friction before it slides: a contact that gives way elastically until it has been bent far."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array


def bent(bend: Array, velocity: Array, time: float, distance: Array) -> Array:
    """How far a contact is bent after a time at a constant velocity.

    The model of Dahl (1968) in the plane: with the velocity v and the presliding distance s,

        z' = v - |v| z / s,

    so that along a straight way w it is z = s n + (z(0) - s n) exp(-w / s), n the heading. The
    friction is then -F z / s: F itself against the velocity once the ball has come far, a spring
    of stiffness F / s about the place where the ball rests. It stores less than it is given. Known
    of the model: under a lasting push a ball that is shaken creeps, however small the push.

    Args:
        bend: z at the beginning, m, shape (..., 2).
        velocity: Of the ball on the screen, m/s, shape (..., 2).
        time: In s.
        distance: s in m, more than 0, shape (...,).

    Returns:
        z in m, shape (..., 2); never longer than s if it was not.
    """
    speed = np.sqrt((velocity * velocity).sum(axis=-1, keepdims=True))
    way, length = speed * time, np.asarray(distance)[..., None]
    heading = velocity / np.where(speed > 0, speed, 1.0)
    # 1 - exp without loss of digits: a resting ball bends by v t
    return np.asarray(bend - np.expm1(-way / length) * (length * heading - bend))
