"""What a rig may do, and the one table of how that changes."""

from __future__ import annotations

from enum import IntEnum, StrEnum
from types import MappingProxyType


class State(IntEnum):
    """What a rig is allowed to do.

    OFF: drives without torque. INITIALISING: devices are brought up, nothing is commanded.
    READY: drives on, plate held, waiting for an explicit start. RUNNING: follows the controller.
    HOLDING: the plate is levelled, then held. FAULT: zero rate at once, drives stopped.
    """

    OFF = 0
    INITIALISING = 1
    READY = 2
    RUNNING = 3
    HOLDING = 4
    FAULT = 5


class Event(StrEnum):
    """What changes a rig's state: requests of the program, and the answers to conditions.

    INITIALISE, START and SWITCH_OFF are explicit requests, POWERED says that the drives hold the
    plate, LEVEL and STOP answer a condition of that severity.
    """

    INITIALISE = "initialise"
    POWERED = "powered"
    START = "start"
    LEVEL = "level"
    STOP = "stop"
    SWITCH_OFF = "switch off"


TRANSITIONS = MappingProxyType(
    {
        (State.OFF, Event.INITIALISE): State.INITIALISING,
        (State.INITIALISING, Event.POWERED): State.READY,
        (State.INITIALISING, Event.STOP): State.FAULT,
        (State.INITIALISING, Event.SWITCH_OFF): State.OFF,
        (State.READY, Event.START): State.RUNNING,
        (State.READY, Event.LEVEL): State.HOLDING,
        (State.READY, Event.STOP): State.FAULT,
        (State.READY, Event.SWITCH_OFF): State.OFF,
        (State.RUNNING, Event.LEVEL): State.HOLDING,
        (State.RUNNING, Event.STOP): State.FAULT,
        (State.RUNNING, Event.SWITCH_OFF): State.OFF,
        (State.HOLDING, Event.STOP): State.FAULT,
        (State.HOLDING, Event.SWITCH_OFF): State.OFF,
        (State.FAULT, Event.SWITCH_OFF): State.OFF,
    }
)
"""Every transition; an event that is not listed for a state changes nothing. Out of HOLDING and
FAULT leads nothing but switching off: who wants to go on runs again."""
