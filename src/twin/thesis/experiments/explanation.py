"""The explanation of chapter 9: few numbers fitted to all of its tables, as a table to be fitted.

What is fitted and what is set are stated here and nowhere else; the search is that of
``ballplate fit``.
"""

from __future__ import annotations

from typing import Any

from twin.fit.schema import Experiment, FitTable, FittedParameter, Measured
from twin.thesis.experiments.tables import LATE, SLIDING, MeasuredExperiment, chosen

INDICATORS = {
    "e_tt": "tracking_error_percent",
    "phi_max": "phi_max_deg",
    "theta_max": "theta_max_deg",
    "u1_max": "u1_max",
    "u2_max": "u2_max",
    "e_ss": "steady_error",
    "overshoot": "overshoot_percent",
}
"""Column of a table to the indicator it is; the settling time was read by eye and is left out."""
STEP = {"e_ss": 0.006, "overshoot": 2.0, "phi_max": 0.2, "u1_max": 0.1}
"""Standard uncertainties of Table 9.1, in its units or of a logarithm, chosen near what the best
models leave."""
TRACKING, MAXIMA = 2.0, 0.35
"""The same of the tracking errors in points, and of the logarithm of the maxima."""
LOGARITHMIC = ("phi_max", "theta_max", "u1_max", "u2_max")
"""Columns that are judged by the logarithm of the ratio."""

ALL = (
    "plant.kind=lagrange",
    "plant.step=0.002",
    "rig.limits.area=[0.25, 0.17]",
)
"""What every experiment has: the exact equations; room for a long start."""
CASE_2 = ("controller.betas=[0.5, 2.0, 3.0]", "controller.epsilon=0.1")
"""The sliding mode's settings: case 2 of Table 8.10, the text's choice."""

CIRCLES = tuple(f"9.{number}" for number in range(2, 10))
PARAMETERS = {
    "friction": FittedParameter(key="plant.friction.rolling_mm", low=0.12, high=0.26, unit="mm"),
    "without_predictor": FittedParameter(
        key="plant.friction.rolling_mm", low=0.9, high=1.4, relative=True, groups=LATE
    ),
    "start": FittedParameter(key="reference.start", low=1.0, high=4.2, groups=CIRCLES, unit="s"),
    "play": FittedParameter(key="plant.servo.backlash_deg", low=0.0, high=0.8, unit="deg"),
}
"""What is fitted: rolling friction; by what it is larger in the series without predictor; the
length of the polynomial start of the circles; play between motor and plate, its whole width."""


def table(
    parameters: dict[str, FittedParameter] | None = None,
    *,
    overrides: tuple[str, ...] = (),
    case_2: bool = True,
    **search: Any,
) -> FitTable:
    """Chapter 9 as a table to be fitted.

    Args:
        parameters: What is fitted; the four of the explanation by default.
        overrides: Further settings of all experiments.
        case_2: Whether the sliding mode has the settings of Table 8.10 or those printed.
        search: Settings of the search.
    """
    return FitTable(
        title="Chapter 9 of the thesis, explained",
        set=(*ALL, *overrides),
        parameters=PARAMETERS if parameters is None else parameters,
        experiments=tuple(
            Experiment(
                scenario=each.scenario,
                name=f"{each.table}, {each.name}",
                group=each.table,
                set=(f"seed={seed}", *(CASE_2 if case_2 and each.table in SLIDING else ())),
                measured=_measured(each),
            )
            for seed, each in enumerate(chosen())
        ),
        **{"population": 12, "generations": 8, "restarts": 2} | search,
    )


def _measured(each: MeasuredExperiment) -> dict[str, Measured]:
    found = {}
    for column, indicator in INDICATORS.items():
        if column not in each.cells:
            continue
        value = each.cells[column]
        if column in LOGARITHMIC:
            relative = MAXIMA if each.omega is not None else STEP[column]
            found[indicator] = Measured(value=value, relative=relative)
        else:
            uncertainty = TRACKING if each.omega is not None else STEP[column]
            found[indicator] = Measured(value=value, uncertainty=uncertainty)
    return found
