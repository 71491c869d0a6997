"""A scenario that changes while it runs: its values at a time, and what no change can do."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise
from typing import Any

from twin.base.settings import value_of
from twin.scenario import schema
from twin.scenario.schema import TIME_TOLERANCE_S, Change, Scenario

NONE_AT_ZERO = ("slew_deg", "acceleration_deg", "bandwidth_hz", "resonance_hz")
"""What of ``plant.servo`` is absent at 0 and the stronger the closer to it: no ramp leads there."""


def at_time(scenario: Scenario, time: float) -> Scenario:
    """The scenario with the values that its plant, drives and sensors have at a time in s."""
    values: dict[str, Any] = {}
    for change in sorted(scenario.change, key=lambda each: each.at):
        passed = time - change.at
        if passed < -TIME_TOLERANCE_S:
            break
        share = passed / change.over if passed < change.over - TIME_TOLERANCE_S else 1.0
        for key, goal in change.set.items():
            old = values[key] if key in values else value_of(scenario, key)
            values[key] = _between(old, _tuples(goal), share)
    return reduce(lambda model, item: _with(model, *item), values.items(), scenario)


def always_friction(scenario: Scenario) -> bool:
    """Whether the ball of a simulated rig rolls with friction all the time."""
    key = "plant.friction.rolling_mm"
    values = [each.set[key] for each in scenario.change if key in each.set]
    return all(value > 0 for value in (value_of(scenario, key), *values))


def times(scenarios: Sequence[Scenario]) -> list[float]:
    """When something changes in any of some scenarios, s, in order."""
    every = (time for each in scenarios for change in each.change for time in change.times())
    return sorted({round(time, 9) for time in every})


def problem_of_changes(scenario: Scenario) -> str:
    """Error of a scenario's changes taken together, in one line; empty if there is none.

    Each of them is known to be possible by itself.
    """
    for number, change in enumerate(scenario.change):
        found = _ramp_problem(scenario, change)
        if found:
            return f"change.{number}.set: {found}"
        if change.at >= scenario.duration:
            return (
                f"change.{number}.at: {change.at:g} s is not before the end at duration = "
                f"{scenario.duration:g} s"
            )
    for key in schema.RAMP_KEYS + schema.JUMP_KEYS:
        its = sorted((c for c in scenario.change if key in c.set), key=lambda each: each.at)
        for one, other in pairwise(its):
            if other.at < one.end or other.at == one.at:
                return (
                    f"change: {key}: changes again at {other.at:g} s, before what began at "
                    f"{one.at:g} s is over"
                )
    return ""


def _ramp_problem(scenario: Scenario, change: Change) -> str:
    """Why no ramp leads from the old values to the new ones; empty if one does."""
    if not change.over:
        return ""
    before = at_time(scenario, change.at - 2 * TIME_TOLERANCE_S)
    for key in map("plant.servo.{}".format, NONE_AT_ZERO):
        if key in change.set and not (change.set[key] and value_of(before, key)):
            return f"{key}: 0 stands for none, so no ramp leads there; leave out over"
    return ""


def _between(old: Any, new: Any, share: float) -> Any:
    """Interpolate between two numbers or tuples of them, at a share of the way."""
    if share == 1.0:
        return new
    if isinstance(old, tuple):
        return tuple(_between(*pair, share) for pair in zip(old, new, strict=True))
    return old + share * (new - old)


def _tuples(value: Any) -> Any:
    """Lists as the tuples that a scenario has."""
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value


def _with(model: Any, key: str, value: Any) -> Any:
    """A table with a new value under a dotted key."""
    name, _, rest = key.partition(".")
    inner = _with(getattr(model, name), rest, value) if rest else value
    return model.model_copy(update={name: inner})
