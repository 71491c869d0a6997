"""What else might explain the experiments: each idea with its numbers, the friction fitted anew."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import radians
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.thesis.experiments.batch import Trace, onwards, simulate
from twin.thesis.experiments.fit import identified
from twin.thesis.experiments.judge import e_tt
from twin.thesis.experiments.rig import Rig
from twin.thesis.experiments.tables import CALIBRATION, Experiment, chosen

FIFTEEN = ("9.2", "9.4", "9.5", "9.6", "9.7")
SLIDING = ("9.8", "9.9")
LATE, EARLY = ("9.2", "9.4", "9.6", "9.8"), ("9.3", "9.5", "9.7", "9.9")
"""Tables without and with predictor, pair by pair."""
DURATION = 25.0


@dataclass(frozen=True)
class Hypothesis:
    """An idea: what about the rig, or about the reading of its records, would be different.

    Attributes:
        name: In words.
        settings: Fields of ``Rig``.
        reading: Where the ball is taken to be; None for the identified reading.
        start: From when on, s; None for the identified window.
        why: Where its size comes from.
    """

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    reading: str | None = None
    start: float | None = None
    why: str = ""


HYPOTHESES = (
    Hypothesis("rolling friction only"),
    Hypothesis("e_tt from the true ball", reading="truth", why="no rig knows it"),
    Hypothesis("e_tt from the late measurement", reading="measurement", why="screen as logged"),
    Hypothesis("without the first 10 s", start=10.0, why="start left out, as in chapter 8"),
    Hypothesis(
        "falling friction, slow",
        {"breakaway_ratio": 1.5, "stribeck_speed": 0.02},
        why="Stribeck speeds of dry contacts: mm/s to cm/s",
    ),
    Hypothesis("falling friction, fast", {"breakaway_ratio": 2.0, "stribeck_speed": 0.05}),
    Hypothesis(
        "stiction after rest",
        {"breakaway_ratio": 3.0, "stribeck_speed": 0.005, "dwell_time": 0.5},
        why="grows at rest only",
    ),
    Hypothesis("viscous part", {"viscous": 0.3e-3}, why="doubles friction at 0.6 m/s"),
    Hypothesis("servo lag 50 ms", {"servo_lag": 0.05}, why="far slower than an AKD drive"),
    Hypothesis("servo lag 80 ms", {"servo_lag": 0.08}),
    Hypothesis("dead time 42.56 ms", {"dead_time": 0.04256}, why="mean of Table 7.1"),
    Hypothesis("dead time 55 ms", {"dead_time": 0.055}, why="with frames; predictor knows 42"),
    Hypothesis("plate off level", {"level": (radians(0.2), radians(0.1))}, why="a spirit level"),
    Hypothesis("axes coupled by 20 %", {"coupling": 0.2}, why="chapter 10 saw coupling"),
    Hypothesis("cam tables 15 % wrong", {"cam_error": 0.15}, why="one slope for all angles"),
    Hypothesis("plate rate limited to 3 deg/s", {"rate": radians(3.0)}, why="9.2.4, no number"),
    Hypothesis("faster observer", {"poles": (-16, -20, -28, -32)}, why="twice (8.1)"),
    Hypothesis("slower observer", {"poles": (-5, -6, -8, -9)}, why="0.6 of (8.1)"),
    Hypothesis("noise held 0.1 s", {"hold": 50, "noise": 1.0}, why="as in chapter 8"),
    Hypothesis("ten times the noise", {"noise": 10.0, "hold": 5}, why="moving finger, 10 ms"),
    Hypothesis(
        "plate trembles, 3 rad/s^2 at 5 Hz",
        {"dither": 3.0, "dither_frequency": 5.0},
        why="'oscillatory movement' of the spring",
    ),
    Hypothesis(
        "uneven screen: 0.3 deg, friction 30 %",
        {"waves": radians(0.3), "patches": 0.3},
        why="one screen drawn at random",
    ),
    Hypothesis("ball's mass 0.1 mm off its middle", {"offset": 0.1e-3}, why="9.2.1; mechanism"),
    Hypothesis("sigmoid half as wide", {"epsilon": 0.15}, why="sliding mode only"),
)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """What a hypothesis does to the tables once the friction is fitted anew to Table 9.3.

    Attributes:
        hypothesis: The idea.
        rolling: Its friction in m.
        calibration: Root mean square deviation in Table 9.3, points.
        mean: Mean absolute deviation of the 15 predicted errors, points.
        worst: Largest of them.
        sliding: Mean absolute deviation of the six of the sliding mode.
        gap: By how much the errors without predictor exceed those with, mean over all laws.
        fall: Error at 1 over that at 0.5 rad/s in Table 9.9.
    """

    hypothesis: Hypothesis
    rolling: float
    calibration: float
    mean: float
    worst: float
    sliding: float
    gap: float
    fall: float


def circles() -> list[Experiment]:
    """The 24 experiments that have a tracking error."""
    return [experiment for experiment in chosen() if experiment.omega is not None]


def measured() -> Array:
    """The thesis's 24 tracking errors in %."""
    return np.array([experiment.cells["e_tt"] for experiment in circles()])


