"""Steps done with drives outside of a run: exchange, turn the shafts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.servos import AkdServos
from twin.hal.interface import Transmission


def turn(servos: AkdServos, start: Array, end: Array, seconds: float = 1.0) -> bool:
    """Turn the shafts from one angle to another, smoothly; whether the drives kept going."""
    begin = servos.now()
    while servos.enabled and (gone := servos.now() - begin) < seconds + 0.3:
        # half a cosine: from rest to rest
        share = (1 - np.cos(np.pi * min(1.0, gone / seconds))) / 2
        servos.command(20 * (start + share * (end - start) - servos.motor()))
        exchange(servos, servos.config.period)
    servos.command(np.zeros((1, 2)))
    exchange(servos, 0.05)
    return servos.enabled


def enable(servos: AkdServos) -> None:
    """Ask for torque, and exchange until both drives have it, at most for a second."""
    servos.enable()
    until(servos, lambda: servos.enabled, 1.0)


def hold_level(servos: AkdServos, cams: Transmission) -> Array:
    """Ask for torque, and take the plate as level; level plate angles in rad, shape (1, 2)."""
    enable(servos)
    level = np.zeros((1, 2))
    servos.home(level, cams.motor(level))
    return level


def stopped_by(servos: AkdServos) -> str:
    """The first fault that is more than a warning; empty if there is none."""
    return next((str(f) for f in servos.faults() if f.condition.severity != "warning"), "")


def until(servos: AkdServos, done: Callable[[], bool], limit: float) -> None:
    """Exchange until something is done, at most for a time in s."""
    end = servos.now() + limit
    while not done() and servos.now() < end:
        exchange(servos, servos.config.period)


def exchange(servos: AkdServos, seconds: float) -> None:
    """Exchange with the drives for a time, one period after the other."""
    period = servos.config.period
    for _ in range(max(1, round(seconds / period))):
        begin = servos.now()
        servos.receive()
        servos.send()
        servos.settle(period / 2)
        servos.sleep(max(0.0, begin + period - servos.now()))
