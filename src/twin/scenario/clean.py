"""The clean model of a scenario: what the designer of its controller saw."""

from __future__ import annotations

from twin.scenario.plant import BallTable, FrictionTable, PlantTable
from twin.scenario.schema import (
    DisturbanceTable,
    EncodersTable,
    RigTable,
    Scenario,
    SensorsTable,
    TouchTable,
)


def clean(scenario: Scenario) -> Scenario:
    """The same controller and motion on the exact equations that the controller is designed on.

    Nothing a scenario may say of its rig is left but the ball that the designer knows, where it
    starts, control period and limits: no friction, tilt or mechanism, no dead time, quantisation or
    noise, and no predictor, which has nothing to predict.
    """
    known = scenario.designed_on
    start = scenario.plant.start.model_copy(update={"spin": 0.0})
    none = (0.0, 0.0)
    return scenario.model_copy(
        update={
            "plant": PlantTable(
                kind="lagrange",
                step=scenario.plant.step,
                ball=BallTable(mass=known.mass, radius=known.radius, inertia=known.inertia),
                friction=FrictionTable(rolling_mm=0.0),
                start=start,
            ),
            "rig": RigTable(period=scenario.rig.period, limits=scenario.rig.limits),
            "sensors": SensorsTable(
                ideal=scenario.sensors.ideal,
                touch=TouchTable(dead_time=0.0, grid=0, variance=none),
                encoders=EncodersTable(counts=0, variance=none),
            ),
            "disturbance": DisturbanceTable(variance=none),
            "predictor": None,
            "change": (),
        }
    )
