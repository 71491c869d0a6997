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


def within(values, freedom):
    """Whether the mean of values of a chi-square of such freedom is one that 9999 of 10000 are."""
    low, high = chi2.ppf([0.5e-4, 1 - 0.5e-4], freedom * values.size) / values.size
    return low < values.mean() < high
