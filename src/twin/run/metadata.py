"""Metadata of a record: what the controller was."""

from __future__ import annotations

import hashlib
from typing import Any

from controllers.catalog import origin
from twin.scenario.schema import KINDS, Scenario, choices, with_settings


def classes_of(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """What law, observer and reference of a scenario were, by their tables.

    Returns:
        All settings with their values, also those that the scenario leaves to the class; and of a
        class that is not part of this program its file's name, SHA-256 and source text.
    """
    found: dict[str, dict[str, Any]] = {}
    for table in KINDS:
        choice = getattr(scenario, table)
        cls = choices(table)[choice.kind]
        given = with_settings(cls, choice.settings)
        found[table] = {"settings": given.model_dump(mode="json", warnings=False)}
        if (place := origin(cls)) is not None:
            file, text = place
            mark = hashlib.sha256(text.encode()).hexdigest() if text else ""
            found[table] |= {"file": file, "sha256": mark, "source": text}
    return found
