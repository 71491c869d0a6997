"""References that stand still: a point to hold and a step from one point to another."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from controllers.interfaces import Array, Reference


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

    _path: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        path = np.zeros((5, 2))
        path[0] = self.x, self.y
        object.__setattr__(self, "_path", path)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        out = np.zeros((5, *np.shape(t), 2))
        out[0] = self._path[0]
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
