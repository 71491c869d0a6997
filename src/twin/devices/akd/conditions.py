"""Everything that can go wrong with the drives and their bus: the table, and the error.

The table is ``conditions.toml``; each of its rows is a constant here.
"""

from __future__ import annotations

from twin.base.errors import TwinError
from twin.hal.interface import Condition, Fault, conditions

_TABLE = conditions("twin.devices.akd")
CONDITIONS = tuple(_TABLE.values())
"""Every condition the drives and their bus report."""
ADAPTER_GONE = _TABLE["ADAPTER_GONE"]
BUS_OFF = _TABLE["BUS_OFF"]
ERROR_PASSIVE = _TABLE["ERROR_PASSIVE"]
GARBLED = _TABLE["GARBLED"]
BAD_BUS = _TABLE["BAD_BUS"]
BIT_RATE = _TABLE["BIT_RATE"]
NODE_ABSENT = _TABLE["NODE_ABSENT"]
WRONG_IDENTITY = _TABLE["WRONG_IDENTITY"]
WRONG_SETTING = _TABLE["WRONG_SETTING"]
FOREIGN_FRAME = _TABLE["FOREIGN_FRAME"]
SECOND_MASTER = _TABLE["SECOND_MASTER"]
DUPLICATE_ID = _TABLE["DUPLICATE_ID"]
HEARTBEAT_LOST = _TABLE["HEARTBEAT_LOST"]
NMT_LEFT = _TABLE["NMT_LEFT"]
DRIVE_REBOOTED = _TABLE["DRIVE_REBOOTED"]
MONITORING_OFF = _TABLE["MONITORING_OFF"]
SDO_TIMEOUT = _TABLE["SDO_TIMEOUT"]
SDO_ABORT = _TABLE["SDO_ABORT"]
SDO_WRONG = _TABLE["SDO_WRONG"]
EMERGENCY = _TABLE["EMERGENCY"]
EMERGENCY_BURST = _TABLE["EMERGENCY_BURST"]
EMERGENCY_SHORT = _TABLE["EMERGENCY_SHORT"]
PDO_MISSING = _TABLE["PDO_MISSING"]
PDO_STALE = _TABLE["PDO_STALE"]
PDO_SHORT = _TABLE["PDO_SHORT"]
PDO_LATE = _TABLE["PDO_LATE"]
PDO_WRONG_CYCLE = _TABLE["PDO_WRONG_CYCLE"]
PDO_UNSTEADY = _TABLE["PDO_UNSTEADY"]
FROZEN = _TABLE["FROZEN"]
PLATE_FROZEN = _TABLE["PLATE_FROZEN"]
ENCODER_JUMP = _TABLE["ENCODER_JUMP"]
RUNAWAY = _TABLE["RUNAWAY"]
CONTRADICTION = _TABLE["CONTRADICTION"]
MODE_CHANGED = _TABLE["MODE_CHANGED"]
DRIVE_FAULT = _TABLE["DRIVE_FAULT"]
FAULT_NUMBER = _TABLE["FAULT_NUMBER"]
DRIVE_DISABLED = _TABLE["DRIVE_DISABLED"]
QUICK_STOPPED = _TABLE["QUICK_STOPPED"]
REMOTE_LOST = _TABLE["REMOTE_LOST"]
STOP_IGNORED = _TABLE["STOP_IGNORED"]
INTERNAL_LIMIT = _TABLE["INTERNAL_LIMIT"]
NO_DC_LINK = _TABLE["NO_DC_LINK"]
STO_OPEN = _TABLE["STO_OPEN"]
RESET_REFUSED = _TABLE["RESET_REFUSED"]
DRIVE_WARNING = _TABLE["DRIVE_WARNING"]
BAD_COMMAND = _TABLE["BAD_COMMAND"]


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
