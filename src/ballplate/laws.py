"""Control laws, and what a law of one's own follows.

Each is a frozen dataclass: ``LQR(rho=100.0)``. Given to ``run`` as ``controller`` it is built anew
on the ball that the scenario describes; on its own ``control(t, x, reference, q)`` gives plate
accelerations.
"""

from controllers.advanced import InternalModel, IterativeLearning, Predictive, TimeVaryingLQR
from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.classical import (
    AFL,
    LQR,
    AFLIntegral,
    Backstepping,
    Feedforward,
    Pid,
    PolePlacement,
    SlidingMode,
)
from controllers.fmu import FmuLaw
from controllers.interfaces import Feedback, Law, Reference
from controllers.stable_inversion import StableInversion

__all__ = [
    "AFL",
    "LQR",
    "AFLIntegral",
    "Array",
    "Backstepping",
    "BallPlate",
    "Feedback",
    "Feedforward",
    "FmuLaw",
    "InternalModel",
    "IterativeLearning",
    "Law",
    "Pid",
    "PolePlacement",
    "Predictive",
    "Reference",
    "SlidingMode",
    "StableInversion",
    "TimeVaryingLQR",
]
