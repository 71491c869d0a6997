"""The physics step of runs of which there are many."""

from __future__ import annotations

from twin.scenario.schema import Scenario

STUDY_STEP = 0.002
"""Physics step in s of a study's mechanism; half the work of 1 ms. ``python -m
benchmarks.physics_step`` measures what it gets wrong."""
STIFFEST = 5e5
"""Stiffness of wheel on cam in N/m up to which that was found to hold."""
MOST_DAMPED = 0.3
"""Damping ratio of the plate on its wheels up to which it was; twice critical runs away at 2 ms."""


def at_study_step(scenario: Scenario) -> Scenario:
    """The scenario as one of many: at the step of studies unless it says its own.

    Only the mechanism, on wheels not too hard or damped for the step, and at a control period that
    is a multiple of it; else the scenario as it is. The exact equations follow play worse at it.
    """
    plant, wheels = scenario.plant, scenario.plant.wheels
    steps = round(scenario.rig.period / STUDY_STEP)
    if (
        "step" in plant.model_fields_set
        or plant.kind != "mujoco"
        or (wheels.stiffness or 0.0) > STIFFEST
        or (wheels.damping_ratio or 0.0) > MOST_DAMPED
        or steps < 1
        or abs(steps * STUDY_STEP - scenario.rig.period) > 1e-9 * scenario.rig.period
    ):
        return scenario
    return scenario.model_copy(update={"plant": plant.model_copy(update={"step": STUDY_STEP})})
