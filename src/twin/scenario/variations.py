"""Variations of a scenario: lists of values of keys, their combinations, and the shortest names."""

from __future__ import annotations

import itertools
import json
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from twin.base.data_file import DataError, parse_toml
from twin.base.errors import ScenarioError
from twin.scenario.merging import setting

MAX_RANGE_VALUES = 1000
"""Values that a range may have."""


class Combination(NamedTuple):
    """One combination of values.

    Attributes:
        settings: Dotted key to value.
        label: ``KEY=VALUE`` of each, with spaces between.
        name: The shortest text that tells it from the others, with the last part of each key.
    """

    settings: tuple[tuple[str, Any], ...] = ()
    label: str = ""
    name: str = ""


def parse_variations(vary: Sequence[str], name: str = "vary") -> dict[str, list[Any]]:
    """Key to values of each ``KEY=[A, B, ...]`` or ``KEY=A,B,...``.

    A value may be a table, as ``controller=[{kind="afl"}, {kind="lqr", rho=100}]``.

    Args:
        vary: The texts.
        name: What to call them in messages, as ``--vary``.

    Raises:
        ScenarioError: If a text is neither, or two have the same key.
    """
    found: dict[str, list[Any]] = {}
    for key, values in (_parse_variation(text, name) for text in vary):
        if key in found:
            raise ScenarioError(f"{name} {key}: is given twice; give all its values in one list")
        found[key] = values
    return found


def swept(text: str) -> tuple[str, list[Any]]:
    """Key and values of ``KEY=FIRST:LAST:NUMBER``, evenly spaced, or ``KEY=[A, B, ...]``.

    Raises:
        ScenarioError: If the text is neither.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    form = f"sweep '{text[:200]}': write KEY=FIRST:LAST:NUMBER, as in duration=5:10:6, or KEY=[A,B]"
    if not key or not equals or not values:
        raise ScenarioError(form)
    if values.startswith("["):
        return _parse_variation(text, "sweep")
    parts = values.split(":")
    try:
        first, last, number = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        raise ScenarioError(form) from None
    if len(parts) != 3 or not math.isfinite(first + last) or not 2 <= number <= MAX_RANGE_VALUES:
        raise ScenarioError(f"{form}; NUMBER: 2 to {MAX_RANGE_VALUES}")
    spaced = [float(f"{value:.12g}") for value in np.linspace(first, last, number)]
    whole = "." not in parts[0] + parts[1] and all(value.is_integer() for value in spaced)
    return key, [int(value) for value in spaced] if whole else spaced


def variants(vary: Mapping[str, Sequence[Any]]) -> list[Combination]:
    """All combinations of the values of some keys; one without any if there is no key."""
    return [
        Combination(
            tuple(pair for item in each for pair in item.settings),
            " ".join(item.label for item in each),
            " ".join(item.name for item in each),
        )
        for each in itertools.product(*(_values(key, items) for key, items in vary.items()))
    ]


def comparison(what: str, keys: Iterable[str], changed: Sequence[str]) -> str:
    """The title of a comparison: what ran, over which keys, and what all runs share.

    Args:
        what: Title of the scenario, or names of several.
        keys: What is varied.
        changed: ``KEY=VALUE`` each; one of the title itself is left out.
    """
    varied_keys = ", ".join(keys)
    over = f" over {varied_keys}" if varied_keys else ""
    shown = [text for text in changed if text.partition("=")[0].strip() != "title"]
    return f"{what}{over} ({', '.join(shown)})" if shown else f"{what}{over}"


def headings(values: Sequence[Any]) -> list[str]:
    """What to call values of one key: of a table its kind, with its settings if others have it."""
    kinds = [value.get("kind") if isinstance(value, Mapping) else None for value in values]
    return [_heading(value, alone=kinds.count(kinds[i]) == 1) for i, value in enumerate(values)]


def format_toml_value(value: Any) -> str:
    """A value as TOML has it in a line; a text without its quotes."""
    return value.strip() if isinstance(value, str) else inline(value)


def _parse_variation(text: str, name: str) -> tuple[str, list[Any]]:
    key, equals, values = text.partition("=")
    key = key.strip()
    if not equals or not key or not values:
        raise ScenarioError(f"{name} '{text[:200]}': write KEY=[A,B,...], as in duration=[5,10]")
    try:
        listed: Any = parse_toml(f"values = {values}")["values"]
    except tomllib.TOMLDecodeError:
        if values.count("[") != values.count("]"):
            raise ScenarioError(f"{name} '{text[:200]}': brackets must match") from None
        listed = [setting(f"{key}={item}")[1] for item in values.strip("[]").split(",")]
    except DataError as error:
        raise ScenarioError(f"{name} '{key[:200]}': {error}") from None
    setting(f"{key}=0")  # the key is one
    return key, listed if isinstance(listed, list) else [listed]


def _values(key: str, items: Sequence[Any]) -> list[Combination]:
    leaf = key.rpartition(".")[2]
    return [
        Combination(
            ((key, item),),
            f"{key}={format_toml_value(item)}",
            heading if leaf == "kind" or isinstance(item, Mapping) else f"{leaf}={heading}",
        )
        for item, heading in zip(items, headings(items), strict=True)
    ]


def _heading(value: Any, *, alone: bool) -> str:
    if not isinstance(value, Mapping):
        return format_toml_value(value)
    settings = [f"{key}={format_toml_value(item)}" for key, item in value.items() if key != "kind"]
    kind = str(value.get("kind", ""))
    if kind and alone:
        return kind
    return " ".join(filter(None, (kind, ", ".join(settings)))) or "{}"


def inline(value: Any) -> str:
    """A value as TOML has it in a line."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key}={inline(item)}" for key, item in value.items())
        return f"{{{inner}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(inline, value))}]"
    return json.dumps(value, ensure_ascii=False, default=str)
