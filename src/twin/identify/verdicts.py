"""Verdicts on parameters, and predictions of the held-out part of a log next to baselines."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from controllers.analysis import number
from controllers.arrays import Array, Mask
from twin.base.page import digits
from twin.identify.least_squares import FitProblem, SampleWindows, fit_starts
from twin.identify.parameters import IdentifiedParameter

IDENTIFIED_VERDICT, BOUNDED_VERDICT, NOT_IDENTIFIABLE = "identified", "bounded", "not identifiable"
GIVEN_VERDICT = "given"
"""The parameter is fixed at the given value and not fitted."""
REJECTED_VERDICT = "model rejected"
"""The model does not explain the log: the value is the best fit, and its error is unknown."""
PLAIN_VERDICT = "plain model"
"""The value is of a plain model by the weak form, with a wide interval: nothing finer is known."""
MAX_CORRELATION = 0.95
"""Correlation above which two parameters cannot be distinguished."""


@dataclass(frozen=True, kw_only=True)
class ParameterVerdict:
    """One parameter.

    Attributes:
        about: Which.
        name: Its name on the command line; of the level each axis has one.
        value: Fitted value in the unit of its key; None if the log does not show it.
        low: Lower end of the 95 % interval, in the same unit; None if unknown.
        high: Upper end.
        word: ``identified``, ``bounded`` (only a bound is known), ``plain model`` (the value is of
            a plain model by the weak form, and its interval wide), ``model rejected`` (the value is
            the best fit, and has no interval), ``given`` or ``not identifiable``.
        why: What is wrong and what experiment would show it; empty if identified.
    """

    about: IdentifiedParameter
    name: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    word: str = NOT_IDENTIFIABLE
    why: str = ""

    @property
    def label(self) -> str:
        """Label in tables and sentences: the key, and the axis."""
        axis = self.name.rpartition("_")[2]
        return self.about.key + (f" ({axis})" if axis in {"phi", "theta", "x", "y"} else "")

    @property
    def interval(self) -> str:
        """Its interval in words."""
        if self.low is None and self.high is None:
            return "-"
        if self.high is None:
            return f"above {digits(self.low)}"
        return f"{digits(self.low)} to {digits(self.high)}"

    @classmethod
    def unknown(cls, about: IdentifiedParameter, name: str, why: str) -> ParameterVerdict:
        """Verdict of a parameter that the log does not show, with the experiment that would."""
        return cls(about=about, name=name, why=f"{why}; {about.experiment}")

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "name": self.name,
            "key": self.about.key,
            "unit": self.about.unit,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "verdict": self.word,
            "why": self.why,
        }


@dataclass(frozen=True, kw_only=True)
class HoldOutPrediction:
    """Constants of the predictions of the held-out part.

    Attributes:
        horizons_s: Times ahead at which errors are scored.
        lead_s: Length of the samples from which a prediction starts.
        baseline_s: The same of a ball that stays, and of one that goes on, at most.
        interval_s: Time between the beginnings of two predictions.
        min_motion_m: Distance above which the ball counts as moving.
        horizon_tolerance_s: Largest time between a horizon and the sample that stands for it.
        max_start_steps: Steps by which the starts of predictions are fitted.
    """

    horizons_s: tuple[float, ...] = (0.5, 1.0, 2.0)
    lead_s: float = 0.4
    baseline_s: float = 0.4
    interval_s: float = 0.5
    min_motion_m: float = 0.005
    horizon_tolerance_s: float = 0.06
    max_start_steps: int = 8


HOLD_OUT = HoldOutPrediction()
PREDICTOR_NAMES = ("model", "level followed", "without friction", "stays", "goes on")


@dataclass(frozen=True)
class Predicted:
    """Predictions of W windows.

    Attributes:
        begin: When each prediction begins, s, shape (W,).
        ahead: Seconds of the samples since then, negative before it, shape (W, B).
        ball: Measured, m, shape (W, B); NaN where nothing was.
        by: Predictor to its positions, m, shape (W, B).
        how: Constants of the predictions.
    """

    begin: Array
    ahead: Array
    ball: Array
    by: Mapping[str, Array]
    how: HoldOutPrediction = HOLD_OUT

    @property
    def way(self) -> Array:
        """How far the ball moves after the beginning, m, shape (W,)."""
        there = (self.ahead > -self.how.horizon_tolerance_s) & np.isfinite(self.ball)
        after = np.where(there, self.ball, np.nan)
        return np.asarray(np.nanmax(after, axis=1) - np.nanmin(after, axis=1))

    def errors(self, name: str, horizon: float) -> Array:
        """Error in m at the sample nearest to a horizon in s, shape (W,); NaN without any."""
        off = np.where(np.isfinite(self.ball), np.abs(self.ahead - horizon), np.inf)
        at = off.argmin(axis=1)[:, None]
        error = np.take_along_axis(self.by[name] - self.ball, at, axis=1)[:, 0]
        near = np.take_along_axis(off, at, axis=1)[:, 0] <= self.how.horizon_tolerance_s
        return np.where(near, error, np.nan)

    @property
    def moves(self) -> Mask:
        """Windows in which the ball moves, shape (W,)."""
        return np.asarray(self.way > self.how.min_motion_m)


def predict_windows(
    problem: FitProblem[SampleWindows],
    lead: float,
    by: Mapping[str, Array],
    axes: Sequence[str],
    how: HoldOutPrediction = HOLD_OUT,
) -> dict[str, Predicted]:
    """Predict windows from the samples of their first part, for each axis.

    Args:
        problem: The fitted problem, with windows of the held-out part.
        lead: Length of the first part in s.
        by: Predictor to parameters, shape (1, P) or (1, W, P).
        axes: Of the windows.
        how: Constants of the predictions.
    """
    windows = problem.windows
    ahead, there = windows.time - lead, windows.weight > 0
    known = there & (ahead < 0)[..., None]
    begun, places = problem.first_part(lead), {}
    for who, theta in by.items():
        starts = fit_starts(begun, theta, begun.initial_starts(), how.max_start_steps)
        places[who] = problem.simulate_samples(theta, starts)[0][0]
    ball = np.where(there, windows.ball, np.nan)
    found = {}
    for k, axis in enumerate(axes):
        every = {who: place[..., k] for who, place in places.items()}
        last = ahead >= -how.baseline_s - 1e-9
        every |= _baselines(ahead, ball[..., k], _prefer(known[..., k], last))
        found[axis] = Predicted(windows.begin + lead, ahead, ball[..., k], every, how)
    return found


def _prefer(known: Mask, wanted: Mask) -> Mask:
    """What is wanted of each row of what is known; all of it where none is, shape (W, B)."""
    found = np.asarray(known & wanted)
    return np.asarray(np.where(found.any(axis=1, keepdims=True), found, known))


def _baselines(ahead: Array, ball: Array, known: Mask) -> dict[str, Array]:
    """A ball that stays and one that goes on, by a straight line through what is known, (W, B)."""
    lines = np.zeros((len(ball), 2))
    for w, row in enumerate(known):
        lines[w] = np.polyfit(ahead[w, row], ball[w, row], min(1, int(row.sum()) - 1))[-2:]
    return {
        "stays": np.broadcast_to(lines[:, 1:], ball.shape),
        "goes on": lines[:, 1:] + lines[:, :1] * ahead,
    }


def absolute_quantile(errors: Array, share: float) -> float:
    """Bound within which a share of the errors stays; NaN if none is known."""
    sizes = np.abs(errors[np.isfinite(errors)])
    return float(np.quantile(sizes, share)) if len(sizes) else float("nan")


@dataclass(frozen=True)
class PredictionScore:
    """Errors of one or two axes where the ball moves.

    Attributes:
        axes: Which, as ``x`` or ``xy``.
        windows: How many moving windows there are.
        known: How many of them have a sample at each horizon.
        median: Predictor to the median error after each horizon, m.
        ninety: The same, that 90 % of the windows stay within.
    """

    axes: str
    windows: int
    known: Sequence[int]
    median: Mapping[str, Sequence[float]]
    ninety: Mapping[str, Sequence[float]]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``; None where nothing is known."""
        out = asdict(self)
        for table in (out["median"], out["ninety"]):
            table.update({who: list(map(number, row)) for who, row in table.items()})
        return out


