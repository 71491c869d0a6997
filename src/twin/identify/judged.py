"""What a fit predicts of what was held out, where the ball moves, beside baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from controllers.analysis import number
from controllers.arrays import Array, Mask
from twin.errors import LogError
from twin.identify.any_log import AxisLog
from twin.identify.plain import AxisFit, AxisWindows, Tilt
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.problem import Problem
from twin.identify.search import BestFit, fit_starts
from twin.identify.verdict import ParameterVerdict
from twin.identify.windows import LOOKBACK, Spans, cut

HORIZONS = (0.5, 1.0, 2.0)
"""Seconds ahead."""
LEAD = 0.4
"""Seconds of samples from which a prediction begins."""
PAST = 2.4
"""Seconds of samples of which a level that is followed is known."""
EVERY = 0.5
"""Seconds between the beginnings of two predictions."""
MOVES = 0.005
"""Way in m from which on a ball moves."""
NEAR = 0.06
"""A sample so near to a horizon in s is taken for it."""
FOLLOWED = 0.1
"""How far off in m/s^2 a level that is followed may be from that of the fit: standard deviation."""
PREDICTORS = ("model", "level followed", "without friction", "stays", "goes on")


@dataclass(frozen=True)
class Predicted:
    """Predictions of W windows.

    Attributes:
        begin: When each prediction begins, s, shape (W,).
        ahead: Seconds of the samples since then, negative before it, shape (W, B).
        ball: Measured, m, shape (W, B); NaN where nothing was.
        by: Who predicts, to what, m, shape (W, B).
    """

    begin: Array
    ahead: Array
    ball: Array
    by: Mapping[str, Array]

    @property
    def way(self) -> Array:
        """How far the ball moves after the beginning, m, shape (W,)."""
        after = np.where((self.ahead > -NEAR) & np.isfinite(self.ball), self.ball, np.nan)
        return np.asarray(np.nanmax(after, axis=1) - np.nanmin(after, axis=1))

    def errors(self, name: str, horizon: float) -> Array:
        """Error in m at the sample nearest to a horizon in s, shape (W,); NaN without any."""
        off = np.where(np.isfinite(self.ball), np.abs(self.ahead - horizon), np.inf)
        at = off.argmin(axis=1)[:, None]
        error = np.take_along_axis(self.by[name] - self.ball, at, axis=1)[:, 0]
        return np.where(np.take_along_axis(off, at, axis=1)[:, 0] <= NEAR, error, np.nan)


def predicted(log: AxisLog, fit: AxisFit, at: Array, *, follow: bool = True) -> Predicted:
    """Predict from times in s on, shape (W,), by what was measured before.

    Args:
        log: The axis, held out.
        fit: The model.
        at: When predictions begin.
        follow: Whether a level that is followed is tried as well.
    """
    names, theta, tilt = fit.problem.names, fit.found.theta, Tilt(log, fit.problem.tilt.scale)
    windows = AxisWindows.of(log, at - LEAD, at + HORIZONS[-1] + NEAR)
    ahead, there = windows.time - LEAD, windows.weight > 0
    ball = np.where(there, windows.ball, np.nan)
    known = there & (ahead < 0)
    lead = replace(windows, weight=windows.weight / fit.noise * known)
    longest = LEAD + HORIZONS[-1] + 2 * NEAR
    problem = replace(fit.problem, windows=lead, tilt=tilt, longest=longest)

    def simulated(**changes: Array | float) -> Array:
        values = np.repeat(theta[:, None], len(at), axis=1)
        for name, change in changes.items():
            if name in names:
                values[..., names.index(name)] *= change if name == "friction" else 1.0
                values[..., names.index(name)] += change if name == "level" else 0.0
        starts = fit_starts(problem, values, problem.initial_starts(), 8)
        return np.asarray(problem.reported(values, starts)[0][0])

    by = {"model": simulated(), **_baselines(ahead, ball, known)}
    if follow:
        windows = AxisWindows.of(log, at - PAST, at)
        windows = replace(windows, weight=windows.weight / fit.sigma)
        past = replace(fit.problem, windows=windows, tilt=tilt, longest=PAST + NEAR, drift=FOLLOWED)
        starts = fit_starts(past, theta, past.initial_starts(), 8)
        by["without friction"] = simulated(friction=0.0)
        by["level followed"] = simulated(level=starts[2])
    found = Predicted(at, ahead, ball, by)
    return _switched(found) if follow else found


def _baselines(ahead: Array, ball: Array, known: Mask) -> dict[str, Array]:
    """A ball that stays and one that goes on, by a straight line through what is known, (W, B)."""
    lines = np.zeros((len(ball), 2))
    for w, row in enumerate(known):
        lines[w] = np.polyfit(ahead[w, row], ball[w, row], min(1, int(row.sum()) - 1))[-2:]
    return {
        "stays": np.broadcast_to(lines[:, 1:], ball.shape),
        "goes on": lines[:, 1:] + lines[:, :1] * ahead,
    }


def replayed(log: PreparedLog, fit: BestFit, lag: float) -> dict[str, Predicted]:
    """Replay a part of a log by a fitted twin from many starts: both axes, or none if too short.

    Args:
        log: The part held out.
        fit: The parameters.
        lag: Time constant of the drives in s.
    """
    windows = cut(log, lag, LEAD + HORIZONS[-1] + NEAR, _overlapping_spans)
    if windows is None:
        return {}
    lead = LOOKBACK + LEAD
    there = windows.weight[..., 0] > 0
    before = (there & (windows.time < lead)).sum(axis=1)
    windows = windows.take((before >= 3) & (there.sum(axis=1) > before))
    if not len(windows):
        return {}
    ahead, there = windows.time - lead, windows.weight[..., 0] > 0
    known = there & (ahead < 0)
    names = fit.problem.names
    begun = replace(windows, weight=windows.weight * known[..., None])
    problem = Problem(fit.problem.model, begun, names, fit.problem.grip)
    frictionless = fit.theta.copy()
    for name, value in (("rolling", 0.0), ("breakaway", 1.0), ("viscous", 0.0)):
        if name in names:
            frictionless[names.index(name)] = value
    places = {}
    for who, theta in (("model", fit.theta[None]), ("without friction", frictionless[None])):
        starts = fit_starts(problem, theta, problem.initial_starts(), 6)
        places[who] = problem.reported(theta, starts)[0][0]
    ball = np.where(there[..., None], windows.ball, np.nan)
    return {
        axis: Predicted(
            windows.begin + lead,
            ahead,
            ball[..., k],
            {who: place[..., k] for who, place in places.items()}
            | _baselines(ahead, ball[..., k], known),
        )
        for k, axis in enumerate("xy")
    }


def _overlapping_spans(_: Segment, begin: float, end: float, longest: float) -> Spans:
    begins = np.arange(begin, end - longest, EVERY)
    return Spans(begins, np.full(len(begins), longest), np.zeros(len(begins), bool))


def _switched(found: Predicted) -> Predicted:
    """The level followed only while that has predicted better, in what had been seen by then."""
    gained = [np.log(np.maximum(np.abs(found.errors(name, 1.0)), 1e-4)) for name in PREDICTORS[:2]]
    gain = np.where(found.way > MOVES, gained[0] - gained[1], np.nan)
    seen = found.begin[:, None] >= found.begin + 1.0 + NEAR
    so_far = np.nansum(np.where(seen, gain, 0.0), axis=1)
    followed = np.where(so_far[:, None] > 0, found.by["level followed"], found.by["model"])
    return replace(found, by={**found.by, "level followed": followed})


def beginnings(log: AxisLog) -> Array:
    """When predictions begin: every half second with enough samples before and after, s."""
    time = log.sampled
    if len(time) < 10:
        return np.zeros(0)
    tries = np.arange(time[0] + PAST, time[-1] - HORIZONS[0], EVERY)
    step = float(np.median(np.diff(time)))
    before, past, after = (
        np.searchsorted(time, tries + last) - np.searchsorted(time, tries + first)
        for first, last in ((-LEAD, 0.0), (-PAST, 0.0), (0.0, HORIZONS[0] + NEAR))
    )
    return tries[(before >= max(3, 0.5 * LEAD / step)) & (past >= 0.5 * PAST / step) & (after > 0)]


def crossed(fit: AxisFit, names: tuple[str, ...], longest: float) -> float:
    """Error in m of fits of each half of a log by these parameters, in the other half.

    The geometric mean of the medians over all horizons where the ball moves; infinite if unknown.
    """
    time = fit.log.sampled
    middle = float(np.median(time))
    halves = fit.log.between(-np.inf, middle), fit.log.between(middle, np.inf)
    medians = []
    for fitted, tried in (halves, halves[::-1]):
        at = beginnings(tried)
        if len(at) < 3:
            return np.inf
        try:
            found = predicted(tried, fit.again(fitted, names, longest), at, follow=False)
        except LogError:  # a half has too few windows
            return np.inf
        moves = found.way > MOVES
        medians += [_quantile(found.errors("model", ahead)[moves], 0.5) for ahead in HORIZONS]
    return float(np.exp(np.mean(np.log(medians)))) if np.isfinite(medians).all() else np.inf


def _quantile(errors: Array, share: float) -> float:
    sizes = np.abs(errors[np.isfinite(errors)])
    return float(np.quantile(sizes, share)) if len(sizes) else float("nan")


@dataclass(frozen=True)
class Score:
    """Errors of one or two axes where the ball moves.

    Attributes:
        axes: Which, as ``x`` or ``xy``.
        windows: How many moving windows there are.
        median: Predictor to the median error after each of ``HORIZONS``, m.
        ninety: The same, that 90 % of the windows stay within.
    """

    axes: str
    windows: int
    median: Mapping[str, Sequence[float]]
    ninety: Mapping[str, Sequence[float]]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``; None where nothing is known."""
        out = asdict(self)
        for table in (out["median"], out["ninety"]):
            table.update({who: list(map(number, row)) for who, row in table.items()})
        return out


