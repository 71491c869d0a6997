"""What else might explain the experiments: each idea alone, the friction fitted again beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import tau

import numpy as np

from controllers.arrays import Array
from twin.jobs import cores, results
from twin.thesis.experiments.batch import RigKeys, noise, rolling, simulate
from twin.thesis.experiments.fit import identified
from twin.thesis.experiments.judge import ExperimentTrace, e_tt
from twin.thesis.experiments.tables import (
    CALIBRATION,
    EARLY,
    FIFTEEN,
    LATE,
    SLIDING,
    MeasuredExperiment,
    chosen,
)

BREAKAWAY, STRIBECK = "plant.friction.breakaway_ratio", "plant.friction.stribeck_speed"
BANDWIDTH = "plant.servo.bandwidth_hz"
DURATION = 25.0
MOST_PROCESSES = 8


@dataclass(frozen=True)
class Hypothesis:
    """An idea: what about the rig, or about the reading of its records, would be different.

    Attributes:
        name: In words.
        settings: Scenario keys of the rig.
        reading: Where the ball is taken to be; None for the identified reading.
        start: From when on, s; None for the identified window.
        why: Where its size comes from.
        mechanism: Whether only the MuJoCo mechanism can show it.
    """

    name: str
    settings: RigKeys = field(default_factory=dict)
    reading: str | None = None
    start: float | None = None
    why: str = ""
    mechanism: bool = False


HYPOTHESES = (
    Hypothesis("rolling friction only"),
    Hypothesis("e_tt from the true ball", reading="truth", why="no rig knows it"),
    Hypothesis("e_tt from the late measurement", reading="measurement", why="screen as logged"),
    Hypothesis("without the first 10 s", start=10.0, why="start left out, as in chapter 8"),
    Hypothesis(
        "falling friction, slow",
        {BREAKAWAY: 1.5, STRIBECK: 0.02},
        why="Stribeck speeds of dry contacts: mm/s to cm/s",
    ),
    Hypothesis("falling friction, fast", {BREAKAWAY: 2.0, STRIBECK: 0.05}),
    Hypothesis(
        "stiction after rest",
        {BREAKAWAY: 3.0, STRIBECK: 0.005, "plant.friction.dwell_time": 0.5},
        why="grows at rest only",
    ),
    Hypothesis(
        "viscous part", {"plant.friction.viscous_mm": 0.3}, why="doubles friction at 0.6 m/s"
    ),
    Hypothesis(
        "servo lag 50 ms", {BANDWIDTH: 1 / (tau * 0.05)}, why="far slower than an AKD drive"
    ),
    Hypothesis("servo lag 80 ms", {BANDWIDTH: 1 / (tau * 0.08)}),
    Hypothesis("dead time 42.56 ms", {"sensors.touch.dead_time": 0.04256}, why="mean of Table 7.1"),
    Hypothesis(
        "dead time 55 ms", {"sensors.touch.dead_time": 0.055}, why="with frames; predictor knows 42"
    ),
    Hypothesis("plate off level", {"plant.level_deg": (0.2, 0.1)}, why="a spirit level"),
    Hypothesis(
        "axes coupled by 20 %", {"rig.cam_coupling_percent": 20.0}, why="chapter 10 saw coupling"
    ),
    Hypothesis(
        "cam tables 15 % wrong",
        {"rig.cam_error_percent": (15.0, 15.0)},
        why="one slope for all angles",
    ),
    Hypothesis(
        "plate rate limited to 3 deg/s", {"rig.limits.rate_deg": 3.0}, why="9.2.4, no number"
    ),
    Hypothesis("faster observer", {"observer.poles": (-16, -20, -28, -32)}, why="twice (8.1)"),
    Hypothesis("slower observer", {"observer.poles": (-5, -6, -8, -9)}, why="0.6 of (8.1)"),
    Hypothesis(
        "noise held 0.1 s", {**noise(1.0), "sensors.noise_hold": 0.1}, why="as in chapter 8"
    ),
    Hypothesis(
        "ten times the noise",
        {**noise(10.0), "sensors.noise_hold": 0.01},
        why="moving finger, 10 ms",
    ),
    Hypothesis(
        "plate trembles, 3 rad/s^2 at 5 Hz",
        {"plant.servo.vibration": 3.0, "plant.servo.vibration_hz": 5.0},
        why="'oscillatory movement' of the spring",
    ),
    Hypothesis(
        "uneven screen: 0.3 deg, friction 30 %",
        {"plant.surface.slope_deg": 0.3, "plant.surface.spread_percent": 30.0},
        why="one screen drawn at random",
    ),
    Hypothesis(
        "ball's mass 0.1 mm off its middle",
        {"plant.ball.offset_mm": (0.1, 0.0, 0.0)},
        why="9.2.1; mechanism",
        mechanism=True,
    ),
    Hypothesis("sigmoid half as wide", {"controller.epsilon": 0.15}, why="sliding mode only"),
)


@dataclass(frozen=True, kw_only=True)
class HypothesisResult:
    """What a hypothesis does to the tables once the friction is refitted to Table 9.3.

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


