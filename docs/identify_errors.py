"""Makes identify_errors.md: what identify says of rigs that its model does not describe.

uv run python docs/identify_errors.py

One axis of a rig with one error of the model each, simulated without any of the twin's code. A
plain model of five numbers is fitted by scipy for comparison.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array

STEP_S = 1e-3
"""Step of the simulation."""


@dataclass(frozen=True, kw_only=True)
class Rig:
    """An axis of a rig in SI units: a solid ball on a plate or beam, or in a tube.

    Attributes:
        seconds: Length of the log.
        rate: Positions in 1/s.
        gain: Acceleration by the tilt, m/s^2 by rad.
        dead_time: Half of it before the servo, half behind the camera.
        lag: Of the servo.
        friction: Against the direction of the ball, m/s^2.
        viscous: 1/s.
        level: m/s^2.
        noise: Standard deviation of a position.
        pixel: Step of the positions; 0 for none.
        stop: Distance of the end stops from the middle.
        restitution: Of a bounce.
        nervous: Whether the controller is one that drives the ball from stop to stop.
        play: Width of the gap between servo and plate, rad.
        filtered: Time constant of a filter of the positions.
        drift: By how much the clock of the positions goes faster, as a share.
        irregular: By what share of a period the times of the positions are off.
        command_step: Step of the commands, rad.
        softening: Share of the gain that is lost by rad of tilt.
        presliding: Way over which friction builds up, as Dahl has it.
    """

    seconds: float = 45.0
    rate: float = 60.0
    gain: float = 7.007
    dead_time: float = 0.05
    lag: float = 0.05
    friction: float = 0.025
    viscous: float = 0.0
    level: float = 0.0
    noise: float = 4e-4
    pixel: float = 0.0
    stop: float = math.inf
    restitution: float = 0.3
    nervous: bool = False
    play: float = 0.0
    filtered: float = 0.0
    drift: float = 0.0
    irregular: float = 0.0
    command_step: float = 0.0
    softening: float = 0.0
    presliding: float = 0.0


TUBE = Rig(
    seconds=72.0,
    rate=100.0,
    gain=7.0,
    dead_time=0.04,
    lag=0.0,
    friction=0.05,
    noise=5e-4,
    pixel=1e-3,
    stop=0.04,
    nervous=True,
)
"""A steel ball in a tube of 8 cm, with a sensor of its distance, as teaching rigs have it."""


def simulate_log(seed: int, rig: Rig, across: Array | None = None) -> tuple[Array, ...]:
    """Times of commands and of positions in s, positions in m, commands and plate angles in rad.

    Semi-implicit Euler at 1 ms. The controller, proportional and differential on noisy positions,
    follows steps and sines that change with the seed.

    Args:
        seed: Of noise and motion.
        rig: What is simulated.
        across: Acceleration by the plate's other axis, m/s^2, at each step.
    """
    rng, h = np.random.default_rng(seed), STEP_S
    steps = round(rig.seconds / h)
    after = round(rig.dead_time / 2 / h)
    before = round(rig.dead_time / h) - after
    x, v, servo, plate, seen, bristle = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    shown, sent, angles = np.zeros((3, steps))
    due, until, target, command, last, speed, then = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    slow = 1 / (1 + 4 * (rig.dead_time + rig.lag))
    rows = []
    for k in range(steps):
        t = k * h
        seen = seen + h / rig.filtered * (x - seen) if rig.filtered else x
        shown[k] = seen
        if t >= due:
            place = shown[max(0, k - after)] + rig.noise * rng.standard_normal()
            place = round(place / rig.pixel) * rig.pixel if rig.pixel else place
            passed = max(t - then, h)
            speed += min(1.0, passed / 0.08) * ((place - last) / passed - speed)
            last, then = place, t
            if t >= until:
                target, until = rng.uniform(-1, 1), t + rng.uniform(0.5, 2.0)
            if rig.nervous:
                command = 2 * (0.08 * target - place) - 0.35 * speed
                command = min(max(command + 0.03 * math.sin(3.1 * t + seed), -0.25), 0.25)
            else:
                command = slow * (0.9 * (0.06 * target - place) - 0.45 * slow * speed)
                command += 0.02 * math.sin(2.1 * t) + 0.015 * math.sin(5.3 * t + seed)
                command = min(max(command, -0.14), 0.14)
            if rig.command_step:
                command = round(command / rig.command_step) * rig.command_step
            rows.append((t, place, command))
            due += (1 + rig.irregular * rng.uniform(-1, 1)) / rig.rate
        sent[k] = command
        wanted = sent[max(0, k - before)]
        servo += h / rig.lag * (wanted - servo) if rig.lag else wanted - servo
        plate = min(max(plate, servo - rig.play / 2), servo + rig.play / 2)
        angles[k] = plate
        push = rig.gain * plate * (1 - rig.softening * abs(plate)) + rig.level - rig.viscous * v
        push += 0.0 if across is None else across[k]
        if rig.presliding:
            bristle += h * v * (1 - math.copysign(bristle, v * bristle)) / rig.presliding
            bristle = min(max(bristle, -1.0), 1.0)
            v += h * (push - rig.friction * bristle)
        else:
            v += h * push
            v -= math.copysign(min(abs(v), h * rig.friction), v)
        x += h * v
        if abs(x) > rig.stop:
            x, v = math.copysign(rig.stop, x), -rig.restitution * v
    time, ball, commands = np.array(rows).T
    return time, time * (1 + rig.drift), ball, commands, angles
