"""Variants of a scenario: what is varied, and the shortest names that tell the variants apart."""

from __future__ import annotations

import itertools
import json
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from twin.data_file import DataError, parse_toml
from twin.errors import ScenarioError
from twin.scenario.load import setting


class Variant(NamedTuple):
    """One combination of values.

    Attributes:
        settings: Dotted key to value.
        label: ``KEY=VALUE`` of each, with spaces between.
        heading: The shortest text that tells it from the others.
        name: The same with the last part of each key, for where no key stands over it.
    """

    settings: tuple[tuple[str, Any], ...] = ()
    label: str = ""
    heading: str = ""
    name: str = ""


def variants(vary: Sequence[str]) -> list[Variant]:
    """All combinations of the values of ``KEY=[A, B, ...]`` or ``KEY=A,B,...``.

    A value may be a table, as ``controller=[{kind="afl"}, {kind="lqr", rho=100}]``.

    Raises:
        ScenarioError: If a text is neither.
    """
    return [
        Variant(
            tuple(pair for item in each for pair in item.settings),
            " ".join(item.label for item in each),
            ", ".join(item.heading for item in each),
            " ".join(item.name for item in each),
        )
        for each in itertools.product(*map(_values, vary))
    ]


def varied(vary: Sequence[str]) -> list[str]:
    """Each key with the headings of its values, to name a comparison by."""
    return [
        f"{text.partition('=')[0]}={','.join(item.heading for item in _values(text))}"
        for text in vary
    ]


def comparison(what: str, vary: Sequence[str], changed: Sequence[str]) -> str:
    """The title of a comparison: what ran, over which keys, and what all runs share.

    Args:
        what: Title of the scenario, or names of several.
        vary: ``KEY=[A, B]`` each, or keys.
        changed: ``KEY=VALUE`` each.
    """
    over = " over " + ", ".join(text.partition("=")[0].strip() for text in vary) if vary else ""
    return f"{what}{over} ({', '.join(changed)})" if changed else f"{what}{over}"


def headings(values: Sequence[Any]) -> list[str]:
    """What to call values of one key: of a table its kind, with its settings if others have it."""
    kinds = [value.get("kind") if isinstance(value, Mapping) else None for value in values]
    return [_heading(value, alone=kinds.count(kinds[i]) == 1) for i, value in enumerate(values)]


def written(value: Any) -> str:
    """A value as TOML has it in a line; a text without its quotes."""
    return value.strip() if isinstance(value, str) else _inline(value)


def _values(text: str) -> list[Variant]:
    key, equals, values = text.partition("=")
    key = key.strip()
    if not equals or not key or not values:
        raise ScenarioError(f"--vary '{text[:200]}': write KEY=[A,B,...], as in duration=[5,10]")
    try:
        listed: Any = parse_toml(f"values = {values}")["values"]
    except tomllib.TOMLDecodeError:
        listed = [setting(f"{key}={item}")[1] for item in values.strip("[]").split(",")]
    except DataError as error:
        raise ScenarioError(f"--vary '{key[:200]}': {error}") from None
    items = listed if isinstance(listed, list) else [listed]
    setting(f"{key}=0")  # the key is one
    leaf = key.rpartition(".")[2]
    return [
        Variant(
            ((key, item),),
            f"{key}={written(item)}",
            heading,
            heading if leaf == "kind" or isinstance(item, Mapping) else f"{leaf}={heading}",
        )
        for item, heading in zip(items, headings(items), strict=True)
    ]


def _heading(value: Any, *, alone: bool) -> str:
    if not isinstance(value, Mapping):
        return written(value)
    settings = [f"{key}={written(item)}" for key, item in value.items() if key != "kind"]
    kind = str(value.get("kind", ""))
    if kind and alone:
        return kind
    return " ".join(filter(None, (kind, ", ".join(settings)))) or "{}"


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key}={_inline(item)}" for key, item in value.items())
        return f"{{{inner}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_inline, value))}]"
    return json.dumps(value, ensure_ascii=False, default=str)
