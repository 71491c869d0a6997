"""What a run is called: its scenario's title and what was changed of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from twin.scenario.schema import Scenario


def titled(scenario: Scenario, overrides: Sequence[str]) -> Scenario:
    """The scenario with what was changed in its title, so that the title says what ran.

    Args:
        scenario: With the overrides in force.
        overrides: ``KEY=VALUE`` each, as given; one of the title itself says nothing more.
    """
    changed = [text for text in overrides if text.partition("=")[0].strip() != "title"]
    if not changed:
        return scenario
    return scenario.model_copy(update={"title": f"{scenario.title} ({', '.join(changed)})"})
