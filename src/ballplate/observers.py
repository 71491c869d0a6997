"""State estimators, and what an observer of one's own follows.

Each is a dataclass: ``Luenberger(poles=(-8, -10, -14, -16))``; given to ``run`` as ``observer`` it
is built anew on the ball that the scenario describes for the control period of the run.

Examples:
    >>> import ballplate as bp
    >>> observer = bp.observers.Luenberger(poles=(-8, -10, -14, -16))
    >>> done = bp.run("hold", ["plant.kind=lagrange"], observer=observer, duration=0.1)
    >>> done.scenario.observer.kind
    'luenberger'
"""

from controllers import observers as _shipped
from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from controllers.interfaces import DelayedObserver, Measurement, Observer, Quantity
from controllers.observers import *  # noqa: F403  its __all__

__all__ = ["Array", "BallPlate", "DelayedObserver", "Mask", "Measurement", "Observer", "Quantity"]
__all__ += _shipped.__all__
