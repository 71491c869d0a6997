"""The Smith predictor (7.19) around any observer."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from controllers.arrays import Array, NotNegative, some
from controllers.catalog import check_estimate
from controllers.interfaces import DelayedObserver, Measurement, Observer

BALL_SLICE = slice(0, None, 4)
"""The ball's position X_1 = (x, y) in the state (5.5)."""


@dataclass(kw_only=True)
class Smith(Observer):
    """Gives an observer the present ball position, computed from the one a dead time ago.

    The observer's own estimate is the predictor's model, x_m = xhat, so (7.19b) becomes

        X_1sp(t) = xhat_1(t) + X_1(t - tau) - xhat_1(t - tau):

    the observer is corrected by the delayed innovation, and nothing else is predicted. A good model
    without noise has no innovation, and the dead time disappears; else the observer's error passes
    through a loop with a dead time, which fast poles make oscillate: a Luenberger observer with the
    poles of (8.1) has damping 0.2 at 42 ms and is unstable above 56 ms.

    Past estimates are kept once a period and interpolated linearly, as for a dead time that is no
    multiple of the period. A position that has waited since it arrived, as between two frames of
    the screen, is compared with the estimate that much earlier.

    It wraps an observer, and has the ``name``, ``model`` and ``period`` of that observer.
    Start with the leading axes of the measurements.

    Raises:
        ValueError: If the delay is negative or not finite, or the observer makes up for it itself.
    """

    longest_wait: ClassVar[float] = 0.1
    """Time in s since its arrival after which a position counts as not touched."""

    observer: Observer
    """The observer that receives the prediction."""
    delay: NotNegative = 0.042
    """Dead time tau of the ball's position in s, Table A.2."""

    _past: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Take over the observer's model and period."""
        super().__post_init__()
        if isinstance(self.observer, DelayedObserver):
            name = self.observer.name
            raise ValueError(f"observer '{name}' makes up for the dead time itself: no predictor")
        self.model, self.period = self.observer.model, self.observer.period
        self.knows = self.observer.knows  # type: ignore[misc]
        self.name = self.observer.name  # type: ignore[misc]
        self._back = self.delay / self.period
        self.length = 3 + math.ceil(self._back + self.longest_wait / self.period)
        self._whole = math.floor(self._back + 1e-9)
        self._share = max(self._back - self._whole, 0.0)
        self._tick = 0

    def start(self, x: Array) -> None:
        """Begin at the state x with a ball that has been there all the time."""
        self.observer.start(x)
        self.x = self.observer.x
        self._tick = 0
        self._past = np.array(
            np.broadcast_to(self.x[..., BALL_SLICE], (self.length, *x.shape[:-1], 2))
        )

    def correct(self, measurement: Measurement) -> Array:
        """Take in plate angles of now and a ball position of a dead time ago."""
        ball = self.x[..., BALL_SLICE]
        slot = self._tick % self.length
        if not self._whole:  # else it is not read before it is corrected
            self._past[slot] = ball
        y = measurement.y.copy()
        position = y[..., 0::2]
        touched = measurement.touched
        if some(measurement.age):
            touched = touched & (measurement.age <= self.longest_wait)
            age = np.where(touched, measurement.age, 0)
            position += ball - self._look_back_each(self._back + age / self.period)
        else:
            position += ball - self._look_back()
        part = Measurement(measurement.time, y, measurement.age, touched, measurement.state)
        self.x = check_estimate(self.observer, self.observer.correct(part), y)
        self._past[slot] = self.x[..., BALL_SLICE]
        return self.x

    def predict(self, u: Array) -> None:
        """Carry the estimate one period ahead."""
        self.observer.predict(u)
        self.x = self.observer.x
        self._tick += 1

    @property
    def further(self) -> Array:
        """Quantities that the observer knows beyond the state, shape (..., len(knows))."""
        return self.observer.further

    @property
    def equivalent(self) -> Array:
        """The estimate as ``Feedback.equivalent`` has it, shape (..., 8)."""
        return self.observer.equivalent

    def _look_back(self) -> Array:
        """Estimated ball position a dead time ago, shape (..., 2)."""
        newer: Array = self._past[(self._tick - self._whole) % self.length]
        if self._share < 1e-9:
            return newer
        older: Array = self._past[(self._tick - self._whole - 1) % self.length]
        return newer + self._share * (older - newer)

    def _look_back_each(self, periods: Array) -> Array:
        """Estimated ball position a number of periods ago, each rig its own, shape (..., 2)."""
        if periods.size == 1:  # plain numbers for one rig, several times faster
            back = periods.item()
            first = math.floor(back + 1e-9)
            newer, older = (self._past[(self._tick - k) % self.length] for k in (first, first + 1))
            return np.asarray(newer + (back - first) * (older - newer))
        whole = np.floor(periods + 1e-9).astype(int)
        share = (periods - whole)[..., np.newaxis]
        slots = (self._tick - np.stack([whole, whole + 1])) % self.length
        newer, older = np.take_along_axis(self._past, slots[..., np.newaxis], axis=0)
        return newer + share * (older - newer)
