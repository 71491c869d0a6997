"""Control laws, and what a law of one's own follows.

Each is a frozen dataclass: ``LQR(rho=100.0)``. Given to ``run`` as ``controller`` it is built anew
on the ball that the scenario describes; on its own ``control(t, x, reference, q)`` gives plate
accelerations.

Examples:
    >>> import numpy as np
    >>> import ballplate as bp
    >>> law = bp.laws.LQR(rho=100.0)
    >>> goal = bp.references.Setpoints()
    >>> ball = np.array([0.01, 0, 0, 0, 0, 0, 0, 0])  # 10 mm off the centre along x, at rest
    >>> law.control(0.0, ball, goal, np.zeros(2)).round(3)  # rad/s^2: it tilts the plate back
    array([-0.1, -0. ])
"""

from controllers import classical
from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.classical import *  # noqa: F403  its __all__
from controllers.fmu import FmuLaw
from controllers.interfaces import Feedback, Law, Reference
from controllers.predictive import Predictive
from controllers.repetition import InternalModel, IterativeLearning
from controllers.stable_inversion import StableInversion
from controllers.time_varying import TimeVaryingLQR

__all__ = ["Array", "BallPlate", "Feedback", "FmuLaw", "InternalModel", "IterativeLearning", "Law"]
__all__ += ["Predictive", "Reference", "StableInversion", "TimeVaryingLQR"]
__all__ += classical.__all__
