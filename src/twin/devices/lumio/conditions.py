"""Everything that can go wrong with the touch screen: each row of ``conditions.toml``."""

from __future__ import annotations

from twin.hal.interface import Condition, conditions

_TABLE = conditions("twin.devices.lumio")
CONDITIONS = tuple(_TABLE.values())
"""Every condition the touch screen reports; ``within`` counts from the first byte that shows it."""
globals().update(_TABLE)


def __getattr__(name: str) -> Condition:
    raise AttributeError(name)
