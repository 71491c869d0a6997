"""State estimators, and what an observer of one's own follows.

Each is a dataclass: ``Luenberger(poles=(-8, -10, -14, -16))``; given to ``run`` as ``observer`` it
is built anew on the ball that the scenario describes for the control period of the run.
"""

from controllers.ballplate import BallPlate
from controllers.interfaces import (
    Array,
    DelayedObserver,
    Mask,
    Measurement,
    Observer,
    Quantity,
)
from controllers.observers import (
    ExtendedKalman,
    Ideal,
    Kalman,
    Luenberger,
    NonlinearLuenberger,
)
from controllers.observers.friction import DisturbanceObserver, FrictionKalman, FrictionMapKalman

__all__ = [
    "Array",
    "BallPlate",
    "DelayedObserver",
    "DisturbanceObserver",
    "ExtendedKalman",
    "FrictionKalman",
    "FrictionMapKalman",
    "Ideal",
    "Kalman",
    "Luenberger",
    "Mask",
    "Measurement",
    "NonlinearLuenberger",
    "Observer",
    "Quantity",
]
