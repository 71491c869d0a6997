"""State estimators, and what an observer of one's own follows.

Each is a dataclass: ``Kalman(position_mm=...)``; given to ``run`` as ``observer`` it is built anew
on the nominal model for the control period of the run.
"""

from controllers.ballplate import BallPlate
from controllers.interfaces import Array, Mask, Measurement, Observer
from controllers.observers import ExtendedKalman, Ideal, Kalman, Luenberger, NonlinearLuenberger

__all__ = [
    "Array",
    "BallPlate",
    "ExtendedKalman",
    "Ideal",
    "Kalman",
    "Luenberger",
    "Mask",
    "Measurement",
    "NonlinearLuenberger",
    "Observer",
]
