"""A branch: the scenario of a future that begins at a moment of a run, with something changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from twin.errors import ScenarioError
from twin.scenario.load import check, put, setting
from twin.scenario.schema import JUMPS, RAMPS, Scenario

CONTROL = ("controller.", "observer.", "predictor.", "reference.")
"""Beginnings of the keys that belong to the controller and its task."""


def branch(scenario: Scenario, at: float, end: float, settings: Sequence[str]) -> Scenario:
    """The scenario of a future in which something is changed at a moment.

    What belongs to the controller is another one from the beginning; what belongs to the plant
    changes at the moment, as ``[[change]]`` does.

    Args:
        scenario: Of the run.
        at: The moment, s.
        end: Time of the run in s at which the future ends.
        settings: ``key=value`` each.

    Raises:
        ScenarioError: If a key cannot change while a rig runs, or a value is out of range.
    """
    values = dict(map(setting, settings))
    plant = {key: value for key, value in values.items() if key in RAMPS + JUMPS}
    for key in values:
        if key not in plant and not key.startswith(CONTROL):
            raise ScenarioError(
                f"--set {key}: cannot change while a plant runs (what can: "
                f"{', '.join(f'{begin}*' for begin in CONTROL)}, {', '.join(RAMPS + JUMPS)})"
            )
    tables = scenario.model_dump(mode="json")
    control = {key: value for key, value in values.items() if key not in plant}
    tables = put(tables, [*control.items(), ("duration", end), ("baseline", False)])
    later: list[Mapping[str, Any]] = [each for each in tables["change"] if each["at"] < end]
    tables["change"] = [*later, *([{"at": at, "set": plant}] if plant else [])]
    tables["metrics"]["start"] = max(at, min(scenario.metrics.start, at + (end - at) / 2))
    what = ", ".join(settings) or "unchanged"
    tables["title"] = f"{scenario.title} ({what} from {at:g} s on)"
    return check(tables, "what-if")
