"""The power state machine of CiA 402: what a status word says, and the next control word."""

from __future__ import annotations

from enum import Enum, IntFlag


class DriveState(Enum):
    """States of a drive's power stage; the values are what CiA 402 calls them."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


class StatusBit(IntFlag):
    """Bits of the status word that are evaluated besides the state."""

    VOLTAGE = 1 << 4
    WARNING = 1 << 7
    REMOTE = 1 << 9
    INTERNAL_LIMIT = 1 << 11


class AxisRequest(Enum):
    """What an axis is requested to reach."""

    DISABLE = "disable"
    ENABLE = "enable"
    QUICK_STOP = "quick stop"


DISABLE_VOLTAGE = 0x00
QUICK_STOP = 0x02
SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE = 0x0F
RESET = 0x80

_WIDE = {
    0x00: DriveState.NOT_READY,
    0x40: DriveState.SWITCH_ON_DISABLED,
    0x08: DriveState.FAULT,
    0x0F: DriveState.FAULT_REACTION,
}
_NARROW = {
    0x21: DriveState.READY,
    0x23: DriveState.SWITCHED_ON,
    0x27: DriveState.OPERATION_ENABLED,
    0x07: DriveState.QUICK_STOP,
}

_UP = {
    DriveState.SWITCH_ON_DISABLED: SHUTDOWN,
    DriveState.READY: SWITCH_ON,
    DriveState.SWITCHED_ON: ENABLE,
    DriveState.OPERATION_ENABLED: ENABLE,
}
_DOWN = {DriveState.OPERATION_ENABLED: SWITCH_ON, DriveState.SWITCHED_ON: SHUTDOWN}
_QUICK = {DriveState.OPERATION_ENABLED: QUICK_STOP, DriveState.QUICK_STOP: QUICK_STOP}
_TRANSITIONS = {
    AxisRequest.ENABLE: _UP,
    AxisRequest.DISABLE: _DOWN,
    AxisRequest.QUICK_STOP: _QUICK,
}


def state(status: int) -> DriveState:
    """The state that a status word means, any integer; masks 4Fh and 6Fh of CiA 402."""
    return _WIDE.get(status & 0x4F) or _NARROW.get(status & 0x6F) or DriveState.UNKNOWN


_SAID = (
    (StatusBit.VOLTAGE, False, "no main voltage"),
    (StatusBit.WARNING, True, "warning"),
    (StatusBit.REMOTE, False, "not under remote control"),
    (StatusBit.INTERNAL_LIMIT, True, "internal limit active"),
)
"""What a bit says beside the state, where it is set or where it is not."""
_HALT = 1 << 8


def status_words(status: int) -> str:
    """A status word in words: the state, and what else it warns of."""
    more = [words for bit, given, words in _SAID if bool(status & bit) is given]
    return ", ".join((state(status).value, *more))


def control_words(control: int) -> str:
    """What a control word asks for, in words."""
    if control & RESET:
        return "fault reset"
    if not control & QUICK_STOP:
        return "disable voltage"
    if not control & 0x04:
        return "quick stop"
    if not control & 0x01:
        return "shutdown"
    if not control & 0x08:
        return "switch on"
    return "enable operation, halt" if control & _HALT else "enable operation"


def control_word(current: DriveState, request: AxisRequest) -> int:
    """The control word that takes a drive one transition from a state towards a request.

    It never resets a fault: in both fault states, and wherever no transition leads on, it disables
    the voltage, which is also what comes before the rising edge of a reset.
    """
    return _TRANSITIONS[request].get(current, DISABLE_VOLTAGE)
