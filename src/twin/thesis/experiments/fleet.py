"""Observers with and without a predictor as the rigs of one batch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.interfaces import Measurement
from controllers.smith import BALL, Smith
from controllers.stack import Controller


@dataclass(kw_only=True)
class SomePredicted(Smith):
    """A Smith predictor for some rigs; the others' observer takes the ball as it is measured."""

    predicted: NDArray[np.bool_]
    """Which rigs have the predictor, shape (N,)."""

    def _look_back(self) -> Array:
        """Estimated ball a dead time ago; where nothing is predicted, that of now."""
        past: Array = np.where(self.predicted[:, None], super()._look_back(), self.x[..., BALL])
        return past

    def _look_back_each(self, periods: Array) -> Array:
        past: Array = np.where(
            self.predicted[:, None], super()._look_back_each(periods), self.x[..., BALL]
        )
        return past


class Watched(Controller):
    """A controller that leaves the estimate its command follows from in ``estimate``."""

    def command(self, measurement: Measurement) -> Array:
        """Wished plate rates in rad/s, shape (N, 2)."""
        wished = super().command(measurement)
        self.estimate = self.observer.x
        return wished