def score(found: Mapping[str, Predicted]) -> Score:
    """The errors of axes whose predictions begin at the same times."""
    way = np.hypot.reduce([each.way for each in found.values()])
    moves = way > MOVES
    out: list[dict[str, list[float]]] = [{}, {}]
    by = next(iter(found.values())).by
    for name in filter(by.__contains__, PREDICTORS):
        for share, into in zip((0.5, 0.9), out, strict=True):
            into[name] = [
                _quantile(
                    np.sqrt(sum(each.errors(name, ahead) ** 2 for each in found.values()))[moves],
                    share,
                )
                for ahead in HORIZONS
            ]
    return Score("".join(found), int(moves.sum()), *out)


@dataclass(frozen=True, kw_only=True)
class Identified:
    """What any identification has.

    Attributes:
        source: What the log is called.
        seconds: That were fitted.
        verdicts: Of the parameters asked for.
        scores: On what was held out, of one axis or of both together.
        predictions: Axis to its predictions there.
        notes: What was left out or assumed, in words.
    """

    source: str
    seconds: float
    verdicts: tuple[ParameterVerdict, ...]
    scores: tuple[Score, ...]
    predictions: Mapping[str, Predicted]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The numbers, for ``--json``."""
        return {
            "log": self.source,
            "fitted_seconds": self.seconds,
            "parameters": [each.as_dict() for each in self.verdicts],
            "ahead": HORIZONS,
            "held_out": [each.as_dict() for each in self.scores],
            "notes": list(self.notes),
        }
