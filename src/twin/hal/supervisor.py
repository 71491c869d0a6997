"""The supervisor: says when a rig may move and how far, fast and hard it may be told to."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]


class State(IntEnum):
    """What a rig is allowed to do.

    DISABLED: drives off. READY: drives on, plate held, waiting for an explicit start.
    RUNNING: follows the controller. STOPPED: a limit was passed; the plate is being levelled.
    """

    DISABLED = 0
    READY = 1
    RUNNING = 2
    STOPPED = 3


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a rig may be told to do, and where its ball may be; SI units.

    Attributes:
        angle: Plate angle either way, rad; thesis chapter 3: 10 deg.
        rate: Plate rate either way, rad/s; assumed, the thesis limits it without a number.
        acceleration: Plate acceleration either way, rad/s^2; thesis chapter 3: 7.
        area: Operating area |x|, |y| of references, m; thesis chapter 3: 0.25 x 0.15.
        margin: How far the ball may stray beyond the area before the rig stops, m; assumed.
    """

    angle: float = np.pi / 18
    rate: float = 0.6
    acceleration: float = 7.0
    area: tuple[float, float] = (0.25, 0.15)
    margin: float = 0.04


class Supervisor:
    """Guards N rigs: one state each, one set of limits.

    Args:
        limits: What may be commanded.
        period: Control period in s.
        rigs: Number of rigs.
    """

    ANGLE_SLACK = np.radians(0.5)
    """How far a measured plate angle may pass the limit (encoder, spring) before a stop."""

    DRIFT_TIME = 0.1
    """Time in s within which a measured drift of the plate off its commands is taken in."""

    def __init__(self, limits: Limits, period: float, rigs: int = 1) -> None:
        self.limits = limits
        self.state = np.full(rigs, State.DISABLED)
        self.reason = [""] * rigs
        self.rate: Array = np.zeros((rigs, 2))
        """Plate rate commanded last, rad/s."""
        self.angle: Array = np.zeros((rigs, 2))
        """Plate angle: the commanded rates added up, drawn to the measured angle, rad."""
        self._period = period
        reach = np.add(limits.area, limits.margin)
        tilt = limits.angle + self.ANGLE_SLACK
        self._bounds = np.array([reach[0], tilt, reach[1], tilt])
        self.all_running = False
        """Whether every rig follows its controller."""
        self._trust = period / self.DRIFT_TIME
        self._step = limits.acceleration * period
        self._half_step = self._step / 2
        self._whole_way = 2 * limits.acceleration * limits.angle
        self._per_angle = 2 * limits.acceleration * np.array([1.0, -1.0])[:, None, None]
        self._least, self._most = self._half_step**2, (limits.rate + self._half_step) ** 2

    def enable(self, plate: Array) -> None:
        """Switch on: hold the plate at its measured angles (N, 2) until the start."""
        self.angle = np.array(plate)
        self.rate = np.zeros_like(self.angle)
        self.state[:] = State.READY

    def start(self) -> None:
        """Let the rigs that are ready follow their controller."""
        self.state[self.state == State.READY] = State.RUNNING
        self.all_running = bool((self.state == State.RUNNING).all())

    def level(self) -> None:
        """Stop every rig that is on: its plate is brought level whatever the controller says."""
        self.state[self.state != State.DISABLED] = State.STOPPED
        self.all_running = False

    def disable(self) -> None:
        """Switch off: nothing is commanded any more."""
        self.state[:] = State.DISABLED
        self.all_running = False

    def watch(self, y: Array) -> None:
        """Stop the running rigs whose measured ball or plate passed a limit.

        Args:
            y: Measured x, phi, y, theta in m and rad, shape (N, 4).
        """
        self.angle = self.angle + self._trust * (y[:, 1::2] - self.angle)
        beyond = np.abs(y) > self._bounds
        if beyond.any():
            ball, plate = beyond[:, 0::2].any(axis=1), beyond[:, 1::2].any(axis=1)
            self._stop(ball, y[:, 0::2], "ball at ({:.3f}, {:.3f}) m left the area")
            self._stop(plate, y[:, 1::2], "plate at ({:.3f}, {:.3f}) rad past its limit")

    def clamp(self, rate: Array) -> Array:
        """The plate rates that may be commanded for the wished ones, both rad/s, (N, 2).

        The result keeps within rate and acceleration limits, and within what can still be braked
        before the angle limit.
        """
        if not np.isfinite(rate).all():
            bad = np.asarray(~np.isfinite(rate).all(axis=-1))
            self._stop(bad, rate, "controller asked for ({}, {}) rad/s")
            rate = np.where(bad[:, None], 0.0, rate)
        if not self.all_running:
            rate = self._overrule(rate)
        # A rate v braked by one step a period covers at most (v + step / 2)^2 / (2 a), so this is
        # the square of v + step / 2 that the way to the angle limit allows, upwards and downwards.
        square = self._whole_way - self._per_angle * self.angle
        square = np.minimum(np.maximum(square, self._least), self._most)
        up, down = np.sqrt(square) - self._half_step
        rate = np.minimum(np.maximum(rate, -down), up)
        rate = np.minimum(np.maximum(rate, self.rate - self._step), self.rate + self._step)
        self.rate = rate
        self.angle = self.angle + self._period * rate
        return rate

    def _overrule(self, rate: Array) -> Array:
        """Level the plate where stopped, hold it where not running."""
        state = self.state[:, None]
        level = -np.sign(self.angle) * np.minimum(
            np.sqrt(self.limits.acceleration * np.abs(self.angle)),
            np.abs(self.angle) / (10 * self._period),
        )
        held = np.where(state == State.STOPPED, level, 0.0)
        return np.where(state == State.RUNNING, rate, held)

    def _stop(self, which: Mask | np.bool_, values: Array, reason: str) -> None:
        for rig in np.flatnonzero(which & (self.state == State.RUNNING)):
            self.state[rig] = State.STOPPED
            self.reason[rig] = reason.format(*values[rig])
            self.all_running = False
