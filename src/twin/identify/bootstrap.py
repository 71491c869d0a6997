"""Intervals by the wild score bootstrap: how far chance could have moved a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from controllers.arrays import Array, Mask

DRAWS = 4000
"""Bootstrap draws."""
LEVEL = 0.95
"""Coverage of the intervals."""
# Webb's six weights: mean 0, variance 1, and smooth with few windows.
_WEIGHTS = np.sqrt(np.array([1.5, 1.0, 0.5])) * np.array([[1.0], [-1.0]])


@dataclass(frozen=True)
class Estimate:
    """Fitted values and their uncertainty.

    Attributes:
        value: Fitted values, shape (P,).
        draws: Bootstrap draws of them, shape (DRAWS, P).
        identifiable: Whether the data say anything about each, shape (P,).
        degrees_of_freedom: Of the scatter of each, shape (P,).
        noise: Standard deviation of each by the noise of the samples alone, shape (P,).
    """

    value: Array
    draws: Array
    identifiable: Mask
    degrees_of_freedom: Array
    noise: Array | float = 0.0

    @property
    def half_width(self) -> Array:
        """Half-width of the 95 % interval, shape (P,); infinite where the data say nothing.

        Few windows know little of their own scatter: Student's t over the normal distribution. If
        they happen to agree better than the noise of their samples allows, the noise decides.
        """
        end = (1 + LEVEL) / 2
        few = stats.t.ppf(end, np.maximum(self.degrees_of_freedom, 1)) / stats.norm.ppf(end)
        half = few * np.quantile(np.abs(self.draws - self.value), LEVEL, axis=0)
        half = np.maximum(half, stats.norm.ppf(end) * self.noise)
        return np.where(self.identifiable, half, np.inf)

    @property
    def correlation(self) -> Array:
        """Correlation of the draws, shape (P, P)."""
        moved = self.draws - self.value
        scale = np.sqrt((moved**2).mean(axis=0))
        result: Array = moved.T @ moved / len(moved) / np.maximum(np.outer(scale, scale), 1e-300)
        return result


def estimate(
    value: Array, information: Array, score: Array, noise: Array | None = None, seed: int = 0
) -> Estimate:
    """Bootstrap a least-squares fit over W windows that are independent of each other.

    Wild score bootstrap (Kline and Santos): in each draw every window's score, its share of the
    slope of the cost, gets a random weight, and the fit follows to first order. Scores are those of
    the fit without the window (leave one out), which keeps the intervals from being too narrow
    where a few windows decide. The degrees of freedom are those of Satterthwaite: the windows, as
    many as there were if all told as much of a parameter, at most windows less parameters.

    Args:
        value: The fit, shape (P,).
        information: J'J of each window, shape (W, P, P).
        score: J'r of each window, r being fit minus data, shape (W, P).
        noise: Covariance of the sum of the scores by noise alone, shape (P, P), if it is known.
        seed: Seed of the weights.
    """
    total = information.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diagonal(total), 1e-300))
    # Scaled so that no unit matters; tiny eigenvalues mark directions the data do not determine.
    scaled = total / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    weak = values < 1e-6
    identifiable = (np.diagonal(total) > 0) & ~(np.abs(vectors[:, weak]) > 0.1).any(axis=1)
    inverse = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T / np.outer(scale, scale)
    shares = np.stack(
        [
            _leave_one_out(total, inverse, part, s)
            for part, s in zip(information, score, strict=True)
        ]
    )
    rng = np.random.default_rng(seed)
    weights = rng.choice(_WEIGHTS.ravel(), (DRAWS, len(score)))
    told = np.einsum("ij,wjk,ki->wi", inverse, information, inverse)
    alike = told.sum(axis=0) ** 2 / np.maximum((told**2).sum(axis=0), 1e-300)
    known = 0.0 if noise is None else np.sqrt(np.diagonal(inverse @ noise @ inverse))
    freedom = np.minimum(alike, len(score) - len(value))
    return Estimate(value, value + weights @ shares, identifiable, freedom, known)


def _leave_one_out(total: Array, inverse: Array, part: Array, score: Array) -> Array:
    """How far one window moved the fit: the step from the fit without it."""
    left = np.eye(len(total)) - inverse @ part
    if np.linalg.cond(left) > 1e8:
        return np.asarray(inverse @ score)
    return np.asarray(np.linalg.solve(left, inverse @ score))
