"""Harmonic motion on both axes and the sine references of chapter 8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from controllers.interfaces import Array, Reference
from controllers.ranges import Pair

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
