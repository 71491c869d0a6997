"""Circle and Lissajous figure that start from rest in the middle, Appendix D."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from controllers.interfaces import Array, Reference
from controllers.ranges import NotNegative, Pair, Positive
from controllers.references.harmonic import Oscillation, both
from controllers.references.piecewise import WithDerivatives, at_rest, in_turn, join, linear

REVOLUTIONS = 0.75
"""Default length of the soft start in periods of the faster axis.

At three quarters the start passes the amplitude by at most 0.6 % and the acceleration of a circle
by at most 6 %; at a half it asks for 1.8 times that acceleration, beyond one it swings ever wider.
"""


@dataclass(frozen=True, kw_only=True)
class _SoftStarted(Reference):
    """Harmonic motion entered by a polynomial of degree nine from rest at the centre (D.1).

    Position and four derivatives are zero up to t = 0 and agree with the motion at t = start.
    """

    start: NotNegative | None = None
    """Length of the polynomial start in s; 0 begins in full motion. Default: three quarters of a
    period of the faster axis."""

    _start: float = field(init=False, repr=False, compare=False)
    _motion: Oscillation = field(init=False, repr=False, compare=False)
    _opening: WithDerivatives = field(init=False, repr=False, compare=False)

    @abstractmethod
    def _settings(self) -> tuple[Oscillation, float]:
        """The motion and its fastest angular frequency in rad/s."""

    def __post_init__(self) -> None:
        """Join rest and motion."""
        super().__post_init__()
        motion, fastest = self._settings()
        start = REVOLUTIONS * 2 * math.pi / fastest if self.start is None else self.start
        rest = at_rest((0.0, 0.0))
        still = linear(rest)
        pieces = (still, join(rest, motion(start), start) if start > 0 else still)
        object.__setattr__(self, "_start", start)
        object.__setattr__(self, "_motion", motion)
        object.__setattr__(self, "_opening", in_turn((0.0, 0.0), pieces))

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        if isinstance(t, np.ndarray) and t.ndim:
            opening = self._opening(np.minimum(t, self._start))
            return np.where((t < self._start)[..., None], opening, self._motion(t))
        return self._opening(t) if t < self._start else self._motion(t)


@dataclass(frozen=True, kw_only=True)
class Circle(_SoftStarted):
    """x = A sin(omega t), y = A cos(omega t) after a soft start (D.1).

    Raises:
        ValueError: If a setting is not finite, or the amplitude not positive, omega zero or the
            start negative.
    """

    name: ClassVar[str] = "circle"

    amplitude: Positive = 0.15
    """Radius A in m."""
    omega: float = 0.5
    """Angular frequency in rad/s; negative goes round the other way."""

    def _settings(self) -> tuple[Oscillation, float]:
        A, omega = self.amplitude, self.omega
        return Oscillation((A, 0.0), (0.0, A), (omega, omega)), abs(omega)


@dataclass(frozen=True, kw_only=True)
class Lissajous(_SoftStarted):
    """x = A_x sin(omega_x t + phase), y = A_y sin(omega_y t) after a soft start as in (D.1).

    Raises:
        ValueError: If a setting is not finite, a frequency is zero or the start negative.
    """

    name: ClassVar[str] = "lissajous"

    amplitude: Pair = (0.2, 0.12)
    """Amplitude in m, one for both axes or (x, y)."""
    omega: tuple[float, float] = (0.4, 0.6)
    """Angular frequencies (x, y) in rad/s."""
    phase: float = math.pi / 2
    """Phase of x in rad."""

    def _settings(self) -> tuple[Oscillation, float]:
        (A_x, A_y), omega, phase = both(self.amplitude), self.omega, self.phase
        sine, cosine = (A_x * math.cos(phase), A_y), (A_x * math.sin(phase), 0.0)
        return Oscillation(sine, cosine, omega), max(abs(omega[0]), abs(omega[1]))
