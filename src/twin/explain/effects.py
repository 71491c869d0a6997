"""The effects a clean model leaves out: what switches each off, and what a real rig has of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from twin.data_file import packaged
from twin.scenario.schema import MECHANISM_ONLY, Scenario

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
    typical: Overrides
    source: str

    @property
    def mechanical(self) -> bool:
        """Whether only the mechanism has it, not the exact equations."""
        return any(key.removeprefix("plant.") in MECHANISM_ONLY for key in self.off)


def _overrides(table: Mapping[str, Any]) -> Overrides:
    """Overrides as the file gives them: ``default`` for None."""
    return {key: None if value == "default" else value for key, value in table.items()}


EFFECTS = tuple(
    Effect(name=name, **about | {key: _overrides(about[key]) for key in ("off", "typical")})
    for name, about in packaged("twin.explain", "effects.toml").items()
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


def possible(scenario: Scenario) -> tuple[Effect, ...]:
    """The effects that a scenario's plant can have."""
    exact = scenario.plant.kind == "lagrange"
    return tuple(effect for effect in EFFECTS if not (exact and effect.mechanical))


def present(scenario: Scenario) -> tuple[Effect, ...]:
    """The effects that a scenario has."""
    now = scenario.model_dump()
    return tuple(
        effect
        for effect in possible(scenario)
        if changed(scenario, [effect.off]).model_dump() != now
    )


def with_typical(scenario: Scenario) -> Scenario:
    """The scenario with every effect it lacks at the size a real rig may have."""
    has = present(scenario)
    lacking = [effect.typical for effect in possible(scenario) if effect not in has]
    return changed(scenario, lacking)


def without(scenario: Scenario, effects: Iterable[Effect]) -> Scenario:
    """The scenario with effects switched off."""
    return changed(scenario, [effect.off for effect in effects])


def exact(scenario: Scenario) -> Scenario:
    """The scenario on the exact equations, without what only the mechanism has."""
    mechanical: dict[str, None] = dict.fromkeys(f"plant.{key}" for key in MECHANISM_ONLY)
    return changed(scenario, [mechanical, {"plant.kind": "lagrange", "rig.cams": None}])
