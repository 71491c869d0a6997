"""Control laws, and what a law of one's own follows.

Each is a frozen dataclass: ``LQR(rho=100.0)``. Given to ``run`` as ``controller`` it is built anew
on the ball that the scenario describes; on its own ``control(t, x, reference, q)`` gives plate
accelerations.
"""

from controllers.backstepping import Backstepping
from controllers.ballplate import BallPlate
from controllers.feedback_linearization import AFL, AFLIntegral
from controllers.feedforward import Feedforward
from controllers.interfaces import Array, Feedback, Law, Reference
from controllers.internal_model import InternalModel
from controllers.iterative_learning import IterativeLearning
from controllers.pid import Pid
from controllers.predictive import Predictive
from controllers.sliding_mode import SlidingMode
from controllers.stable_inversion import StableInversion
from controllers.state_feedback import LQR, PolePlacement
from controllers.time_varying_lqr import TimeVaryingLQR

__all__ = [
    "AFL",
    "LQR",
    "AFLIntegral",
    "Array",
    "Backstepping",
    "BallPlate",
    "Feedback",
    "Feedforward",
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
