"""State estimators of chapter 7, discrete at the control period, one of friction, the ideal one."""

from controllers.observers.ekf import ExtendedKalman
from controllers.observers.friction_kalman import FrictionKalman
from controllers.observers.ideal import Ideal
from controllers.observers.kalman import Kalman
from controllers.observers.luenberger import Luenberger
from controllers.observers.nonlinear_luenberger import NonlinearLuenberger

__all__ = [
    "ExtendedKalman",
    "FrictionKalman",
    "Ideal",
    "Kalman",
    "Luenberger",
    "NonlinearLuenberger",
]
