"""What a run of an experiment leaves, and what the columns of Tables 9.1 to 9.9 mean of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.run.loop import Ending, Outcome
from twin.run.metrics import tracking_error

FROM = 10.0
"""Time in s from which steady tracking is judged: two, three or four whole turns of the circle."""


@dataclass(frozen=True, kw_only=True)
class ExperimentTrace:
    """What one rig did in one experiment, K instants.

    Attributes:
        time: Seconds, shape (K,).
        state: True state, shape (K, 8).
        estimate: The observer's, which the controller acts on, shape (K, 8).
        measured: The measurement as it arrived, shape (K, 4).
        reference: Desired ball position in m, shape (K, 2).
        u: Applied plate accelerations in rad/s^2, shape (K, 2): of each recorded stretch the
            largest by amount.
        outcome: How it ended.
    """

    time: Array
    state: Array
    estimate: Array
    measured: Array
    reference: Array
    u: Array
    outcome: Outcome


READINGS: dict[str, Callable[[ExperimentTrace], Array]] = {
    "estimate": lambda trace: trace.estimate[:, 0::4],
    "truth": lambda trace: trace.state[:, 0::4],
    "measurement": lambda trace: trace.measured[:, 0::2],
}
"""Where the ball is taken to be. A rig's computer knows the late measurement and the observer's
estimate, never the truth; the tables are read as the estimate, which the controller acts on."""

UNITS = {
    "e_ss": "m",
    "overshoot": "%",
    "t_ss": "s",
    "e_tt": "%",
    "phi_max": "deg",
    "u1_max": "rad/s^2",
    "theta_max": "deg",
    "u2_max": "rad/s^2",
}
"""Columns and their units."""


def e_tt(trace: ExperimentTrace, reading: str = "estimate", start: float = FROM) -> float:
    """Trajectory tracking error (C.7) in % from a time in s on; nan for a run that ended early."""
    if trace.outcome.ending is not Ending.FINISHED:
        return float("nan")
    late = trace.time >= start - 1e-9
    ball = READINGS[reading](trace)
    error = tracking_error((trace.reference - ball)[late], trace.reference[late])
    return float("nan") if error is None else error


def judged(
    trace: ExperimentTrace, reading: str = "estimate", start: float = FROM
) -> dict[str, float]:
    """All columns; nan where a run that ended early has none.

    Reading and start are those of the tracking error. Angles are those of the encoders; like the
    efforts they are the largest of the whole run, the start included, as in chapter 8.
    """
    if trace.outcome.ending is not Ending.FINISHED:
        return dict.fromkeys(UNITS, float("nan"))
    step = bool((trace.reference == trace.reference[0]).all())
    angles = np.degrees(np.abs(trace.measured[:, 1::2]).max(axis=0))
    efforts = np.abs(trace.u).max(axis=0)
    found = {
        "phi_max": angles[0],
        "u1_max": efforts[0],
        "theta_max": angles[1],
        "u2_max": efforts[1],
    }
    found |= _approach(trace) if step else {"e_tt": e_tt(trace, reading, start)}
    return {name: float(value) for name, value in found.items()}


def _approach(trace: ExperimentTrace) -> dict[str, float]:
    """Error at rest, overshoot and settling on x, as the observer sees the ball."""
    x, goal = trace.estimate[:, 0], float(trace.reference[-1, 0])
    end = float(x[trace.time > trace.time[-1] - 1].mean())
    outside = np.flatnonzero(np.abs(x - end) > 0.05 * abs(goal))
    return {
        "e_ss": abs(goal - end),
        "overshoot": max(0.0, 100 * float(x.max() / goal - 1)),
        "t_ss": float(trace.time[outside[-1]]) if len(outside) else 0.0,
    }
