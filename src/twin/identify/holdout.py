"""How far a replay strays from a part of the log that no fit has seen, beside two baselines."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.identify.descend import settle
from twin.identify.motion import plate_motion
from twin.identify.phases import Spans
from twin.identify.prepare import Data
from twin.identify.problem import Problem
from twin.identify.search import Fit
from twin.identify.windows import BIN, LOOKBACK, Windows

HORIZONS = (0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0)
"""Seconds ahead."""
LEAD = 0.4
"""Seconds of samples from which a replay's start is taken."""
EVERY = 0.5
"""Seconds between the begins of two replays."""


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


def hold_out(data: Data, fit: Fit, lag: float) -> Horizons | None:
    """Replay a part of the log from many begins; None if it is too short for any.

    Args:
        data: The part held out.
        fit: The parameters.
        lag: Time constant of the drives in s.
    """
    windows = _cut(data, lag)
    if windows is None:
        return None
    names, model = fit.problem.names, fit.problem.model
    none = fit.theta.copy()
    for name, nothing in (("rolling", 0.0), ("breakaway", 1.0), ("viscous", 0.0)):
        if name in names:
            none[names.index(name)] = nothing
    delay = float(fit.theta[names.index("delay")])
    lead = windows.time < LOOKBACK + LEAD
    known = replace(windows, weight=windows.weight * lead[..., None])
    places = [
        _replayed(Problem(model, known, names, fit.problem.grip), theta, delay)
        for theta in (fit.theta, none)
    ]
    last = np.maximum(lead.sum(axis=1) - 1, 0)
    rows = np.arange(len(windows))
    # the ball that stays: where the fitted twin sees it when the samples for the start end
    still = np.broadcast_to(places[0][rows, last][:, None], places[0].shape)
    counted = windows.weight[..., 0] > 0
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
    of = int(np.argsort(distance["twin"].mean(axis=1))[len(rows) // 2])
    seen = counted[of]
    example = (
        windows.time[of, seen] - LOOKBACK - LEAD,
        windows.ball[of, seen],
        places[0][of, seen],
    )
    noise = float(np.hypot(*(data.sigma / np.sqrt(max(1, BIN / data.sample_period)))))
    return Horizons(
        ahead=np.array(HORIZONS),
        twin=np.array(medians["twin"]),
        frictionless=np.array(medians["frictionless"]),
        still=np.array(medians["still"]),
        noise=noise,
        replays=np.array(replays),
        example=example,
    )


def _cut(data: Data, lag: float) -> Windows | None:
    longest = LEAD + HORIZONS[-1] + BIN
    parts = []
    for stretch in data.stretches:
        begin, end = stretch.time[0] + LOOKBACK, min(stretch.time[-1], stretch.seen[-1])
        begins = np.arange(begin, end - longest, EVERY)
        if len(begins):
            motion = plate_motion(stretch.time, stretch.plate, stretch.command, lag, data.own_lag)
            lengths = np.full(len(begins), longest)
            spans = Spans(begins, lengths, np.zeros(len(begins), bool))
            parts.append(Windows.cut(data.model, motion, stretch, spans, data.sigma, longest))
    return Windows.join(parts) if parts else None


def _replayed(problem: Problem, theta: Array, delay: float) -> Array:
    """Where the screen would have seen the ball, shape (W, B, 2)."""
    values = theta[None]
    starts, _ = settle(problem, values, problem.starts(), 6)
    places, speeds = problem.replayed(values, starts)
    return np.asarray(problem.windows.seen(places, speeds, np.full((1, 1), delay))[0][0])
