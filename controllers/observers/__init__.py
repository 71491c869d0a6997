"""State estimators of chapter 7, two of what it leaves out, and the ideal one."""

from controllers.observers.disturbance_observer import DisturbanceObserver
from controllers.observers.ekf import ExtendedKalman
from controllers.observers.friction_kalman import FrictionKalman
from controllers.observers.friction_map_kalman import FrictionMapKalman
from controllers.observers.ideal import Ideal
from controllers.observers.kalman import Kalman
from controllers.observers.luenberger import Luenberger
from controllers.observers.nonlinear_luenberger import NonlinearLuenberger

__all__ = [
    "DisturbanceObserver",
    "ExtendedKalman",
    "FrictionKalman",
    "FrictionMapKalman",
    "Ideal",
    "Kalman",
    "Luenberger",
    "NonlinearLuenberger",
]
