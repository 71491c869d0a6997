"""Everything that can go wrong with the touch screen, in one table."""

from __future__ import annotations

from twin.hal.interface import Condition, Severity

_LEVEL = "the plate is levelled and held"


def _level(
    name: str, within: float, recovery: str, reaction: str = _LEVEL, *, device: bool = True
) -> Condition:
    return Condition(name, Severity.LEVEL, within, reaction, recovery, device=device)


def _warning(name: str, within: float, reaction: str, recovery: str = "none needed") -> Condition:
    return Condition(name, Severity.WARNING, within, reaction, recovery)


UNPLUGGED = _level("touch screen gone", 0.1, "plug it in again, then run again")
BALL_LOST = _level("ball lost", 0.12, "put the ball on the plate, then run again", device=False)
FROZEN = _level(
    "touch frozen",
    0.4,
    "lift the ball and put it back; if its position stays, power-cycle the screen",
)
SWAPPED_AXES = _level(
    "axes swapped",
    0.1,
    "check the screen's orientation and the calibration, then run again",
    "positions are refused; " + _LEVEL,
)
RELOCATED = _level(
    "position jumped and stayed", 0.1, "take away whatever else touches the screen, then run again"
)
UNKNOWN_PROTOCOL = _level(
    "protocol not recognised", 1.5, "check baud rate and protocol in the rig file, then run again"
)
TWO_CONTACTS = _warning("two contacts", 0.1, "the one nearest the ball is followed")
JUMP = _warning("position jumped", 0.05, "the sample is refused")
STALE = _warning("touch stale", 0.08, "its age grows; without a new sample the ball is lost")
DROPOUT = _warning("brief dropout", 0.15, "bridged by the last position")
OUT_OF_RANGE = _warning("value out of range", 0.05, "the sample is refused")
BAD_BYTES = _warning("bytes not understood", 0.1, "skipped to the next packet")
CHECKSUM = _warning("checksum error", 0.05, "the packet is refused")
FLOOD = _warning(
    "byte flood", 0.3, "the oldest bytes are dropped unread", "check the cable and the baud rate"
)

CONDITIONS = tuple(value for value in list(globals().values()) if isinstance(value, Condition))
"""Every condition the touch screen reports; ``within`` counts from the first byte that shows it."""
