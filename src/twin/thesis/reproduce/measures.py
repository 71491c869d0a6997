"""What the columns of Tables 8.1 to 8.21 mean, as far as that was found out, in one place."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.run.loop import Ending, Outcome
from twin.run.metrics import Motion, measure
from twin.thesis.reproduce.cases import SimulationCase


@dataclass(frozen=True, kw_only=True)
class SimulationTrace:
    """K instants of the N runs of one case, or how they ended early.

    Attributes:
        time: Seconds, shape (K,), the end of the run included.
        state: True state, shape (K, N, 8).
        u: Commanded plate accelerations in rad/s^2, shape (K, N, 2).
        reference: Desired ball position in m, shape (K, 2).
        estimate: The observer's state, shape (K, N, 8).
        ended: Why a run ended early, in words; empty if all lasted.
        until: When the first run ended, s.
    """

    time: Array
    state: Array
    u: Array
    reference: Array
    estimate: Array
    ended: str = ""
    until: float = math.inf

    def motion(self, run: int) -> Motion:
        """One run as ``twin.run.metrics`` wants it."""
        state = self.state[:, run]
        return Motion(
            time=self.time,
            ball=state[:, 0::4],
            plate=state[:, 2::4],
            u=self.u[:, run],
            reference=self.reference,
        )

    def excerpt(self, step: float) -> SimulationTrace:
        """The first run until it ended, one instant per step in s, for a figure."""
        every = max(1, round(step / (self.time[1] - self.time[0])))
        rows = slice(0, np.searchsorted(self.time, self.until, "right"), every)
        return SimulationTrace(
            time=self.time[rows],
            state=self.state[rows, :1].copy(),
            u=self.u[rows, :1].copy(),
            reference=self.reference[rows].copy(),
            estimate=self.estimate[rows, :1].copy(),
            ended=self.ended,
            until=self.until,
        )


@dataclass(frozen=True, kw_only=True)
class ThesisColumn:
    """A column of the thesis's tables.

    Attributes:
        label: What it shows, as the thesis calls it.
        unit: Its unit.
        judged: "value" against the bound, "reading" against what was read by eye from a figure,
            "noise" against the range of the seeds.
        zero: Absolute bound where the thesis prints 0.
    """

    label: str
    unit: str
    judged: str = "value"
    zero: float = 0.0

    @property
    def name(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]"


COLUMNS = {
    "e_ss": ThesisColumn(label="e_ss", unit="m"),
    "overshoot": ThesisColumn(label="overshoot", unit="%", zero=0.5),
    "t_ss": ThesisColumn(label="t_ss", unit="s", judged="reading"),
    "rms_error": ThesisColumn(label="average tracking error", unit="m"),
    "max_steady_error": ThesisColumn(label="max. steady tracking error", unit="m"),
    "e_tt": ThesisColumn(label="tracking error e_tt", unit="%", judged="noise"),
    "phi_max": ThesisColumn(label="phi_max", unit="deg"),
    "u1_max": ThesisColumn(label="u1_max", unit="rad/s^2"),
    "theta_max": ThesisColumn(label="theta_max", unit="deg"),
    "u2_max": ThesisColumn(label="u2_max", unit="rad/s^2"),
    "x1_error": ThesisColumn(label="x1 estimation error", unit="m", judged="noise"),
    "x2_error": ThesisColumn(label="x2 estimation error", unit="m/s", judged="noise"),
    "x3_error": ThesisColumn(label="x3 estimation error", unit="rad", judged="noise"),
    "x4_error": ThesisColumn(label="x4 estimation error", unit="rad/s", judged="noise"),
}
"""The columns by the names the data files use."""

METRICS = {
    "e_ss": "steady_error",
    "t_ss": "settling_time",
    "rms_error": "rms_error",
    "max_steady_error": "max_steady_error",
    "e_tt": "tracking_error_percent",
    "phi_max": "phi_max_deg",
    "u1_max": "u1_max",
    "theta_max": "theta_max_deg",
    "u2_max": "u2_max",
}
"""Columns that are indicators of ``twin.run.metrics``, too.

The "average tracking error" is not (C.4), but a root mean square over the run. e_tt (C.7) and the
"max. steady tracking error" are taken from ``steady_from`` on.
"""


def overshoot_beyond_end(trace: SimulationTrace, run: int) -> float:
    """How far x passes its value at the end, in % of that value."""
    x = trace.state[:, run, 0]
    return max(0.0, float(100 * (x.max() / x[-1] - 1)))


def estimation_error(state: int) -> Callable[[SimulationTrace, int], float]:
    """Root mean square over the run of a state's estimation error (C.1)."""

    def error(trace: SimulationTrace, run: int) -> float:
        difference = trace.state[:, run, state] - trace.estimate[:, run, state]
        return float(np.sqrt((difference**2).mean()))

    return error


OWN: dict[str, Callable[[SimulationTrace, int], float]] = {
    "overshoot": overshoot_beyond_end,
    **{f"x{i + 1}_error": estimation_error(i) for i in range(4)},
}
"""Columns that only the thesis's tables have."""


def judge(
    trace: SimulationTrace, case: SimulationCase, columns: tuple[str, ...]
) -> dict[str, list[float]]:
    """The columns' values for every run of a case; for t_ss also those of the bands' ends.

    A run that ended early has no values.
    """
    found: dict[str, list[float]] = {column: [] for column in columns}
    if trace.ended:
        return found
    end = Outcome(Ending.FINISHED, float(trace.time[-1]))
    for run in range(trace.state.shape[1]):
        motion = trace.motion(run)
        for band in case.bands if "t_ss" in columns else case.bands[:1]:
            metrics = measure(motion, end, start=case.steady_from, band_percent=band)
            if "t_ss" in columns:
                settled = metrics.settling_time
                found["t_ss"].append(end.time if settled is None else settled)
            if band is case.bands[0]:
                values = metrics.as_dict()
                for column in columns:
                    if column in OWN:
                        found[column].append(OWN[column](trace, run))
                    elif column != "t_ss":
                        found[column].append(values[METRICS[column]])
    return found
