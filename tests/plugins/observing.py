"""What observers are shown, and whether their errors are as large as they say."""

import numpy as np
from scipy.stats import chi2

from controllers.interfaces import Measurement


def measured(y, touched=True):
    """Measurements that have just arrived."""
    shape = y.shape[:-1]
    return Measurement(0.0, y, np.zeros(shape), np.full(shape, touched))


def normalised(error, covariance):
    """Squares of errors, shape (N, n), by their covariance, one or N of them; shape (N,)."""
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])


def within(values, freedom, chance=1e-4):
    """Whether the mean of values of a chi-square of such freedom is one of so many."""
    low, high = chi2.ppf([chance / 2, 1 - chance / 2], freedom * values.size) / values.size
    return low < values.mean() < high
