"""What lies between a motor's angle and the plate's: play, hysteresis, a soft drive train.

Each part takes the angle by which its input turns in a control period and gives that by which its
output turns, both (N, 2) in rad; the output begins where the input does. ``acts`` says which rigs
have the part, shape (N, 1); of the others what it gives means nothing.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, put
from twin.sim.noise import Rigs


class TrainPart(Protocol):
    """A part of the drive train of N rigs."""

    acts: NDArray[np.bool_]

    def go_on(self, before: Any, rate: Array) -> None:
        """Begin in the state of another one of its kind.

        Args:
            before: That one.
            rate: Rates of the input in rad/s now, shape (N, 2).
        """

    def begin(self, rigs: Rigs) -> None:
        """Let some rigs begin as they were when they were made."""

    def follow(self, turn: Array) -> Array:
        """Turn of the output in rad for one of the input, both (N, 2)."""


class Play:
    """A gap: the output stands until the input has crossed it.

    Args:
        width: Of the gap in rad, shape (N, 1); 0 for none.
    """

    def __init__(self, width: Array) -> None:
        self._half = width / 2
        self.acts = width > 0
        self._input: Array = np.zeros((len(width), 2))
        self._output: Array = np.zeros((len(width), 2))

    def go_on(self, before: Play, rate: Array) -> None:
        """Begin in the state of another one."""
        del rate
        self._input, self._output = before._input, before._output

    def begin(self, rigs: Rigs) -> None:
        """Let some rigs begin in the middle of the gap."""
        self._input, self._output = put(self._input, rigs, 0.0), put(self._output, rigs, 0.0)

    def follow(self, turn: Array) -> Array:
        """Turn of the output in rad for one of the input."""
        self._input = self._input + turn
        moved = np.minimum(
            np.maximum(self._output, self._input - self._half), self._input + self._half
        )
        followed = moved - self._output
        self._output = moved
        return followed


class Hysteresis:
    """An elastic part that works against dry friction after Dahl: lost motion without a gap.

    With h the angle that is lost and s the input's, dh/ds = (1 - h sgn(s') / h_max) / 2: right
    after a reversal the output stands, then follows more and more; h_max is half the width of the
    loop of output over input, and the width is the way on which it changes over.

    Args:
        width: Of the loop in rad, shape (N, 1); 0 for none.
    """

    def __init__(self, width: Array) -> None:
        self.acts = width > 0
        self._width = width
        self._way = np.where(width > 0, width, 1.0)
        self._lost: Array = np.zeros((len(width), 2))

    def go_on(self, before: Hysteresis, rate: Array) -> None:
        """Begin in the state of another one."""
        del rate
        self._lost = before._lost

    def begin(self, rigs: Rigs) -> None:
        """Let some rigs begin with nothing lost."""
        self._lost = put(self._lost, rigs, 0.0)

    def follow(self, turn: Array) -> Array:
        """Turn of the output in rad for one of the input."""
        end = np.copysign(self._width / 2, turn)
        lost = end + (self._lost - end) * np.exp(-np.abs(turn) / self._way)
        followed: Array = turn - (lost - self._lost)
        self._lost = lost
        return followed


class Resonance:
    """A soft drive train: the plate swings about where the motor is, excited by the motor's motion.

    With d the plate's angle less the motor's, d'' + 2 zeta w d' + w^2 d = -(acceleration of the
    motor), solved exactly for motor rates that are constant over a period.

    Args:
        frequency: Of the undamped swing in Hz, shape (N, 1); 0 for a stiff train.
        damping: Ratio zeta below 1, shape (N, 1).
        period: Control period in s.
    """

    def __init__(self, frequency: Array, damping: Array, period: float) -> None:
        self.acts = frequency > 0
        w = 2 * math.pi * frequency
        decay, swing = damping * w, w * np.sqrt(1 - damping**2)
        fade = np.exp(-decay * period)
        cos = fade * np.cos(swing * period)
        # sin(swing t) / swing, which at 0 is t
        sine = fade * period * np.sinc(swing * period / math.pi)
        self._period = period
        self._angle = cos + decay * sine, sine
        self._rate = -(w**2) * sine, cos - decay * sine
        self._d: Array = np.zeros((len(frequency), 2))
        self._d_rate: Array = np.zeros((len(frequency), 2))
        self._motor_rate: Array = np.zeros((len(frequency), 2))

    def go_on(self, before: Resonance, rate: Array) -> None:
        """Begin in the state of another one, at input rates in rad/s, shape (N, 2)."""
        self._d, self._d_rate = before._d, before._d_rate
        self._motor_rate = np.where(before.acts, before._motor_rate, rate)

    def begin(self, rigs: Rigs) -> None:
        """Let some rigs begin at rest."""
        self._d, self._d_rate = put(self._d, rigs, 0.0), put(self._d_rate, rigs, 0.0)
        self._motor_rate = put(self._motor_rate, rigs, 0.0)

    def follow(self, turn: Array) -> Array:
        """Turn of the plate in rad for one of the motor."""
        motor_rate = turn / self._period
        d, d_rate = self._d, self._d_rate - (motor_rate - self._motor_rate)
        self._motor_rate = motor_rate
        (a, b), (c, e) = self._angle, self._rate
        self._d, self._d_rate = a * d + b * d_rate, c * d + e * d_rate
        followed: Array = turn + (self._d - d)
        return followed