def effects(advance: Callable[[float], None] = lambda _: None) -> list[Effect]:
    """Every hypothesis on the exact model, two frictions each, between which it is fitted."""
    rigs, arms = [], []
    for hypothesis in HYPOTHESES:
        rough = 0.7 if hypothesis.settings.get("breakaway_ratio", 1.0) > 1.4 else 1.0
        for factor in (0.8, 1.1):
            arms.append(rough * factor * identified().rolling)
            rigs.append(replace(Rig(rolling=arms[-1], noise=0.0), **hypothesis.settings))
    own = [i for i, rig in enumerate(rigs) if rig.offset]
    rest = [i for i in range(len(rigs)) if i not in own]
    traces: list[list[Trace]] = [[None] * len(rigs) for _ in circles()]  # type: ignore[list-item]
    done = 0
    for mechanism, indices in ((False, rest), (True, own)):
        found = simulate(
            circles(),
            [rigs[i] for i in indices],
            mechanism=mechanism,
            duration=DURATION,
            progress=onwards(advance, done / len(rigs), 1 / (DURATION * len(rigs))),
        )
        done += len(indices)
        for row, mine in zip(traces, found, strict=True):
            for i, trace in zip(indices, mine, strict=True):
                row[i] = trace
    return [
        _effect(hypothesis, arms[2 * i : 2 * i + 2], [row[2 * i : 2 * i + 2] for row in traces])
        for i, hypothesis in enumerate(HYPOTHESES)
    ]


def _effect(hypothesis: Hypothesis, arms: list[float], traces: list[list[Trace]]) -> Effect:
    known = identified()
    reading = hypothesis.reading or known.reading
    start = known.start if hypothesis.start is None else hypothesis.start
    low, high = np.array([[e_tt(trace, reading, start) for trace in row] for row in traces]).T
    own = np.array([experiment.table == CALIBRATION for experiment in circles()])
    slope = high - low
    share = float((slope[own] * (measured() - low)[own]).sum() / (slope[own] ** 2).sum())
    return summary(hypothesis, arms[0] + share * (arms[1] - arms[0]), low + share * slope)


def summary(hypothesis: Hypothesis, rolling: float, errors: Array) -> Effect:
    """The deviations of 24 tracking errors in % from the thesis's."""
    names = np.array([experiment.table for experiment in circles()])
    off = errors - measured()
    fifteen = np.abs(off[np.isin(names, FIFTEEN)])
    late, early = errors[np.isin(names, LATE)], errors[np.isin(names, EARLY)]
    last = errors[names == SLIDING[-1]]
    return Effect(
        hypothesis=hypothesis,
        rolling=rolling,
        calibration=float(np.sqrt((off[names == CALIBRATION] ** 2).mean())),
        mean=float(fifteen.mean()),
        worst=float(fifteen.max()),
        sliding=float(np.abs(off[np.isin(names, SLIDING)]).mean()),
        gap=float((late - early).mean()),
        fall=float(last[-1] / last[0]),
    )
