"""Paths of the ball, and what a reference of one's own follows.

Each is a frozen dataclass: ``Circle(amplitude=0.1, omega=0.5)``; ``reference(t)`` gives position
and four derivatives, shape (5, ..., 2).

Examples:
    >>> import ballplate as bp
    >>> circle = bp.references.Circle(amplitude=0.1, omega=0.5)
    >>> circle(30.0).shape
    (5, 2)
    >>> position, velocity = circle(30.0)[:2]
    >>> round(float(position @ position) ** 0.5, 3), round(float(velocity @ velocity) ** 0.5, 3)
    (0.1, 0.05)
"""

from controllers import references as _shipped
from controllers.arrays import Array
from controllers.interfaces import Reference
from controllers.references import *  # noqa: F403  its __all__
from controllers.setpoints import Setpoints

__all__ = ["Array", "Reference", "Setpoints"]
__all__ += _shipped.__all__
