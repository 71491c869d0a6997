"""Which runs can share a batch: those alike in all that a batch has only once."""

from __future__ import annotations

from typing import Any

from twin.run.assemble import build_friction
from twin.scenario import Scenario

OWN = {
    "title",
    "baseline",
    "seed",
    "controller",
    "reference",
    "metrics",
    "plant.level_deg",
    "plant.friction.rolling_mm",
    "plant.friction.breakaway_ratio",
    "plant.friction.stribeck_speed",
    "plant.friction.dwell_time",
    "plant.friction.viscous_mm",
    "plant.servo.bandwidth_hz",
    "plant.start.x",
    "plant.start.y",
    "plant.start.x_rate",
    "plant.start.y_rate",
    "sensors.touch.dead_time",
}
"""Keys in which the rigs of a batch may differ."""
PARTS = {
    "plant.ball.mass",
    "plant.ball.radius",
    "plant.ball.inertia",
    "plant.ball.oval_mm",
    "plant.friction.sliding",
    "plant.friction.spinning_mm",
    "plant.servo.speed_limit",
    "plant.servo.torque_limit",
    "plant.wheels.stiffness",
    "plant.wheels.damping_ratio",
    "plant.spring.preload",
    "plant.plate.offset_mm",
}
"""Keys in which they may differ besides if each has a mechanism of its own."""


def common(scenario: Scenario) -> dict[str, Any]:
    """What rigs must have in common to be the rigs of one batch."""
    own = OWN | PARTS if scenario.plant.kind == "mujoco" else OWN
    left = {key: value for key, value in _flat(scenario.model_dump()).items() if key not in own}
    left = {key: value for key, value in left.items() if key.partition(".")[0] not in own}
    friction = build_friction(scenario.plant)
    return left | {
        "resisted": friction is not None,
        "free": friction is None or bool(friction.absent),
        "constant": friction is None or friction.constant,
        "ageing": friction is not None and friction.ageing,
        "level": any(scenario.plant.level_deg),
        "lag": scenario.plant.servo.bandwidth_hz > 0,
    }


def _flat(tables: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in tables.items():
        if isinstance(value, dict):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found
