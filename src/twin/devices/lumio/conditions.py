"""Everything that can go wrong with the touch screen, in one table."""

from __future__ import annotations

from twin.hal.faults import Condition, Severity

_LEVEL = "the plate is levelled and held"
_NOTED = "noted in the record"

UNPLUGGED = Condition(
    "touch screen gone",
    Severity.LEVEL,
    0.1,
    _LEVEL,
    "plug it in again, then run again",
)
BALL_LOST = Condition(
    "ball lost",
    Severity.LEVEL,
    0.12,
    _LEVEL,
    "put the ball on the plate, then run again",
    device=False,
)
FROZEN = Condition(
    "touch frozen",
    Severity.LEVEL,
    0.4,
    _LEVEL,
    "lift the ball and put it back; if its position stays, power-cycle the screen",
)
SWAPPED_AXES = Condition(
    "axes swapped",
    Severity.LEVEL,
    0.1,
    "positions are refused; " + _LEVEL,
    "check the screen's orientation and the calibration, then run again",
)
RELOCATED = Condition(
    "position jumped and stayed",
    Severity.LEVEL,
    0.1,
    _LEVEL,
    "take away whatever else touches the screen, then run again",
)
UNKNOWN_PROTOCOL = Condition(
    "protocol not recognised",
    Severity.LEVEL,
    1.5,
    _LEVEL,
    "check baud rate and protocol in the rig file, then run again",
)
TWO_CONTACTS = Condition(
    "two contacts", Severity.WARNING, 0.1, "the one nearest the ball is followed", "none needed"
)
JUMP = Condition("position jumped", Severity.WARNING, 0.05, "the sample is refused", "none needed")
STALE = Condition(
    "touch stale",
    Severity.WARNING,
    0.08,
    "its age grows; without a new sample the ball is lost",
    "none needed",
)
DROPOUT = Condition(
    "brief dropout", Severity.WARNING, 0.15, "bridged by the last position", "none needed"
)
OUT_OF_RANGE = Condition(
    "value out of range", Severity.WARNING, 0.05, "the sample is refused", "none needed"
)
BAD_BYTES = Condition(
    "bytes not understood", Severity.WARNING, 0.1, "skipped to the next packet", "none needed"
)
CHECKSUM = Condition(
    "checksum error", Severity.WARNING, 0.05, "the packet is refused", "none needed"
)
FLOOD = Condition(
    "byte flood",
    Severity.WARNING,
    0.3,
    "the oldest bytes are dropped unread",
    "check the cable and the baud rate",
)

CONDITIONS = (
    UNPLUGGED,
    BALL_LOST,
    FROZEN,
    SWAPPED_AXES,
    RELOCATED,
    UNKNOWN_PROTOCOL,
    TWO_CONTACTS,
    JUMP,
    STALE,
    DROPOUT,
    OUT_OF_RANGE,
    BAD_BYTES,
    CHECKSUM,
    FLOOD,
)
"""Every condition the touch screen reports; ``within`` counts from the first byte that shows it."""
