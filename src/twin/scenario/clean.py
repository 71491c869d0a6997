"""The clean model of a scenario: what the designer of its controller saw."""

from __future__ import annotations

from typing import Any

from twin.scenario.schema import TABLES, Scenario


def clean(scenario: Scenario) -> Scenario:
    """The same controller and motion on the exact equations that the controller is designed on.

    Nothing a scenario may say of its rig is left but the ball that the designer knows, where it
    starts, control period and limits: no friction, tilt or mechanism, no dead time, quantisation or
    noise, and no predictor, which has nothing to predict.
    """
    known = scenario.designed_on
    none = (0.0, 0.0)
    ball = {name: getattr(known, name) for name in ("mass", "radius", "inertia")}
    said: dict[str, Any] = {
        "plant": {
            "kind": "lagrange",
            "step": scenario.plant.step,
            "ball": ball,
            "friction": {"rolling_mm": 0.0},
            "start": scenario.plant.start.model_dump() | {"spin": 0.0},
        },
        "rig": {"period": scenario.rig.period, "limits": scenario.rig.limits.model_dump()},
        "sensors": {
            "ideal": scenario.sensors.ideal,
            "touch": {"dead_time": 0.0, "grid": 0, "variance": none},
            "encoders": {"counts": 0, "variance": none},
        },
        "disturbance": {"variance": none},
    }
    tables = {name: TABLES[name].model_validate(table) for name, table in said.items()}
    return scenario.model_copy(update={**tables, "predictor": None, "change": ()})
