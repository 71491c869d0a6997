"""Hold-out validation: how far a replay strays from a part of the log that no fit has used."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.identify.levenberg_marquardt import fit_starts
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.problem import Problem
from twin.identify.search import FitResult
from twin.identify.windows import BIN, LOOKBACK, Spans, cut

HORIZONS = (0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0)
"""Seconds ahead."""
LEAD = 0.4
"""Seconds of samples from which a replay's start is taken."""
LONGEST = LEAD + HORIZONS[-1] + BIN
"""Seconds that a replay lasts."""
EVERY = 0.5
"""Seconds between the starts of two replays."""


@dataclass(frozen=True)
class Horizons:
    """Distance of replay and measured ball, a horizon after the last sample used for the start.

    Attributes:
        ahead: Horizons in s, shape (H,).
        twin: Median distance of the fitted twin in m, shape (H,).
        frictionless: The same twin without friction.
        still: A ball that stays where it was.
        noise: What the screen's noise alone makes of it, m.
        replays: How many replays there are at each horizon, shape (H,).
        example: Time in s, measured and replayed ball in m of one replay, shapes (K,), (K, 2).
    """

    ahead: Array
    twin: Array
    frictionless: Array
    still: Array
    noise: float
    replays: NDArray[np.int_]
    example: tuple[Array, Array, Array]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``; None where there is no replay."""
        distances = {
            name: [None if math.isnan(v) else float(v) for v in getattr(self, name)]
            for name in ("ahead", "twin", "frictionless", "still")
        }
        return {**distances, "noise": self.noise}


def hold_out(log: PreparedLog, fit: FitResult, lag: float) -> Horizons | None:
    """Replay a part of the log from many starts; None if it is too short for any.

    Args:
        log: The part held out.
        fit: The parameters.
        lag: Time constant of the drives in s.
    """
    windows = cut(log, lag, LONGEST, _overlapping_spans)
    if windows is None:
        return None
    names, model = fit.problem.names, fit.problem.model
    frictionless = fit.theta.copy()
    for name, value in (("rolling", 0.0), ("breakaway", 1.0), ("viscous", 0.0)):
        if name in names:
            frictionless[names.index(name)] = value
    delay = float(fit.theta[names.index("delay")])
    counted = windows.weight[..., 0] > 0
    lead = counted & (windows.time < LOOKBACK + LEAD)
    known = replace(windows, weight=windows.weight * lead[..., None])
    places = [
        _replayed(Problem(model, known, names, fit.problem.grip), theta, delay)
        for theta in (fit.theta, frictionless)
    ]
    last = np.max(lead * np.arange(lead.shape[1]), axis=1)
    rows = np.arange(len(windows))
    # the ball that stays: where the fitted twin has it at the last sample for the start
    still = np.broadcast_to(places[0][rows, last][:, None], places[0].shape)
    distance = {
        name: np.hypot(*np.moveaxis(place - windows.ball, -1, 0))
        for name, place in (("twin", places[0]), ("frictionless", places[1]), ("still", still))
    }
    ahead = windows.time - (LOOKBACK + LEAD)
    medians: dict[str, list[float]] = {name: [] for name in distance}
    replays = []
    for horizon in HORIZONS:
        near = counted & (np.abs(ahead - horizon) <= BIN / 2)
        replays.append(int(near.sum()))
        for name, values in distance.items():
            medians[name].append(float(np.median(values[near])) if near.any() else np.nan)
    mean = np.nanmean(np.where(counted, distance["twin"], np.nan), axis=1)
    median = int(np.argsort(mean)[len(rows) // 2])
    shown = median, counted[median]
    example = (windows.time[shown] - LOOKBACK - LEAD, windows.ball[shown], places[0][shown])
    noise = float(np.hypot(*(log.sigma / np.sqrt(max(1, BIN / log.sample_period)))))
    return Horizons(
        ahead=np.array(HORIZONS),
        twin=np.array(medians["twin"]),
        frictionless=np.array(medians["frictionless"]),
        still=np.array(medians["still"]),
        noise=noise,
        replays=np.array(replays),
        example=example,
    )


def _overlapping_spans(_: Segment, begin: float, end: float, longest: float) -> Spans:
    begins = np.arange(begin, end - longest, EVERY)
    return Spans(begins, np.full(len(begins), longest), np.zeros(len(begins), bool))


def _replayed(problem: Problem, theta: Array, delay: float) -> Array:
    """What the screen would have reported, m, shape (W, B, 2)."""
    values = theta[None]
    starts = fit_starts(problem, values, problem.initial_starts(), 6)
    places, speeds = problem.replayed(values, starts)
    return np.asarray(problem.windows.at_samples(places, speeds, np.full((1, 1), delay))[0][0])
