"""The drives' lag: how the plate's encoders follow the commanded rates."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from controllers.arrays import Array
from twin.identify.motion import servo
from twin.identify.parameters import SERVO
from twin.identify.prepare import Data
from twin.identify.scores import Estimate, estimate

CHUNK = 1.0
"""Length in s of the pieces from which a parabola is taken, for disturbances drift the plate."""


def fit_drives(data: Data) -> Estimate | None:
    """Time constant in s of the drives; None if the command was not recorded."""
    rows = round(CHUNK / data.period)
    parabola, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, rows), 3))
    stretches = [
        (s.command, s.plate)
        for s in data.stretches
        if s.command is not None and len(s.time) >= rows
    ]
    if not stretches:
        return None

    def pieces(values: Array) -> Array:
        """Pieces without their parabola, shape (W, rows, 2)."""
        cut = values[: len(values) // rows * rows].reshape(-1, rows, 2)
        return np.asarray(cut - parabola @ (parabola.T @ cut))

    measured = np.concatenate([pieces(plate) for _, plate in stretches])

    def misfit(lag: float) -> Array:
        answers = [servo(command, data.period, lag, data.own_lag)[0] for command, _ in stretches]
        left: Array = measured - np.concatenate([pieces(answer) for answer in answers])
        return left

    # Squares of pieces that do not follow at all (a wheel off its cam) must not decide.
    usual = float(np.median((misfit(0.02) ** 2).mean(axis=(1, 2))))

    def cost(lag: float) -> float:
        square = (misfit(lag) ** 2).mean(axis=(1, 2))
        return float(np.log1p(square / (3 * usual)).sum())

    lag = float(minimize_scalar(cost, bounds=(0, SERVO.most), options={"xatol": 1e-6}).x)
    step = 1e-4
    r = misfit(lag)
    J = (misfit(lag + step) - r) / step  # noqa: N806
    weight = 1 / (1 + (r**2).mean(axis=(1, 2)) / (3 * usual))
    information = weight * (J**2).sum(axis=(1, 2))
    score = weight * (J * r).sum(axis=(1, 2))
    return estimate(np.array([lag]), information[:, None, None], score[:, None])
