"""References that stand still: a point to hold and a step from one point to another.

Harmonic motion on both axes and the sine references of chapter 8.

Circle and Lissajous figure that start from rest in the middle, Appendix D.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Reference
from controllers.ranges import NotNegative, Pair, Positive
from controllers.references.paths import WithDerivatives, at_rest, in_turn, join, linear


@dataclass(frozen=True, kw_only=True)
class Hold(Reference):
    """The ball shall stay at one point.

    Raises:
        ValueError: If a setting is not finite.
    """

    name: ClassVar[str] = "hold"

    x: float = 0.0
    """Position along x in m, plate axes."""
    y: float = 0.0
    """Position along y in m, plate axes."""

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        out = np.zeros((5, *np.shape(t), 2))
        out[0] = self.x, self.y
        return out


@dataclass(frozen=True, kw_only=True)
class Step(Reference):
    """The desired position jumps from one point to another, as in Tables 8.1 and 8.2.

    The derivatives are zero everywhere, the jump itself included.

    Raises:
        ValueError: If a setting is not finite.
    """

    name: ClassVar[str] = "step"

    start: tuple[float, float] = (0.0, 0.0)
    """Position (x, y) before the step in m, plate axes."""
    end: tuple[float, float] = (0.15, 0.15)
    """Position (x, y) from the step on in m, plate axes."""
    time: float = 0.0
    """Time of the step in s."""

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        out = np.zeros((5, *np.shape(t), 2))
        after = np.asarray(t)[..., None] >= self.time
        out[0] = np.where(after, self.end, self.start)
        return out


Wave = Literal["sin", "cos"]


def both(value: Pair) -> tuple[float, float]:
    """A number for each axis."""
    return (value, value) if isinstance(value, int | float) else value


class Oscillation:
    """Harmonic motion S sin(omega t) + C cos(omega t) of both axes.

    Args:
        sine: S for x and y in m.
        cosine: C for x and y in m.
        omega: Angular frequency for x and y in rad/s.

    Raises:
        ValueError: If a frequency is zero.
    """

    def __init__(
        self, sine: Sequence[float], cosine: Sequence[float], omega: Sequence[float]
    ) -> None:
        if 0 in omega:
            raise ValueError("omega must not be zero")
        S, C, self._omega = np.array(sine), np.array(cosine), np.array(omega, float)
        speed = self._omega ** np.arange(5)[:, None]
        # Each derivative turns sin into cos and cos into -sin.
        self._sine = speed * (S, -C, -S, C, S)
        self._cosine = speed * (C, S, -C, -S, C)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        t = np.asarray(t, dtype=float)
        angle = self._omega * t[..., None]
        shape = (5, *(1,) * t.ndim, 2)
        sine, cosine = self._sine.reshape(shape), self._cosine.reshape(shape)
        out: Array = sine * np.sin(angle) + cosine * np.cos(angle)
        return out


@dataclass(frozen=True, kw_only=True)
class Sine(Reference):
    """A sine or a cosine on each axis, from t = 0 at full swing.

    The same sine on both axes gives the references of Tables 8.3 to 8.11, (6.53); the waves
    ("sin", "cos") give those of Tables 8.14 to 8.21.

    Raises:
        ValueError: If a setting is not finite, a frequency is zero or a wave has no such name.
    """

    name: ClassVar[str] = "sine"

    amplitude: Pair = 0.15
    """Amplitude in m, one for both axes or (x, y)."""
    omega: Pair = 0.5
    """Angular frequency in rad/s, one for both axes or (x, y)."""
    wave: tuple[Wave, Wave] = ("sin", "sin")
    """Whether x and y start in the middle ("sin") or at the end of the swing ("cos")."""

    _motion: Oscillation = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        waves = list(zip(both(self.amplitude), self.wave, strict=True))
        sine = [a if w == "sin" else 0.0 for a, w in waves]
        cosine = [a if w == "cos" else 0.0 for a, w in waves]
        object.__setattr__(self, "wave", tuple(self.wave))
        object.__setattr__(self, "_motion", Oscillation(sine, cosine, both(self.omega)))

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        return self._motion(t)


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
