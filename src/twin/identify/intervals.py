"""Intervals of a least-squares fit over independent windows, by the wild score bootstrap."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from controllers.arrays import Array, Mask


@dataclass(frozen=True, kw_only=True)
class Bootstrap:
    """Constants of the bootstrap by which intervals are found.

    Attributes:
        draws: Number of draws.
        coverage: Probability with which an interval contains the true value.
        white_freedom: Degrees of freedom with which white residuals count that all windows have
            the same noise.
    """

    draws: int = 4000
    coverage: float = 0.95
    white_freedom: float = 20.0


BOOTSTRAP = Bootstrap()


# Webb's six weights: mean 0, variance 1, and smooth with few windows.
_BOOTSTRAP_WEIGHTS = np.sqrt(np.array([1.5, 1.0, 0.5])) * np.array([[1.0], [-1.0]])


@dataclass(frozen=True)
class Estimate:
    """Fitted values and their uncertainty.

    Attributes:
        value: Fitted values, shape (P,).
        draws: Bootstrap draws of them, shape (DRAWS, P).
        identifiable: Whether the data say anything about each, shape (P,).
        degrees_of_freedom: Of the scatter of each, shape (P,).
        noise: Standard deviation of each by the noise of the samples alone, shape (P,).
        coverage: Probability with which ``half_width`` contains the true value.
    """

    value: Array
    draws: Array
    identifiable: Mask
    degrees_of_freedom: Array
    noise: Array | float = 0.0
    coverage: float = BOOTSTRAP.coverage

    @property
    def half_width(self) -> Array:
        """Half-width of the interval, shape (P,); infinite where the data say nothing.

        Few windows know little of their own scatter: Student's t over the normal distribution. If
        they happen to agree better than the noise of their samples allows, the noise decides.
        """
        end = (1 + self.coverage) / 2
        few = stats.t.ppf(end, np.maximum(self.degrees_of_freedom, 1)) / stats.norm.ppf(end)
        half = few * np.quantile(np.abs(self.draws - self.value), self.coverage, axis=0)
        half = np.maximum(half, stats.norm.ppf(end) * self.noise)
        return np.where(self.identifiable, half, np.inf)

    def first(self, count: int) -> Estimate:
        """The estimate of the first ``count`` parameters alone."""
        noise = np.broadcast_to(self.noise, self.value.shape)[:count]
        return replace(
            self,
            value=self.value[:count],
            draws=self.draws[:, :count],
            identifiable=self.identifiable[:count],
            degrees_of_freedom=self.degrees_of_freedom[:count],
            noise=noise,
        )

    @property
    def correlation(self) -> Array:
        """Correlation of the draws, shape (P, P)."""
        moved = self.draws - self.value
        scale = np.sqrt((moved**2).mean(axis=0))
        return moved.T @ moved / len(moved) / np.maximum(np.outer(scale, scale), 1e-300)


def estimate(
    value: Array,
    information: Array,
    score: Array,
    noise: Array | None = None,
    bootstrap: Bootstrap = BOOTSTRAP,
    *,
    residual: float | None = None,
) -> Estimate:
    """Bootstrap a least-squares fit over W windows that are independent of each other.

    Wild score bootstrap (Kline and Santos): in each draw every window's score, its share of the
    slope of the cost, gets a random weight, and the fit follows to first order. Scores are those of
    the fit without the window (leave one out), which keeps the intervals from being too narrow
    where a few windows decide. The degrees of freedom are those of Satterthwaite: the number
    of windows that would carry the same information if all carried equally much, at most windows
    less parameters.

    A few windows know their scatter badly, and the width of an interval scatters with it. If the
    residuals are white, all of their samples know it. So each variance is moderated towards the
    variance of white residuals, and has more degrees of freedom (Smyth 2004, *Linear models and
    empirical Bayes methods*, section 3).

    Args:
        value: The fit, shape (P,).
        information: J'J of each window, shape (W, P, P).
        score: J'r of each window, r being fit minus data, shape (W, P).
        noise: Covariance of the sum of the scores by noise alone, shape (P, P), if it is known.
        bootstrap: Its constants.
        residual: Mean square residual in noise variances, if the residuals are white; None if they
            are not.
    """
    total = information.sum(axis=0)
    diagonal = np.diagonal(total)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    # Scaled so that no unit matters; tiny eigenvalues mark directions the data do not determine.
    scaled = total / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    weak = values < 1e-6
    identifiable = (diagonal > 0) & ~(np.abs(vectors[:, weak]) > 0.1).any(axis=1)
    inverse = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T / np.outer(scale, scale)
    shares = np.stack(
        [
            _leave_one_out(total, inverse, part, s)
            for part, s in zip(information, score, strict=True)
        ]
    )
    weights = np.random.default_rng(0).choice(
        _BOOTSTRAP_WEIGHTS.ravel(), (bootstrap.draws, len(score))
    )
    carried = np.einsum("ij,wjk,ki->wi", inverse, information, inverse)
    effective = carried.sum(axis=0) ** 2 / np.maximum((carried**2).sum(axis=0), 1e-300)
    known = np.zeros(len(value))
    if noise is not None:
        known = np.sqrt(np.diagonal(inverse @ noise @ inverse))
    freedom = np.minimum(effective, len(score) - len(value))
    if residual is not None:
        usual = max(residual, 1.0) * known**2
        factor, more = _moderate_scatter(shares, usual, freedom, bootstrap)
        shares, freedom = shares * factor, freedom + more
    draws = value + weights @ shares
    return Estimate(value, draws, identifiable, freedom, known, bootstrap.coverage)


def _moderate_scatter(
    shares: Array, usual: Array, freedom: Array, bootstrap: Bootstrap
) -> tuple[Array, Array]:
    """Factors on the scatter of P parameters and the degrees of freedom gained, each of shape (P,).

    Args:
        shares: What each of W windows moves them by, shape (W, P).
        usual: Their variances by white residuals, shape (P,); 0 where unknown.
        freedom: Degrees of freedom of their scatter, shape (P,).
        bootstrap: Constants.
    """
    variance, more = (shares**2).sum(axis=0), bootstrap.white_freedom
    there = (usual > 0) & (variance > 0)
    own = np.maximum(freedom, 1)
    ratio = np.where(there, usual, 1.0) / np.where(there, variance, 1.0)
    factors = np.sqrt((own + more * ratio) / (own + more))
    return np.where(there, factors, 1.0), np.where(there, more, 0.0)


def _leave_one_out(total: Array, inverse: Array, part: Array, score: Array) -> Array:
    """How far one window moved the fit: the step from the fit without it."""
    left = np.eye(len(total)) - inverse @ part
    if np.linalg.cond(left) > 1e8:
        return np.asarray(inverse @ score)
    return np.asarray(np.linalg.solve(left, inverse @ score))
