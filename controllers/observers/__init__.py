"""State estimators of chapter 7, two that estimate friction and dead time, and the ideal one."""

from controllers.observers.disturbance import DisturbanceObserver
from controllers.observers.friction import FrictionKalman
from controllers.observers.friction_map import FrictionMapKalman
from controllers.observers.thesis import (
    ExtendedKalman,
    Ideal,
    Kalman,
    Luenberger,
    NonlinearLuenberger,
)

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
