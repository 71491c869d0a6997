"""Ranges of settings, and which of them are safety nets that a rig file may relax, with a warning.

A net is a threshold; beyond its range it would be none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field, fields
from typing import Any

from twin.errors import ScenarioError


def net(default: Any, low: float, high: float, *, sense: int = 1, **metadata: Any) -> Any:
    """A field that is a safety net.

    Args:
        default: Its default.
        low: Least value.
        high: Largest value.
        sense: 1 where larger values notice less or allow more, -1 where smaller ones do.
        metadata: Further metadata.
    """
    return field(default=default, metadata={"range": (low, high), "net": sense, **metadata})


def bounded(default: Any, low: float, high: float, **metadata: Any) -> Any:
    """A field with a range that is no net."""
    return field(default=default, metadata={"range": (low, high), **metadata})


def check_ranges(settings: Any, prefix: str) -> None:
    """Refuse a value that is no number of its range.

    Args:
        settings: A dataclass with such fields.
        prefix: What its keys begin with, as ``drives.watch.``.

    Raises:
        ScenarioError: Naming the key.
    """
    for each in fields(settings):
        low, high = each.metadata.get("range", (None, None))
        value = getattr(settings, each.name)
        if low is None or value is None:
            continue
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(low <= number <= high for number in numbers):
            raise ScenarioError(f"{prefix}{each.name} = {value}: must be {low:g} to {high:g}")


def relaxed_nets(settings: Any, prefix: str) -> Iterator[str]:
    """Every net that is wider than by default: key, value and default."""
    for each in fields(settings):
        value = getattr(settings, each.name)
        if (sense := each.metadata.get("net")) and wider(value, each.default, sense):
            yield f"{prefix}{each.name} = {value} (default {each.default})"


def wider(value: Any, default: Any, sense: int = 1) -> bool:
    """Whether a number, or one of a tuple, is on the relaxed side of its default."""
    if isinstance(default, tuple):
        return any(wider(*pair, sense) for pair in zip(value, default, strict=True))
    return bool(sense * (value - default) > 0)
