"""The effects a clean model leaves out: what switches each off, and what a real rig has of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from twin.scenario.plant import MECHANISM_ONLY
from twin.scenario.schema import Scenario

Overrides = Mapping[str, Any]
"""Dotted key to value; None takes the key out, so that its default holds."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Something a rig has and the clean model has not.

    Attributes:
        name: One word.
        label: What tables and pictures call it.
        off: Overrides that switch it off.
        typical: Overrides that give it a size a real rig may have.
        source: Where that size comes from.
    """

    name: str
    label: str
    off: Overrides
    typical: Overrides = field(default_factory=dict)
    source: str = ""

    @property
    def mechanical(self) -> bool:
        """Whether only the mechanism has it, not the exact equations."""
        return any(key.removeprefix("plant.") in MECHANISM_ONLY for key in self.off)


EFFECTS = (
    Effect(
        name="friction",
        label="rolling friction",
        off={"plant.friction.rolling_mm": 0.0, "plant.friction.viscous_mm": 0.0},
        typical={"plant.friction.rolling_mm": 0.18},
        source="identified from the thesis's Table 9.3",
    ),
    Effect(
        name="breakaway",
        label="breakaway above rolling friction",
        off={"plant.friction.breakaway_ratio": 1.0},
        typical={"plant.friction.breakaway_ratio": 1.5},
        source="assumed",
    ),
    Effect(
        name="surface",
        label="uneven surface",
        off={"plant.surface": None},
        typical={"plant.surface.spread_percent": 20.0, "plant.surface.slope_deg": 0.05},
        source="assumed",
    ),
    Effect(
        name="ball",
        label="ball out of balance or round",
        off={"plant.ball.offset_mm": (0.0, 0.0, 0.0), "plant.ball.oval_mm": 0.0},
        typical={"plant.ball.offset_mm": (0.03, 0.0, -0.03), "plant.ball.oval_mm": 0.05},
        source="assumed: a good moulded ball",
    ),
    Effect(
        name="level",
        label="base not level",
        off={"plant.level_deg": (0.0, 0.0)},
        typical={"plant.level_deg": (0.05, -0.05)},
        source="assumed: a good spirit level",
    ),
    Effect(
        name="vibration",
        label="spring vibration",
        off={"plant.wheels.damping_ratio": 1.0},
        typical={"plant.wheels.damping_ratio": None},
        source="the model file: rings at 12.9 and 18.9 Hz",
    ),
    Effect(
        name="mass",
        label="plate's mass off centre",
        off={"plant.plate.offset_mm": (0.0, 0.0)},
        typical={"plant.plate.offset_mm": None},
        source="the model file; that it is off: thesis 4.1",
    ),
    Effect(
        name="liftoff",
        label="wheels lifting off",
        off={"plant.spring.preload": None},
        typical={"plant.spring.preload": 20.0},
        source="assumed: a weak spring",
    ),
    Effect(
        name="bandwidth",
        label="servo bandwidth",
        off={"plant.servo.bandwidth_hz": 0.0},
        typical={"plant.servo.bandwidth_hz": 8.0},
        source="assumed",
    ),
    Effect(
        name="drive",
        label="torque and speed limits of the motors",
        off={"plant.servo.torque_limit": 1000.0, "plant.servo.speed_limit": 1000.0},
        typical={"plant.servo.torque_limit": None, "plant.servo.speed_limit": None},
        source="data sheet; speed assumed",
    ),
    Effect(
        name="backlash",
        label="backlash",
        off={"plant.servo.backlash_deg": 0.0},
        typical={"plant.servo.backlash_deg": 0.05},
        source="assumed",
    ),
    Effect(
        name="limits",
        label="limits of plate rate and acceleration",
        off={"rig.limits.rate_deg": 3600.0, "rig.limits.acceleration": 1e4},
        typical={"rig.limits.rate_deg": None, "rig.limits.acceleration": None},
        source="thesis chapter 3; rate assumed",
    ),
    Effect(
        name="cams",
        label="cam table errors",
        off={"rig.cams": "table", "rig.cam_error_percent": (0.0, 0.0)},
        typical={"rig.cam_error_percent": (2.0, -2.0)},
        source="assumed",
    ),
    Effect(
        name="coupling",
        label="axes coupled by a turned screen",
        off={"sensors.touch.rotation_deg": 0.0},
        typical={"sensors.touch.rotation_deg": 1.0},
        source="assumed; that they are coupled: thesis 10.1",
    ),
    Effect(
        name="deadtime",
        label="dead time, with its predictor",
        off={
            "sensors.touch.dead_time": 0.0,
            "sensors.touch.dead_time_spread": 0.0,
            "predictor": None,
        },
        typical={"sensors.touch.dead_time": 0.042},
        source="thesis Table A.2",
    ),
    Effect(
        name="spread",
        label="spread of the dead time",
        off={"sensors.touch.dead_time_spread": 0.0},
        typical={"sensors.touch.dead_time_spread": 0.00187},
        source="thesis Table 7.2",
    ),
    Effect(
        name="frames",
        label="frame rate of the screen",
        off={"sensors.touch.frame_rate": 0.0},
        typical={"sensors.touch.frame_rate": 100.0},
        source="assumed",
    ),
    Effect(
        name="touch",
        label="noise and grid of the screen",
        off={"sensors.touch.variance": (0.0, 0.0), "sensors.touch.grid": 0},
        typical={"sensors.touch.variance": None, "sensors.touch.grid": None},
        source="thesis Table B.1",
    ),
    Effect(
        name="encoders",
        label="noise and counts of the encoders",
        off={"sensors.encoders.variance": (0.0, 0.0), "sensors.encoders.counts": 0},
        typical={"sensors.encoders.variance": None, "sensors.encoders.counts": None},
        source="thesis Table B.1",
    ),
    Effect(
        name="disturbance",
        label="disturbance of the plate",
        off={"disturbance.variance": (0.0, 0.0)},
        typical={"disturbance.variance": None},
        source="thesis Table B.1",
    ),
)
"""Every effect that can be switched alone."""


def changed(scenario: Scenario, overrides: Iterable[Overrides]) -> Scenario:
    """The scenario with overrides put in."""
    tables = scenario.model_dump(exclude_unset=True)
    for each in overrides:
        for key, value in each.items():
            *path, name = key.split(".")
            table = tables
            for part in path:
                table = table.setdefault(part, {})
            if value is None:
                table.pop(name, None)
            else:
                table[name] = value
    return Scenario.model_validate(tables, strict=False)


def present(scenario: Scenario) -> tuple[Effect, ...]:
    """The effects that a scenario has."""
    exact = scenario.plant.kind == "lagrange"
    return tuple(
        effect
        for effect in EFFECTS
        if not (exact and effect.mechanical)
        and not _same(changed(scenario, [effect.off]), scenario)
    )


def _same(one: Scenario, other: Scenario) -> bool:
    return one.model_dump() == other.model_dump()


def with_typical(scenario: Scenario) -> Scenario:
    """The scenario with every effect it lacks at the size a real rig may have."""
    has = present(scenario)
    exact = scenario.plant.kind == "lagrange"
    lacking = [
        effect.typical
        for effect in EFFECTS
        if effect not in has and not (exact and effect.mechanical)
    ]
    return changed(scenario, lacking)


def without(scenario: Scenario, effects: Iterable[Effect]) -> Scenario:
    """The scenario with effects switched off."""
    return changed(scenario, [effect.off for effect in effects])


def exact(scenario: Scenario) -> Scenario:
    """The scenario on the exact equations, without what only the mechanism has."""
    mechanical: dict[str, None] = dict.fromkeys(f"plant.{key}" for key in MECHANISM_ONLY)
    return changed(scenario, [mechanical, {"plant.kind": "lagrange", "rig.cams": None}])
