# %% [markdown]
# # An observer of one's own
# It corrects its estimate by a measurement and carries it a period ahead under what was applied.

# %%
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import ballplate as bp
from ballplate.observers import Array, Measurement, Observer


@dataclass(kw_only=True)
class AlphaBeta(Observer):
    """Every coordinate by itself, its velocity from its own innovation."""

    name: ClassVar[str] = "own_alpha_beta"

    ball: float = 0.03
    """Share of the innovation that corrects the ball's position."""
    plate: float = 0.24
    """The same of the plate's angles."""

    def correct(self, measurement: Measurement) -> Array:
        """The estimate at a measurement, shape (..., 8)."""
        e = measurement.y - self.x[..., 0::2]
        e[~measurement.touched, 0::2] = 0  # what the screen does not feel corrects nothing
        alpha = np.array([self.ball, self.plate] * 2)
        self.x = self.x.copy()
        self.x[..., 0::2] += alpha * e
        self.x[..., 1::2] += alpha**2 / (2 - alpha) / self.period * e
        return self.x

    def predict(self, u: Array) -> None:
        """One period ahead under the applied accelerations u, shape (..., 2)."""
        self.x = self.x + self.period * self.model.derivative(self.x, u)


# %% How far is the estimated ball from the true one?
observers = [AlphaBeta(), AlphaBeta(ball=0.015), "luenberger"]
for label, run in bp.compare("circle", vary={"observer": observers}, duration=12).items():
    away = np.hypot(run["estimated_x"] - run["true_x"], run["estimated_y"] - run["true_y"])
    print(f"{1000 * np.sqrt((away**2).mean()):5.2f} mm RMS  {label}")