def circles() -> list[MeasuredExperiment]:
    """The 24 experiments that have a tracking error."""
    return [experiment for experiment in chosen() if experiment.omega is not None]


def measured() -> Array:
    """The thesis's 24 tracking errors in %, shape (24,)."""
    return np.array([experiment.cells["e_tt"] for experiment in circles()])


def evaluated(advance: Callable[[float], None] = lambda _: None) -> list[HypothesisResult]:
    """Every hypothesis, on several processes.

    Args:
        advance: Called with the share done, 0 to 1.

    Raises:
        TwinError: If a simulation cannot be built, or a process is killed.
    """
    found: dict[int, HypothesisResult] = {}
    processes = min(cores(), MOST_PROCESSES)
    for index, result in results(evaluate, enumerate(HYPOTHESES), processes):
        found[index] = result
        advance(len(found) / len(HYPOTHESES))
    return [found[index] for index in sorted(found)]


def evaluate(hypothesis: Hypothesis) -> HypothesisResult:
    """A hypothesis with two frictions, between which it is fitted."""
    rough = 0.7 if hypothesis.settings.get(BREAKAWAY, 1.0) > 1.4 else 1.0
    arms = [rough * factor * identified().rolling for factor in (0.8, 1.1)]
    traces = simulate(
        circles(),
        [{**rolling(arm), **noise(0.0), **hypothesis.settings} for arm in arms],
        mechanism=hypothesis.mechanism,
        duration=DURATION,
    )
    return _fitted(hypothesis, arms, traces)


def _fitted(
    hypothesis: Hypothesis, arms: list[float], traces: list[list[ExperimentTrace]]
) -> HypothesisResult:
    """The result at the friction between two arms at which Table 9.3 is met best."""
    known = identified()
    reading = hypothesis.reading or known.reading
    start = known.start if hypothesis.start is None else hypothesis.start
    low, high = np.array([[e_tt(trace, reading, start) for trace in row] for row in traces]).T
    own = np.array([experiment.table == CALIBRATION for experiment in circles()])
    slope = high - low
    share = float((slope[own] * (measured() - low)[own]).sum() / (slope[own] ** 2).sum())
    return summary(hypothesis, arms[0] + share * (arms[1] - arms[0]), low + share * slope)


def summary(hypothesis: Hypothesis, rolling: float, errors: Array) -> HypothesisResult:
    """The deviations of 24 tracking errors in % from the thesis's."""
    names = np.array([experiment.table for experiment in circles()])
    off = errors - measured()
    fifteen = np.abs(off[np.isin(names, FIFTEEN)])
    late, early = errors[np.isin(names, LATE)], errors[np.isin(names, EARLY)]
    last = errors[names == SLIDING[-1]]
    return HypothesisResult(
        hypothesis=hypothesis,
        rolling=rolling,
        calibration=float(np.sqrt((off[names == CALIBRATION] ** 2).mean())),
        mean=float(fifteen.mean()),
        worst=float(fifteen.max()),
        sliding=float(np.abs(off[np.isin(names, SLIDING)]).mean()),
        gap=float((late - early).mean()),
        fall=float(last[-1] / last[0]),
    )
