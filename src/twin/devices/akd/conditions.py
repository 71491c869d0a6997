"""Everything that can go wrong with the drives and their bus: the table, the error, the latch.

Detection times hold for the default settings of `config.MonitorConfig` at a period of 2 ms and
count from the first wrong (or absent) frame on the wire; those of frozen encoders hold while the
motor turns at 0.1 rad/s or more.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.errors import TwinError
from twin.hal.interface import Condition, Fault, Severity

_STOP, _LEVEL, _WARNING = Severity.STOP, Severity.LEVEL, Severity.WARNING

_QUICK = "target zero and quick stop on both axes, then off"
_OFF = "nothing can be sent: the drives stop themselves when the heartbeat ends"
_LEVELLED = "level the plate, then hold"
_NOTED = "noted; the datum is not used"
_REFUSED = "start refused, bus closed again"

_RESET = "remove the cause, then run again, with --reset if a drive holds a fault"
_RESTART = "remove the cause, then run again"
_NONE = "none needed"


def _start(name: str, recovery: str) -> Condition:
    # Each of two drives may leave its request unanswered for 2 s (`AkdConfig.answer`): one that is
    # wrong does not spare the other, which may have torque.
    return Condition(name, _STOP, 4.4, _REFUSED, recovery)


ADAPTER_GONE = Condition("CAN adapter gone", _STOP, 0.02, _OFF, _RESTART, restart=True)
BUS_OFF = Condition("bus off", _STOP, 0.1, _OFF, _RESTART, restart=True)
ERROR_PASSIVE = Condition("error passive", _WARNING, 0.1, "noted", "check cable and termination")
GARBLED = Condition("garbled adapter bytes", _WARNING, 0.02, _NOTED, _NONE)
BAD_BUS = _start("CAN bus cannot be opened", "name an interface and channel that exist")
BIT_RATE = _start("wrong bit rate", "give drives and adapter the same bit rate")

NODE_ABSENT = _start("drive absent", "check power, cable and the node switches")
WRONG_IDENTITY = _start("wrong identity", "name the node of an AKD, or its right identity")
WRONG_SETTING = _start("wrong drive setting", "set the drive, or the configuration, as named")
SECOND_MASTER = Condition(
    "second master on the bus",
    _STOP,
    0.02,
    _QUICK,
    "end the other master, then run again",
    restart=True,
)
# in a run within 0.1 s; at a start after listening, and after drives with torque have lost it
DUPLICATE_ID = Condition("duplicate node id", _STOP, 0.25, _QUICK, _RESTART, restart=True)
HEARTBEAT_LOST = Condition("heartbeat lost", _STOP, 0.08, _QUICK, _RESTART, restart=True)
NMT_LEFT = Condition("left operational state", _STOP, 0.03, _QUICK, _RESTART, restart=True)
DRIVE_REBOOTED = Condition("drive rebooted", _STOP, 0.01, _QUICK, _RESTART, restart=True)
MONITORING_OFF = Condition(
    "monitoring off in the drive", _STOP, 1.2, _QUICK, _RESTART, restart=True
)
SDO_TIMEOUT = Condition("SDO timeout", _LEVEL, 1.2, _LEVELLED, _RESTART)
SDO_ABORT = Condition("SDO abort", _LEVEL, 1.2, _LEVELLED, _RESTART)

EMERGENCY = Condition("emergency message", _WARNING, 0.01, "noted; the status word decides", _NONE)
EMERGENCY_BURST = Condition("emergency burst", _LEVEL, 0.1, _LEVELLED, _RESET)
EMERGENCY_SHORT = Condition("short emergency message", _WARNING, 0.01, "noted", _NONE)

PDO_MISSING = Condition("PDO missing", _WARNING, 0.01, "noted; the last datum ages", _NONE)
PDO_STALE = Condition("PDO stale", _STOP, 0.03, _QUICK, _RESET)
PDO_SHORT = Condition("PDO of wrong length", _WARNING, 0.01, _NOTED, _NONE)
PDO_LATE = Condition("PDO late", _WARNING, 0.01, "noted", _NONE)
PDO_WRONG_CYCLE = Condition("PDO of the wrong cycle", _WARNING, 0.01, "noted", _NONE)
PDO_UNSTEADY = Condition("PDOs unsteady", _LEVEL, 0.15, _LEVELLED, _RESET)

FROZEN = Condition("motor position frozen", _STOP, 0.1, _QUICK, _RESET)
PLATE_FROZEN = Condition("plate encoder frozen", _STOP, 0.35, _QUICK, _RESET)
ENCODER_JUMP = Condition("encoder jump", _STOP, 0.01, _QUICK, _RESET)
RUNAWAY = Condition("motor does not follow", _STOP, 0.1, _QUICK, _RESET)
MODE_CHANGED = Condition("unexpected mode", _STOP, 0.01, _QUICK, _RESTART, restart=True)

DRIVE_FAULT = Condition("drive fault", _STOP, 0.01, _QUICK, _RESET)
FAULT_NUMBER = Condition("fault number", _WARNING, 0.15, "noted", "see the drive's manual")
DRIVE_DISABLED = Condition("drive left operation", _STOP, 0.01, _QUICK, _RESET)
QUICK_STOPPED = Condition("quick stop active", _STOP, 0.01, _QUICK, _RESET)
REMOTE_LOST = Condition("remote control lost", _STOP, 0.01, _QUICK, _RESET)
STOP_IGNORED = Condition("quick stop ignored", _STOP, 0.4, "heartbeat withheld", _RESET)
INTERNAL_LIMIT = Condition("internal limit active", _LEVEL, 0.05, _LEVELLED, _RESET)
NO_DC_LINK = Condition("no DC link", _STOP, 0.01, _QUICK, _RESET)
STO_OPEN = Condition(
    "safe torque off", _STOP, 0.15, _QUICK, "close STO, then run again with --reset"
)
RESET_REFUSED = Condition("fault reset refused", _STOP, 0.15, "stays off", _RESET)
DRIVE_WARNING = Condition("drive warning", _WARNING, 0.01, "noted", "read the drive's warning")
RELAXED = Condition("safety net relaxed", _WARNING, 0.002, "noted", "take it out of the rig file")
BAD_COMMAND = Condition("bad rate command", _STOP, 0.002, _QUICK, _RESET)


CONDITIONS: tuple[Condition, ...] = tuple(
    value for value in list(globals().values()) if isinstance(value, Condition)
)
"""Every condition the drives and their bus report."""


class DriveError(TwinError, ConnectionError):
    """A drive or its bus cannot be used as requested; one line.

    Args:
        condition: What is wrong.
        where: The device.
        detail: What was seen and what to do, in one line.
    """

    def __init__(self, condition: Condition, where: str, detail: str) -> None:
        self.fault = Fault(condition, where, detail)
        super().__init__(f"{where}: {detail}")


@dataclass
class _LastWarning:
    at: float
    suppressed: int = 0


class FaultReports:
    """Faults on their way to the supervisor: stops and levels are latched until the reset.

    Args:
        repeat: Shortest time in s between two reports of one warning.
    """

    def __init__(self, repeat: float) -> None:
        self._repeat = repeat
        self._new: list[Fault] = []
        self._latched: dict[tuple[str, str], Fault] = {}
        self._warned: dict[tuple[str, str], _LastWarning] = {}
        self.stopped = False
        """Whether something is latched that forbids torque."""

    def report(self, condition: Condition, where: str, detail: str, at: float) -> None:
        """Report a condition seen at a time in s: once until the reset, a warning every while."""
        key = condition.name, where
        if condition.severity is Severity.WARNING:
            last = self._warned.get(key)
            if last is not None and at - last.at < self._repeat:
                last.suppressed += 1
                return
            if last is not None and last.suppressed:
                detail = f"{detail} ({last.suppressed} more before)"
            self._warned[key] = _LastWarning(at)
        elif key in self._latched:
            return
        fault = Fault(condition, where, detail, at)
        if condition.severity is not Severity.WARNING:
            self._latched[key] = fault
            self.stopped = self.stopped or condition.severity is Severity.STOP
        self._new.append(fault)

    def latched(self, condition: Condition, where: str) -> bool:
        """Whether a condition was reported since the last reset; warnings are never latched."""
        return (condition.name, where) in self._latched

    @property
    def standing(self) -> tuple[Fault, ...]:
        """Everything latched, oldest first."""
        return tuple(self._latched.values())

    @property
    def needs_restart(self) -> bool:
        """Whether a reset cannot help."""
        return any(fault.condition.restart for fault in self._latched.values())

    def take(self) -> tuple[Fault, ...]:
        """Faults reported since the last call, oldest first."""
        new, self._new = tuple(self._new), []
        return new

    def reset(self) -> None:
        """Forget what is latched; what persists is reported again."""
        self._latched.clear()
        self._warned.clear()
        self.stopped = False
