"""Paths of the ball, and what a reference of one's own follows.

Each is a frozen dataclass: ``Circle(amplitude=0.1, omega=0.5)``; ``reference(t)`` gives position
and four derivatives, shape (5, ..., 2).
"""

from controllers.interfaces import Array, Reference
from controllers.references import (
    Circle,
    Hold,
    Lissajous,
    Path,
    Setpoints,
    Sine,
    Step,
    Transition,
)

__all__ = [
    "Array",
    "Circle",
    "Hold",
    "Lissajous",
    "Path",
    "Reference",
    "Setpoints",
    "Sine",
    "Step",
    "Transition",
]
