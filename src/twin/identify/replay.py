"""Replays the ball of many windows and many parameter sets at once over the plate's motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.sim.plant.friction import Friction

STEP = 0.004
"""Step of the replay in s."""
PACE = 0.02
"""Seconds between the speeds before a replay that it is told of."""


class AccelerationField(NamedTuple):
    """Acceleration of the ball in W windows at N steps, affine in its position p and velocity v.

    v' = push + own p + cross s(p) + turn s(v) + tilt level, where s() swaps the axes.

    Attributes:
        push: m/s^2, shape (N, 2, 1, W).
        own: 1/s^2, same shape.
        cross: 1/s^2, same shape.
        turn: 1/s, same shape.
        tilt: What a tilt of the base adds along its own axis, m/s^2 per rad, same shape.
        normal: Normal force per mass, m/s^2, shape (N, 1, W).
    """

    push: Array
    own: Array
    cross: Array
    turn: Array
    tilt: Array
    normal: Array

    @classmethod
    def of(cls, model: BallPlate, angle: Array, rate: Array) -> AccelerationField:
        """The field over plate angles and rates (phi, theta), shape (W, N, 2), in rad and rad/s.

        The exact model is affine in the ball's state, so five evaluations determine it.
        """
        x = np.zeros((*angle.shape[:-1], 8))
        x[..., 2::4], x[..., 3::4] = angle, rate
        u = np.gradient(rate, STEP, axis=-2)

        def acceleration(index: int | None = None, shift: float = 0.0) -> Array:
            there = x.copy()
            there[..., 2::4] += shift
            if index is not None:
                there[..., index] += 1.0
            return np.asarray(model.derivative(there, u)[..., 1::4])

        push = acceleration()
        by = {index: acceleration(index) - push for index in (0, 1, 4, 5)}
        pairs = {"own": (by[0], by[4]), "cross": (by[4], by[0]), "turn": (by[5], by[1])}
        parts: dict[str, Array] = {
            name: np.stack((first[..., 0], second[..., 1]), axis=-1)
            for name, (first, second) in pairs.items()
        }
        shift = 1e-4
        parts["tilt"] = (acceleration(shift=shift) - acceleration(shift=-shift)) / (2 * shift)
        parts["push"] = push
        normal = model.gravity * np.cos(angle[..., 0]) * np.cos(angle[..., 1])
        return cls(
            **{name: _steps_first(values) for name, values in parts.items()},
            normal=np.ascontiguousarray(normal.T)[:, None],
        )


def replay(
    field: AccelerationField,
    model: BallPlate,
    friction: Friction,
    level: Array,
    start: Array,
    grip: float = 0.0,
    gain: Array | float = 1.0,
    paces: Array | None = None,
) -> tuple[Array, Array]:
    """Positions and velocities of the ball, both shape (N, 2, C, W), in m and m/s.

    Heun's rule for the smooth forces; then rolling resistance takes as much as it can of what would
    bring the ball to rest within the time ``grip``: a ball it can hold rests exactly.

    Args:
        field: The windows.
        model: Ball parameters.
        friction: Rolling resistance of C candidates: numbers, or arrays of shape (C, 1).
        level: Tilt of the base (phi, theta) in rad, shape (2, C, 1).
        start: Position and velocity at the first step, shape (4, C, W): x, y, x', y'.
        grip: Time in s within which resistance would stop the ball if it were strong enough; 0
            for at once, as Coulomb's law has it.
        gain: Factor on what the plate's tilt and acceleration do to the ball: a number, or one per
            candidate, shape (C, 1).
        paces: Speeds of the ball before the first step, ``PACE`` apart, m/s, shape (W, K), on which
            depends how long it rested; None for one that has long gone at its first speed.
    """
    h, steps = STEP, len(field.push)
    p, v = start[:2], start[2:]
    places, speeds = np.empty((2, steps, *p.shape))
    places[0], speeds[0] = p, v
    speed = np.hypot(v[0], v[1])
    age = _age_at_start(friction, speed, paces) if friction.ageing else None
    per_arm = (model.c1 / model.radius) * field.normal
    grip = max(grip, h)
    # arrays that are written again in every step: making them anew would cost as much as the sums
    a, later, pull, spare = np.empty((4, *p.shape))

    def forced(n: int) -> tuple[Array, Array]:
        return gain * field.push[n], gain * (field.tilt[n] * level)

    def free(n: int, p: Array, v: Array, by: tuple[Array, Array], out: Array) -> Array:
        np.multiply(field.own[n], p, out=out)
        out += by[0]
        out += np.multiply(field.cross[n], p[::-1], out=spare)
        out += np.multiply(field.turn[n], v[::-1], out=spare)
        out += by[1]
        return out

    def slowed(v: Array, most: Array) -> Array:
        taken = np.minimum(1.0, most / strength)
        np.subtract(a, np.multiply(pull, taken, out=spare), out=spare)
        return np.asarray(v + np.multiply(h, spare, out=spare))

    constant = friction.constant
    here = forced(0)
    for n in range(steps - 1):
        free(n, p, v, here, a)
        here = forced(n + 1)
        a += free(n + 1, p + h * v, v + h * a, here, later)
        a /= 2
        np.divide(v, grip, out=pull)
        pull += a
        strength = np.maximum(np.hypot(pull[0], pull[1]), 1e-300)
        place = p if friction.map is None else np.moveaxis(p, 0, -1)
        most = per_arm[n] * friction.arm(speed, place, age)
        after = slowed(v, most)
        left = np.hypot(after[0], after[1])
        if not constant:
            most = np.where(
                left > 0, per_arm[n] * friction.arm((speed + left) / 2, place, age), most
            )
            after = slowed(v, most)
            left = np.hypot(after[0], after[1])
        if age is not None:
            age = friction.aged(age, (speed + left) / 2, h)
        p = p + (h / 2) * (v + after)
        v, speed = after, left
        places[n + 1], speeds[n + 1] = p, v
    return places, speeds


def _age_at_start(friction: Friction, speed: Array, paces: Array | None) -> Array:
    """Age of contacts of speeds in m/s, shape (C, W), that have gone at ``paces`` before."""
    if paces is None:
        return friction.settled(speed)
    any_lane = np.zeros_like(speed)
    age = friction.settled(any_lane + paces[:, 0])
    for pace in paces.T:
        age = friction.aged(age, any_lane + pace, PACE)
    return age


def _steps_first(values: Array) -> Array:
    """From (W, N, 2) to (N, 2, 1, W)."""
    return np.ascontiguousarray(np.moveaxis(values, (1, 2), (0, 1))[:, :, None])
