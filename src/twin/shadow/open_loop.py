"""The twin in an open loop: set to the smoothed state of a log, it goes on by itself.

The plate is the servos' response to the recorded commands, corrected by the encoders. What the twin
does not know, its state at the start and its parameters, is drawn as sigma points (Julier and
Uhlmann), so that a ball that may or may not stop has the spread that comes of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.replay import STEP
from twin.identify.windows import BIN, LOOKBACK, Windows
from twin.shadow.belief import BALL, Belief
from twin.shadow.friction_map import Known, Ways
from twin.shadow.smoothing import Lead, braking, forces, smoothed
from twin.shadow.unevenness import FINE, THINNED, unforeseen

KAPPA = 1.0
"""Weight of the middle sigma point."""


@dataclass(frozen=True)
class OpenLoop:
    """W replays.

    Attributes:
        belief: The twin.
        lead: What the windows up to their starts say.
        after: The windows that are foreseen.
    """

    belief: Belief
    lead: Lead
    after: Windows

    @classmethod
    def of(cls, belief: Belief, before: Windows, after: Windows) -> OpenLoop:
        """Replays of windows, from the windows before them."""
        return cls(belief, Lead.of(before, belief), after)

    @property
    def ways(self) -> Ways:
        """Where the balls went up to the starts, and where the twins expect them to go on."""
        whole = self.belief.problem(self.after)
        places, _ = whole.replayed(self.belief.theta, self.lead.end.T[:, None])
        information, score = self.lead.of_friction(self.belief)
        ahead = places[:-1:THINNED, :, 0].transpose(2, 0, 1)
        start = self.after.begin + LOOKBACK
        return Ways(start, self.lead.places, information, score, ahead)

    def replayed(self, known: Known, ahead: float, period: float) -> tuple[Array, Array, Array]:
        """How far the balls are from where their twins are in the end, and how the twins went.

        Args:
            known: Of the friction on the way.
            ahead: Horizon in s.
            period: Seconds between the screen's samples.

        Returns:
            Error in m, shape (W, 2), NaN without a sample; predicted covariance of it in m^2, shape
            (W, 2, 2); places of the twins at every step from the start to the horizon, (W, N, 2).
        """
        points, weights = self._sigma_points(known)
        windows = self.after.resisted(1 + np.repeat(known.ahead, THINNED, axis=1))
        whole = self.belief.problem(windows)
        places, speeds = whole.replayed(*points)
        ball, _ = windows.at_samples(places, speeds, whole.values(points[0])["delay"])
        at = windows.time - (LOOKBACK + ahead)
        # a screen of slow frames has not one in every bin; the twin is asked for the sample's time
        away = np.where(windows.weight[..., 0] > 0, np.abs(at), np.inf)
        rows, sample = np.arange(len(windows)), np.argmin(away, axis=1)
        near = away[rows, sample] <= max(BIN, period) / 2 + 1e-6
        drawn = ball[:, rows, sample]
        middle = np.einsum("c,cwi->wi", weights, drawn)
        off = drawn - middle
        noise = 1 / np.maximum(windows.weight[rows, sample], 1e-12) ** 2
        spread = np.einsum("c,cwi,cwj->wij", weights, off, off) + noise[..., None] * np.eye(2)
        # the smoothed state is that at the begin of the windows, LOOKBACK before the start
        first, gone = round(LOOKBACK / STEP), LOOKBACK + ahead
        steps = round(gone / STEP) + 1
        way = np.einsum("c,nicw->niw", weights, speeds[:steps])
        spread += unforeseen(forces(self.belief, way), gone)
        friction = braking(self.belief, way)
        stretches = slice(friction.shape[1])
        spread += unforeseen(friction, gone, FINE, known.unsure[:, stretches, stretches])
        error = np.where(near[:, None], windows.ball[rows, sample] - middle, np.nan)
        return error, spread, np.einsum("c,nicw->wni", weights, places[first:steps])

    def _sigma_points(self, known: Known) -> tuple[tuple[Array, Array], Array]:
        """Parameters (C, W, P) and starts (4, C, W) for all that may be, and weights (C,).

        Both are what the samples before the start, and what is believed of the parameters and known
        of the screen, make of them.
        """
        mean, covariance = smoothed(self.lead, self.belief, known)
        windows, count = mean.shape
        side = np.sqrt(count + KAPPA) * np.swapaxes(np.linalg.cholesky(covariance), -1, -2)
        sides = np.moveaxis(np.stack((side, -side)), 2, 1)
        moved = mean + np.concatenate((np.zeros((1, windows, count)), *sides))
        every = np.tile(self.belief.theta[:, None], (len(moved), windows, 1))
        for k, name in enumerate(BALL):
            every[..., k] = np.maximum(every[..., k] + moved[..., k], BOUNDS[name].least)
        begun = self.lead.end.T[:, None] + np.moveaxis(moved[..., len(BALL) :], -1, 0)
        weights = np.full(len(moved), 1 / (2 * (count + KAPPA)))
        weights[0] = KAPPA / (count + KAPPA)
        return (every, begun), weights
