"""The clean model of a scenario: what the designer of its controller saw."""

from __future__ import annotations

from twin.scenario.plant import Friction, Plant
from twin.scenario.schema import Disturbance, Encoders, Rig, Scenario, Sensors, Touch


def clean(scenario: Scenario) -> Scenario:
    """The same controller and motion on the nominal exact equations.

    Nothing a scenario may say of its rig is left but where the ball starts, control period and
    limits: no friction, tilt, other ball or mechanism, no dead time, quantisation or noise, and
    no predictor, which has nothing to predict.
    """
    start = scenario.plant.start.model_copy(update={"spin": 0.0})
    none = (0.0, 0.0)
    return scenario.model_copy(
        update={
            "plant": Plant(
                kind="lagrange",
                step=scenario.plant.step,
                friction=Friction(rolling_mm=0.0),
                start=start,
            ),
            "rig": Rig(period=scenario.rig.period, limits=scenario.rig.limits),
            "sensors": Sensors(
                ideal=scenario.sensors.ideal,
                touch=Touch(dead_time=0.0, grid=0, variance=none),
                encoders=Encoders(counts=0, variance=none),
            ),
            "disturbance": Disturbance(variance=none),
            "predictor": None,
        }
    )
