"""What was driven so far: the scenario with all that a person changed of it, and when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.interfaces import Law, Reference
from controllers.references import Setpoints
from twin.errors import ScenarioError
from twin.run.assemble import build_controller, build_reference
from twin.scenario.changing import at_time
from twin.scenario.load import check, put
from twin.scenario.schema import JUMPS, RAMPS, SLACK, Change, Scenario, choices
from twin.whatif.branch import CONTROL

LONGEST = 1800.0
"""Longest time in s that can be driven: its record is kept in memory."""
TABLES = ("controller", "observer", "predictor")
"""Tables of a scenario that say how it is controlled."""


@dataclass(frozen=True)
class Driven:
    """A scenario as a person has driven it so far; every change gives a new one.

    Attributes:
        scenario: With its changes of the plant, and the controller of now; its reference is the
            one from before a person gave the first goal.
        goals: The reference since then; None before.
        controllers: Since when, s, which controller, observer and predictor; the first from 0 on.
        pushes: Time in s and change of the ball's velocity (x, y) in m/s.
    """

    scenario: Scenario
    goals: Setpoints | None = None
    controllers: tuple[tuple[float, Mapping[str, Any]], ...] = ()
    pushes: tuple[tuple[float, float, float], ...] = ()

    @classmethod
    def begun(cls, scenario: Scenario) -> Driven:
        """A scenario that nothing was changed of yet.

        Raises:
            ScenarioError: If it cannot be assembled.
        """
        long = scenario.model_copy(update={"duration": LONGEST, "baseline": False})
        build_reference(long)
        return cls(long, None, ((0.0, _control(long)),))

    @property
    def reference(self) -> Reference:
        """The path to follow."""
        return self.goals or build_reference(self.scenario)

    def goal(self, time: float, x: float, y: float) -> Driven:
        """With one more goal from a time in s on, taken into the operating area; m.

        Raises:
            ScenarioError: If the law has planned on the scenario's own path.
        """
        _of_now(self.scenario, "is no goal's: nobody knows the next one")
        area = np.asarray(self.scenario.rig.limits.area, float)
        x, y = np.clip((x, y), -area, area).tolist()
        if self.goals is None:
            before = self.scenario.reference.model_dump(mode="json")
            goals = Setpoints(points=((time, x, y),), before=before)
        elif time > self.goals.points[-1][0]:
            goals = self.goals.then(time, x, y)
        else:  # a second one within the same period
            kept = self.goals.points[:-1]
            goals = replace(self.goals, points=(*kept, (time, x, y)))
        return replace(self, goals=goals)

    def push(self, time: float, x_rate: float, y_rate: float) -> Driven:
        """With one more push; change of the ball's velocity in m/s."""
        return replace(self, pushes=(*self.pushes, (time, x_rate, y_rate)))

    def settings(self, time: float, values: Mapping[str, Any]) -> Driven:
        """With new values of keys from a time in s on.

        Raises:
            ScenarioError: If a key cannot change while a rig runs, or a value is out of range.
        """
        plant = {key: value for key, value in values.items() if key in RAMPS + JUMPS}
        for key in values:
            if key not in plant and not key.startswith(CONTROL[:3]):
                raise ScenarioError(f"{key}: cannot be changed while a rig runs")
        tables = at_time(self.scenario, time).model_dump(mode="json", exclude={"change"})
        if tables["predictor"] is None:
            del tables["predictor"]
        checked = check(put(tables, values.items()), "play")
        if any(key not in plant for key in values):
            _of_now(checked, "is laid from the start of a scenario that has it")
        changed = self.scenario.model_copy(
            update={table: getattr(checked, table) for table in TABLES}
        )
        build_controller(changed)
        controllers = self.controllers
        if any(key not in plant for key in values):
            earlier = [each for each in controllers if each[0] < time - SLACK]
            controllers = (*earlier, (time, _control(changed)))
        if plant:
            changes = _with_change(changed.change, time, plant)
            changed = changed.model_copy(update={"change": changes})
        return replace(self, scenario=changed, controllers=controllers)

    def recorded(self, end: float) -> Scenario:
        """The scenario that a record until a time in s was made with."""
        start = min(self.scenario.metrics.start, end / 2)
        kept = [each for each in self.scenario.change if each.at < end - SLACK]
        tables = self.scenario.model_dump(mode="json", exclude={"change"})
        tables |= {
            "title": f"{self.scenario.title}, driven by hand",
            "duration": end,
            "change": [each.model_dump(mode="json") for each in kept],
        }
        tables["metrics"]["start"] = start
        if self.goals is not None:
            tables["reference"] = {
                "kind": Setpoints.name,
                "points": [list(point) for point in self.goals.points],
                "time_constant": self.goals.time_constant,
                "before": self.goals.before,
            }
        return check(tables, "play")

    def as_dict(self) -> dict[str, Any]:
        """What a person did that the scenario of the record does not say, and how much it is."""
        return {
            "goals": 0 if self.goals is None else len(self.goals.points),
            "changes": len(self.scenario.change),
            "pushes": [list(push) for push in self.pushes],
            "controllers": [{"since": since, **tables} for since, tables in self.controllers],
        }


def drivable(law: type[Law]) -> bool:
    """Whether a law acts on the goal of now, so that a person may give it."""
    return law.start is Law.start


def _of_now(scenario: Scenario, why: str) -> None:
    """Make sure that a scenario's law acts on the goal of now.

    Raises:
        ScenarioError: If it plans ahead.
    """
    kind = scenario.controller.kind
    laws = choices("controller")
    if not drivable(laws[kind]):
        known = ", ".join(name for name, law in laws.items() if drivable(law))
        raise ScenarioError(
            f"controller.kind: '{kind}' plans on a path known ahead, which {why}; "
            f"choose another (known: {known})"
        )


def _control(scenario: Scenario) -> dict[str, Any]:
    return {
        table: None if getattr(scenario, table) is None else getattr(scenario, table).model_dump()
        for table in TABLES
    }


def _with_change(
    changes: tuple[Change, ...], time: float, values: Mapping[str, Any]
) -> tuple[Change, ...]:
    """Changes and one more at once; of two at one time there is one with all values."""
    if changes and abs(changes[-1].at - time) < SLACK:
        values = {**changes[-1].set, **values}
        changes = changes[:-1]
    return (*changes, Change(at=time, set=dict(values)))
