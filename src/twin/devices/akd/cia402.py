"""The power state machine of CiA 402: what a status word says, and the next control word."""

from __future__ import annotations

from enum import Enum, IntFlag


class State(Enum):
    """States of a drive's power stage; the values are how they are called."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


class Status(IntFlag):
    """Bits of the status word that are looked at beside the state."""

    VOLTAGE = 1 << 4
    WARNING = 1 << 7
    REMOTE = 1 << 9
    INTERNAL_LIMIT = 1 << 11


class Wish(Enum):
    """What an axis is to be brought to."""

    OFF = "off"
    ON = "on"
    QUICK_STOP = "quick stop"


DISABLE_VOLTAGE = 0x00
QUICK_STOP = 0x02
SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE = 0x0F
RESET = 0x80

_WIDE = {
    0x00: State.NOT_READY,
    0x40: State.SWITCH_ON_DISABLED,
    0x08: State.FAULT,
    0x0F: State.FAULT_REACTION,
}
_NARROW = {
    0x21: State.READY,
    0x23: State.SWITCHED_ON,
    0x27: State.OPERATION_ENABLED,
    0x07: State.QUICK_STOP,
}

_UP = {
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.READY: SWITCH_ON,
    State.SWITCHED_ON: ENABLE,
    State.OPERATION_ENABLED: ENABLE,
}
_DOWN = {State.OPERATION_ENABLED: SWITCH_ON, State.SWITCHED_ON: SHUTDOWN}
_QUICK = {State.OPERATION_ENABLED: QUICK_STOP, State.QUICK_STOP: QUICK_STOP}
_STEPS = {Wish.ON: _UP, Wish.OFF: _DOWN, Wish.QUICK_STOP: _QUICK}


def state(status: int) -> State:
    """The state that a status word means, any integer; masks 4Fh and 6Fh of CiA 402."""
    return _WIDE.get(status & 0x4F) or _NARROW.get(status & 0x6F) or State.UNKNOWN


def control(now: State, wish: Wish) -> int:
    """The control word that takes a drive one transition from a state towards a wish.

    It never resets a fault: in both fault states, and wherever no step leads on, it disables the
    voltage, which is also what comes before the rising edge of a reset.
    """
    return _STEPS[wish].get(now, DISABLE_VOLTAGE)
