"""Likelihood profile of a parameter in which the cost has no slope, and the resulting intervals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter1d

from controllers.arrays import Array, Mask
from twin.identify.axis_fitting import AXIS_FITTING, DriveSearch
from twin.identify.intervals import BOOTSTRAP


@dataclass(frozen=True)
class Profile:
    """Fits with a parameter held at each of several values.

    Attributes:
        name: The parameter.
        names: Of all of them.
        theta: The fits, by rising values of it, shape (K, P).
        costs: Cost of each window, shape (K, W).
        own: Index of the fit that is reported.
        known: Whether the parameter is a lever that is given, with the error of a ruler.
        how: Constants of the profile.
        draws: Number of bootstrap draws.
    """

    name: str
    names: tuple[str, ...]
    theta: Array
    costs: Array
    own: int
    known: bool = False
    how: DriveSearch = AXIS_FITTING.drives
    draws: int = BOOTSTRAP.draws

    @property
    def closed(self) -> tuple[bool, bool]:
        """Whether no draw of the windows takes the first value, and none the last."""
        rise = self.costs[[0, -1]] - self.costs[self.own]
        least = (self._draw_weights() @ rise.T).min(axis=0)
        below, above = (least > self.how.bracket_rise).tolist()
        return below, above

    def _draw_weights(self) -> Array:
        """Weights of the windows in each draw, shape (draws, W)."""
        return np.random.default_rng(1).exponential(size=(self.draws, self.costs.shape[1]))

    @property
    def contenders(self) -> Mask:
        """Values that some draw of the windows may take, and those next to them, shape (K,)."""
        drawn = self._draw_weights() @ self.costs.T
        rise = (drawn - drawn.min(axis=1, keepdims=True)).min(axis=0)
        near = maximum_filter1d((rise < self.how.bracket_rise).astype(np.uint8), 3, mode="nearest")
        near[self.own] = 1
        return np.asarray(near > 0)

    def join(self, other: Profile) -> Profile:
        """Profile over the values of both."""
        theta = np.concatenate((self.theta, other.theta))
        order = np.argsort(theta[:, self.names.index(self.name)])
        costs = np.concatenate((self.costs, other.costs))[order]
        own = int(np.flatnonzero(order == self.own)[0])
        return replace(self, theta=theta[order], costs=costs, own=own)

    @cached_property
    def deviations(self) -> dict[str, Array]:
        """Deviations of the parameters in the best fits of windows drawn at random, (draws,) each.

        The Bayesian bootstrap: each window has an exponential weight. A lever is drawn by its
        likelihood, as the largest sum of a Gumbel number and its logarithm, and has the error of a
        ruler; one that is given has that error alone, whatever the windows say.
        """
        held = self.theta[:, self.names.index(self.name)]
        places = np.linspace(0, len(held) - 1, self.how.interpolated_points)
        fine = np.interp(places, np.arange(len(held)), held)
        costs, theta = (
            np.stack([np.interp(fine, held, each) for each in part.T], axis=-1)
            for part in (self.costs, self.theta - self.theta[self.own])
        )
        rng = np.random.default_rng(1)
        drawn = rng.exponential(size=(self.draws, costs.shape[1])) @ costs.T
        if self.name == "lever":  # windows of one frequency agree in what they hardly know
            drawn -= 2 * rng.gumbel(size=drawn.shape)
            best = 0.0 if self.known else fine[drawn.argmin(axis=1), None]
            drawn = (fine - best - rng.normal(0.0, self.how.height_std_m, (self.draws, 1))) ** 2
        return dict(zip(self.names, theta[drawn.argmin(axis=1)].T, strict=True))
