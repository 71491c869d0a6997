"""Paths of the ball, and what a reference of one's own follows.

Each is a frozen dataclass: ``Circle(amplitude=0.1, omega=0.5)``; ``reference(t)`` gives position
and four derivatives, shape (5, ..., 2).
"""

from controllers import references as _shipped
from controllers.arrays import Array
from controllers.interfaces import Reference
from controllers.references import *  # noqa: F403  what it says that it has

__all__ = ["Array", "Reference"]
__all__ += _shipped.__all__
