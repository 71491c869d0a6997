"""Whether what a fit leaves over is noise, or motion the twin does not know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.identify.search import Fit

LAGS = 20
"""So many lags of the autocorrelation are looked at."""


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of the averaged residuals within windows.

    Attributes:
        correlation: At lags 1 to ``LAGS`` samples, shape (LAGS,).
        band: What 95 % of white residuals stay within.
        misfit: Mean square residual in noise variances; 1 for a perfect twin.
    """

    correlation: Array
    band: float
    misfit: float

    @property
    def outside(self) -> int:
        """How many of the lags are outside the band; of white residuals one in twenty."""
        return int((np.abs(self.correlation) > self.band).sum())

    @property
    def words(self) -> str:
        """In words."""
        if self.outside <= 3 and self.misfit < 1.3:
            return "the residuals look like the screen's noise"
        return (
            f"the residuals are not white: {self.outside} of {LAGS} lags outside the band, "
            f"{self.misfit:.2f} times the screen's noise; the log holds motion that the twin "
            "does not explain"
        )


def whiteness(fit: Fit) -> Whiteness:
    """How white the residuals of a fit are."""
    windows = fit.problem.windows
    r = fit.linear.r[0].reshape(len(windows), -1, 2)
    seen = np.asarray((windows.weight > 0).all(axis=-1))
    products, counts = np.zeros(LAGS + 1), np.zeros(LAGS + 1)
    for row, mask in zip(r, seen, strict=True):
        values = row[mask] - row[mask].mean(axis=0)
        for lag in range(min(LAGS + 1, len(values))):
            products[lag] += float((values[lag:] * values[: len(values) - lag]).sum())
            counts[lag] += 2 * (len(values) - lag)
    variance = products[0] / max(counts[0], 1)
    correlation = products[1:] / np.maximum(counts[1:], 1) / max(variance, 1e-300)
    # a window's mean and start take away some of what is white
    return Whiteness(
        correlation,
        1.96 / float(np.sqrt(max(counts[0], 1))),
        float(fit.problem.misfit(fit.linear.r).mean()),
    )
