"""Metadata of a record: what the controller was, and what all of it must look like."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from controllers.catalog import origin
from twin.errors import RecordError, ScenarioError
from twin.scenario.load import validated
from twin.scenario.schema import KINDS, Scenario, choices, with_settings


class _Open(BaseModel):
    """A JSON object that may hold more than is named here."""

    model_config = ConfigDict(strict=True, extra="allow")


class _Judged(_Open):
    """The indicators: what is not named is a number, or null where it does not apply."""

    __pydantic_extra__: dict[str, float | None] = Field(init=False)
    outcome: str = ""
    outcome_time: float = 0.0
    reason: str | None = None


class _Detected(_Open):
    time: float
    severity: str
    text: str


class _Times(_Open):
    number: int
    p50_us: float
    p99_us: float
    max_us: float


class _RealTime(_Open):
    lateness: _Times
    stages: dict[str, _Times]
    round_trip: _Times


class _Controlled(_Open):
    since: float
    controller: dict[str, Any]
    observer: dict[str, Any]
    predictor: dict[str, Any] | None


class _Driven(_Open):
    goals: int
    changes: int
    pushes: tuple[tuple[float, float, float], ...]
    controllers: tuple[_Controlled, ...]


class _Class(_Open):
    settings: dict[str, Any] = {}
    file: str = ""
    sha256: str = ""
    source: str = ""


class _Metadata(_Open):
    classes: dict[str, _Class] = {}
    metrics: _Judged = _Judged()
    versions: dict[str, str] = {}
    events: tuple[_Detected, ...] = ()
    ledger: _RealTime | None = None
    branch: dict[str, Any] = {}
    driven: _Driven | None = None


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


def check_metadata(metadata: Mapping[str, Any], source: str) -> None:
    """Make sure that what is shown of a run has the types it is shown with.

    Raises:
        RecordError: If it has not: which key, what it must be, what it is.
    """
    try:
        validated(_Metadata, metadata, source, "metadata 'ballplate': ")
    except ScenarioError as error:
        raise RecordError(str(error)) from None
