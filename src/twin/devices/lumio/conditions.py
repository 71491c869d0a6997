"""Conditions of the touch screen: each row of ``conditions.toml``."""

from __future__ import annotations

from twin.hal.interface import conditions

_TABLE = conditions("twin.devices.lumio")
SCREEN_CONDITIONS = tuple(_TABLE.values())
"""Every condition the touch screen reports; ``within`` counts from the first byte that shows it."""
UNPLUGGED = _TABLE["UNPLUGGED"]
BALL_LOST = _TABLE["BALL_LOST"]
FROZEN = _TABLE["FROZEN"]
SWAPPED_AXES = _TABLE["SWAPPED_AXES"]
RELOCATED = _TABLE["RELOCATED"]
UNKNOWN_PROTOCOL = _TABLE["UNKNOWN_PROTOCOL"]
SCAN_STILL = _TABLE["SCAN_STILL"]
TOUCH_LATE = _TABLE["TOUCH_LATE"]
TWO_CONTACTS = _TABLE["TWO_CONTACTS"]
JUMP = _TABLE["JUMP"]
STALE = _TABLE["STALE"]
DROPOUT = _TABLE["DROPOUT"]
OUT_OF_RANGE = _TABLE["OUT_OF_RANGE"]
BAD_BYTES = _TABLE["BAD_BYTES"]
CHECKSUM = _TABLE["CHECKSUM"]
FLOOD = _TABLE["FLOOD"]
