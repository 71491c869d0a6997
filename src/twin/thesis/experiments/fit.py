"""The one fit: rolling friction from the three tracking errors of Table 9.3, with uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from controllers.arrays import Array
from twin.thesis import tables
from twin.thesis.experiments.batch import DURATION, rolling, simulate
from twin.thesis.experiments.judge import FROM, READINGS, e_tt
from twin.thesis.experiments.tables import CALIBRATION, chosen
from twin.writing import write_whole

ARMS = (0.10e-3, 0.14e-3, 0.18e-3, 0.22e-3, 0.26e-3)
"""Arms in m between which the tracking error is interpolated; it is smooth and all but linear."""


@dataclass(frozen=True, kw_only=True)
class FrictionFit:
    """Rolling friction as identified from Table 9.3.

    Attributes:
        reading: Where the ball was taken to be.
        start: From which time in s on.
        rolling: Arm in m.
        low: Lower end of its 95 % interval.
        high: Upper end.
        residual: Computed minus measured tracking error at 0.5, 0.75 and 1 rad/s, in points.
    """

    reading: str
    start: float
    rolling: float
    low: float
    high: float
    residual: tuple[float, ...]

    @property
    def spread(self) -> float:
        """Root mean square of the residual over its two degrees of freedom, points."""
        return float(np.sqrt(np.sum(np.square(self.residual)) / (len(self.residual) - 1)))


def fits(advance: Callable[[float], None], *, mechanism: bool = True) -> list[FrictionFit]:
    """The fit by every reading and window that Table 9.3 may have been made with.

    Args:
        advance: Called with the share done, 0 to 1.
        mechanism: Whether on the MuJoCo mechanism or on the exact model.
    """
    experiments = chosen([CALIBRATION])
    traces = simulate(
        experiments,
        [rolling(arm) for arm in ARMS],
        mechanism=mechanism,
        progress=lambda done: advance(done / DURATION),
    )
    measured = [experiment.cells["e_tt"] for experiment in experiments]
    return [
        fitted(
            np.array([[e_tt(trace, reading, start) for trace in row] for row in traces]),
            measured,
            reading,
            start,
        )
        for reading in READINGS
        for start in (FROM, 0.0)
    ]


def fit(advance: Callable[[float], None]) -> FrictionFit:
    """The choice and the fit, on the mechanism.

    Of the readings that a rig's computer can have made, that which Table 9.3 contradicts least.
    """
    return best(fits(advance))


def best(found: Sequence[FrictionFit]) -> FrictionFit:
    """The fit with the smallest spread among those that need no truth."""
    return min((each for each in found if each.reading != "truth"), key=lambda each: each.spread)


def fitted(errors: Array, measured: Sequence[float], reading: str, start: float) -> FrictionFit:
    """The arm by least squares, its interval by Student's t from the three residuals.

    Args:
        errors: Tracking errors in % for every experiment and arm of ``ARMS``, shape (3, arms).
        measured: Those of the thesis, shape (3,).
        reading: Where the ball was taken to be.
        start: From which time in s on.
    """
    scale = 1e-4
    curves = np.polynomial.polynomial.polyfit(np.array(ARMS) / scale, errors.T, 3)

    def residual(x: Array) -> Array:
        values: Array = np.polynomial.polynomial.polyval(x[0], curves) - np.asarray(measured)
        return values

    found = least_squares(residual, [1.8], bounds=(ARMS[0] / scale, ARMS[-1] / scale))
    slope = np.asarray(found.jac)[:, 0]
    freedom = len(measured) - 1
    deviation = np.sqrt((found.fun**2).sum() / freedom / (slope**2).sum())
    half = float(student.ppf(0.975, freedom) * deviation)
    arm = float(found.x[0])
    return FrictionFit(
        reading=reading,
        start=start,
        rolling=arm * scale,
        low=max(arm - half, 0.0) * scale,
        high=(arm + half) * scale,
        residual=tuple(found.fun.tolist()),
    )


@cache
def identified() -> FrictionFit:
    """The fit that the tables are predicted with, as ``write`` left it."""
    data = tables.data(__package__, "identified")
    return FrictionFit(**{**data, "residual": tuple(data["residual"])})


def write(result: FrictionFit, path: Path) -> None:
    """Write a fit as TOML.

    Raises:
        RecordError: If the file cannot be written.
    """
    rounded = replace(
        result,
        rolling=round(result.rolling, 8),
        low=round(result.low, 8),
        high=round(result.high, 8),
        residual=tuple(round(r, 3) for r in result.residual),
    )
    lines = ["# Identified from the three tracking errors of Table 9.3 and nothing else, by"]
    lines += ["# `ballplate reproduce 9 --fit`: arms in m, times in s, residuals in points."]
    for name, value in asdict(rounded).items():
        shown = list(value) if isinstance(value, tuple) else value
        lines.append(f'{name} = "{shown}"' if isinstance(shown, str) else f"{name} = {shown}")
    text = "\n".join(lines) + "\n"
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))
