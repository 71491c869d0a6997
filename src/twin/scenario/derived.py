"""Scenarios derived from others: the clean model, and one that ends earlier."""

from __future__ import annotations

from typing import Any

from twin.scenario.rig_tables import SCENARIO_TABLES
from twin.scenario.schema import Scenario


def cut_short(scenario: Scenario, duration: float) -> Scenario:
    """A scenario that ends at a time in s, after one period at least, with all else as it is.

    Steady tracking is evaluated from the same time on, which may be after that end.
    """
    period = scenario.rig.period
    return scenario.model_copy(update={"duration": max(1, round(duration / period)) * period})


def clean(scenario: Scenario) -> Scenario:
    """The same controller and motion on the equations (5.9) that the controller is designed on.

    Nothing a scenario may say of its rig is left but the ball and the plate's height that the
    designer knows, where the ball starts, the plate's size and axes, control period and limits: no
    friction, tilt, wall or mechanism, no dead time, quantisation or noise, no computing time, no
    board, and no predictor, which has nothing to predict.
    """
    known = scenario.designed_on
    none = (0.0, 0.0)
    ball = {name: getattr(known, name) for name in ("mass", "radius", "inertia")}
    tables_of: dict[str, Any] = {
        "plant": {
            "kind": "lagrange",
            "axes": scenario.plant.axes,
            "ball_spin": "thesis",
            "step": scenario.plant.step,
            "size": scenario.plant.size,
            "shape": scenario.plant.shape,
            "ball": ball,
            "plate": {"height": known.height},
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
    tables = {
        name: SCENARIO_TABLES[name].model_validate(table) for name, table in tables_of.items()
    }
    prompt = scenario.without_computing_time
    return prompt.model_copy(
        update={**tables, "predictor": None, "board": None, "change": (), "fault": ()}
    )
