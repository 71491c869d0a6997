"""Control laws, and what a law of one's own follows.

Each is a frozen dataclass: ``LQR(rho=100.0)``. Given to ``run`` as ``controller`` it is built anew
on the nominal model; on its own ``control(t, x, reference, q)`` gives plate accelerations.
"""

from controllers.backstepping import Backstepping
from controllers.ballplate import BallPlate
from controllers.feedback_linearization import AFL, AFLIntegral
from controllers.feedforward import Feedforward
from controllers.interfaces import Array, Law, Reference
from controllers.sliding_mode import SlidingMode
from controllers.state_feedback import LQR, PolePlacement

__all__ = [
    "AFL",
    "LQR",
    "AFLIntegral",
    "Array",
    "Backstepping",
    "BallPlate",
    "Feedforward",
    "Law",
    "PolePlacement",
    "Reference",
    "SlidingMode",
]
