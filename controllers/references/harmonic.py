"""Harmonic motion on both axes and the sine references of chapter 8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from controllers.interfaces import Array, Reference
from controllers.references.checks import not_zero, pair

Wave = Literal["sin", "cos"]


class Oscillation:
    """Harmonic motion S sin(omega t) + C cos(omega t) of both axes.

    Args:
        sine: S for x and y in m.
        cosine: C for x and y in m.
        omega: Angular frequency for x and y in rad/s.
    """

    def __init__(
        self, sine: Sequence[float], cosine: Sequence[float], omega: Sequence[float]
    ) -> None:
        S, C, self._omega = np.array(sine), np.array(cosine), np.array(omega)
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

    amplitude: float | tuple[float, float] = 0.15
    """Amplitude in m, one for both axes or (x, y)."""
    omega: float | tuple[float, float] = 0.5
    """Angular frequency in rad/s, one for both axes or (x, y)."""
    wave: tuple[Wave, Wave] = ("sin", "sin")
    """Whether x and y start in the middle ("sin") or at the end of the swing ("cos")."""

    _motion: Oscillation = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings."""
        amplitude, omega = pair("amplitude", self.amplitude), pair("omega", self.omega)
        for value in omega:
            not_zero("omega", value)
        wave = tuple(self.wave)
        if len(wave) != 2 or not {"sin", "cos"}.issuperset(wave):
            raise ValueError(f'wave must be two of "sin" and "cos", for x and y, got {self.wave}')
        sine = [a if w == "sin" else 0.0 for a, w in zip(amplitude, wave, strict=True)]
        cosine = [a if w == "cos" else 0.0 for a, w in zip(amplitude, wave, strict=True)]
        object.__setattr__(self, "wave", wave)
        object.__setattr__(self, "_motion", Oscillation(sine, cosine, omega))

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        return self._motion(t)
