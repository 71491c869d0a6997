"""Tables of scenarios as read from TOML: merged with others, and with values of dotted keys."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Collection, Iterable, Mapping
from typing import Any

from twin.base.data_file import MAX_NESTING, DataError, parse_toml
from twin.base.errors import ScenarioError, shorten
from twin.scenario import schema
from twin.scenario.rig_tables import without_ball
from twin.scenario.schema import CATALOG_TABLES

Tables = dict[str, Any]


def merge_tables(tables: Mapping[str, Any], more: Mapping[str, Any]) -> Tables:
    """Merge tables: the values of ``more`` replace those of ``tables``, key by key.

    A new ``kind`` of controller, observer or reference drops the settings of the old, and a setting
    drops those that it replaces.
    """
    law = more.get("controller")
    given = [f"controller.{name}" for name in law] if isinstance(law, Mapping) else []
    return _without_replaced(_merge(tables, more), given)


def _merge(tables: Mapping[str, Any], more: Mapping[str, Any]) -> Tables:
    """Merge tables without a look at the settings of a law that others replace."""
    result = dict(tables)
    for key, value in more.items():
        old = result.get(key)
        match old, value:
            case dict(), dict() if key not in CATALOG_TABLES or value.get("kind") in {
                None,
                old.get("kind"),
            }:
                result[key] = _merge(old, value)
            case _:
                result[key] = value
    return result


def find_replaced(tables: Mapping[str, Any], given: Collection[str]) -> dict[str, str]:
    """Find the settings of a law that given keys replace, as gains do poles, and their new keys.

    A setting that is given itself stays: the check of the tables refuses the two together.
    """
    controller: Any = tables.get("controller")
    kind = controller.get("kind") if isinstance(controller, dict) else None
    law: Any = schema.choices("controller").get(kind) if isinstance(kind, str) else None
    replaces: Mapping[str, tuple[str, ...]] = getattr(law, "replaces", {})
    pairs = [(one, other) for one, others in replaces.items() for other in others]
    return {
        old: new
        for pair in pairs
        for new, old in (pair, pair[::-1])
        if f"controller.{new}" in given and f"controller.{old}" not in given and old in controller
    }


def _without_replaced(tables: Tables, given: Collection[str]) -> Tables:
    """Tables without the settings of the law that given keys replace."""
    if not (old := find_replaced(tables, given)):
        return tables
    law = {name: value for name, value in tables["controller"].items() if name not in old}
    return tables | {"controller": law}


TEXT_KEYS = ("parameters", "board.program")
"""Keys that hold names of files: a text, also where it looks like a number."""


def setting(text: str, called: str = "override") -> tuple[str, Any]:
    """Key and value of an override.

    Args:
        text: The override.
        called: What a message calls it.

    Raises:
        ScenarioError: If it is not of the form ``key=value``.
    """
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not all(key.split(".")):
        raise ScenarioError(f"{called} '{shorten(text)}': write key=value, as in duration=10")
    try:
        found = parse_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key, value
    except DataError as error:
        raise ScenarioError(f"{called} '{shorten(key)}': {error}") from None
    return key, value if key in TEXT_KEYS and not isinstance(found, str) else found


def split_settings(text: str) -> tuple[str, ...]:
    """The overrides in one text, ``key=value; key=value``."""
    return tuple(part.strip() for part in text.split(";") if part.strip())


def put(tables: Mapping[str, Any], settings: Iterable[tuple[str, Any]]) -> Tables:
    """The tables with the values of dotted keys put in.

    Naming a new ``kind`` of controller, observer or reference drops the settings of the old; the
    ball that is known stays. A setting drops those that it replaces.

    Raises:
        ScenarioError: If a key leads through a value.
    """
    result, settings = copy.deepcopy(dict(tables)), list(settings)
    for key, new in sorted(settings, key=lambda item: not item[0].endswith(".kind")):
        names = key.split(".")
        if len(names) > MAX_NESTING:
            raise ScenarioError(f"{shorten(key)}: a key has at most {MAX_NESTING} parts")
        table = result
        for depth, name in enumerate(names[:-1]):
            table = table.setdefault(name, {})
            if not isinstance(table, dict):
                path = ".".join(names[: depth + 1])
                raise ScenarioError(f"{key}: {path} is a value, not a table")
        if key in {f"{each}.kind" for each in CATALOG_TABLES} and table.get("kind") != new:
            for other in table.keys() - {"model"}:
                del table[other]
        if names == ["plant", "ball", "kind"] and table.get("kind", new) != new:
            without_ball(result["plant"], table["kind"])
        table[names[-1]] = copy.deepcopy(new)
    return _without_replaced(result, [key for key, _ in settings])


def scale_lengths(value: Any, share: float) -> Any:
    """A length, or lists of lengths, times a share; of a row (time, x, y) the time stays."""
    match value:
        case [int() | float() as time, x, y]:
            return [time, scale_lengths(x, share), scale_lengths(y, share)]
        case list() | tuple():
            return [scale_lengths(each, share) for each in value]
        case int() | float():
            return float(f"{value * share:.12g}")
    return value