def score(found: Mapping[str, Predicted]) -> PredictionScore:
    """The errors of axes with predictions that begin at the same times."""
    every = list(found.values())
    how = every[0].how
    moves = np.hypot.reduce([each.way for each in every]) > how.min_motion_m
    off = {
        who: [
            np.sqrt(sum(e.errors(who, ahead) ** 2 for e in every))[moves]
            for ahead in how.horizons_s
        ]
        for who in PREDICTOR_NAMES
        if who in every[0].by
    }
    median, ninety = (
        {who: [absolute_quantile(each, share) for each in errors] for who, errors in off.items()}
        for share in (0.5, 0.9)
    )
    known = [int(np.isfinite(each).sum()) for each in off["model"]]
    return PredictionScore("".join(found), int(moves.sum()), known, median, ninety)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Parameters and predictions that a log gives, by either model.

    Attributes:
        source: Name of the log.
        seconds: Length of the fitted part.
        verdicts: Of the requested parameters.
        scores: On the held-out part, of one axis or of both together.
        predictions: Axis to its predictions there.
        notes: What was left out or assumed, in words.
        extent: How much of the log was used, in words.
        remarks: Further results of the fit, in sentences.
        on: The rig that the parameters are set over; empty for the rig of a scenario.
        how: Constants of the predictions.
        warned: The notes that were already given as warnings while the log was fitted.
    """

    source: str
    seconds: float
    verdicts: tuple[ParameterVerdict, ...]
    scores: tuple[PredictionScore, ...]
    predictions: Mapping[str, Predicted]
    notes: tuple[str, ...]
    extent: str
    remarks: tuple[str, ...]
    on: str = ""
    how: HoldOutPrediction = HOLD_OUT
    warned: tuple[str, ...] = ()

    @property
    def over(self) -> dict[str, str]:
        """The setting by which the parameters lie over a rig."""
        return {"parameters": json.dumps(self.on)} if self.on else {}

    def settings(self, words: Collection[str]) -> dict[str, str]:
        """Scenario keys to values in TOML with remarks, of those with one of some verdicts."""
        raise NotImplementedError

    def as_dict(self) -> dict[str, Any]:
        """The numbers, for ``--json``."""
        return {
            "log": self.source,
            "fitted_seconds": self.seconds,
            "parameters": [each.as_dict() for each in self.verdicts],
            "ahead": self.how.horizons_s,
            "held_out": [each.as_dict() for each in self.scores],
            "notes": list(self.notes),
        }
