"""Scenarios of a study's points, checked like any other."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import Any

from pydantic_core import to_jsonable_python

from twin.errors import ScenarioError
from twin.scenario import Scenario
from twin.scenario.load import check, resolved, setting, validated
from twin.scenario.load import read as read_tables
from twin.scenario.schema import KINDS, checked_settings, choices
from twin.study.family import Point

_MISSING = object()
KNOWN = ("mass", "radius", "inertia")
"""What a controller's designer knows of the ball."""


def _with_defaults(scenario: Scenario) -> dict[str, Any]:
    """What a scenario says, and what its law, observer and reference have by default."""
    found: dict[str, Any] = json.loads(scenario.model_dump_json())
    for name in KINDS:
        choice = getattr(scenario, name)
        own = checked_settings(choices(name)[choice.kind], choice.settings)
        found[name] = to_jsonable_python(own) | found[name]
    return found


class Builder:
    """Scenarios from overrides and points, as ``load`` makes them; but a law is checked once.

    Where a point says something of the ball, the controller is designed on the ball without it: a
    point is what a designer does not know.

    Args:
        name: Name or file of the scenario.
    """

    def __init__(self, name: str) -> None:
        self._tables, self._source = read_tables(name)
        self._setting = cache(setting)
        self._checked: set[str] = set()
        self._bases: dict[tuple[str, ...], dict[str, Any]] = {}

    def __call__(
        self, fixed: Sequence[str], point: Point, relative: Collection[str] = ()
    ) -> Scenario:
        """The scenario with overrides and, over them, the values of a point.

        Args:
            fixed: Overrides ``key=value``.
            point: Dotted key to value; ``key.0`` is the first number of a list.
            relative: Keys whose values are factors on what the scenario says.

        Raises:
            ScenarioError: If a key does not exist, or a value is out of range.
        """
        given: dict[str, Any] = {}
        if any(key.startswith("plant.ball.") for key in point):
            known = self._built([*map(self._setting, fixed)]).designed_on
            given["controller.model"] = {key: getattr(known, key) for key in KNOWN}
        for key, value in point.items():
            factor = value if key in relative else None
            path, _, tail = key.rpartition(".")
            at = int(tail) if path and tail.isdigit() else None
            if at is None and factor is None:
                given[key] = value
                continue
            name = key if at is None else path
            whole = given[name] if name in given else self._now(fixed, name)
            given[name] = self._changed(key, whole, at, value, relative=key in relative)
        return self._built([*map(self._setting, fixed), *given.items()])

    def value(self, fixed: Sequence[str], key: str) -> Any:
        """What the scenario says of a key, ``key.0`` the first number of a list, or its default.

        Raises:
            ScenarioError: If there is no such key, or an override is wrong.
        """
        path, _, tail = key.rpartition(".")
        at = int(tail) if path and tail.isdigit() else None
        whole = self._now(fixed, key if at is None else path)
        return whole if at is None else self._part(key, whole, at)

    def _part(self, key: str, whole: Any, at: int) -> Any:
        if not (isinstance(whole, list) and at < len(whole)):
            known = f"0 to {len(whole) - 1}" if isinstance(whole, list) else "it is no list"
            raise ScenarioError(f"{self._source}: {key}: no such number ({known})")
        return whole[at]

    def _changed(self, key: str, whole: Any, at: int | None, value: Any, *, relative: bool) -> Any:
        """What a key becomes: a number, or a list with one of its numbers changed."""
        old = whole if at is None else self._part(key, whole, at)
        if relative and not isinstance(old, int | float):
            raise ScenarioError(f"{self._source}: {key}: no number to take a part of, but {old!r}")
        new = value * old if relative else value
        return new if at is None else [*whole[:at], new, *whole[at + 1 :]]

    def _now(self, fixed: Sequence[str], key: str) -> Any:
        """What the scenario says of a key, by itself or by default."""
        base = tuple(text for text in fixed if not text.startswith("seed="))
        if base not in self._bases:
            self._bases[base] = _with_defaults(self._built([*map(self._setting, base)]))
        table: Any = self._bases[base]
        for name in key.split("."):
            table = table.get(name, _MISSING) if isinstance(table, Mapping) else _MISSING
        if table is _MISSING:
            raise ScenarioError(f"{self._source}: {key}: not given by the scenario and no default")
        return table

    def _built(self, settings: Collection[tuple[str, Any]]) -> Scenario:
        merged, source = resolved(self._tables, self._source, settings)
        choices = json.dumps([merged.get(table) for table in KINDS], default=str)
        if choices in self._checked:
            return validated(Scenario, merged, source)
        scenario = check(merged, source)
        self._checked.add(choices)
        return scenario
