"""Everything that can go wrong with the drives and their bus: the table, and the error.

The table is ``conditions.toml``; each of its rows is a constant here.
"""

from __future__ import annotations

from twin.base.errors import TwinError
from twin.hal.interface import Condition, Fault, conditions

_TABLE = conditions("twin.devices.akd")
CONDITIONS = tuple(_TABLE.values())
"""Every condition the drives and their bus report."""
globals().update(_TABLE)


def __getattr__(name: str) -> Condition:
    raise AttributeError(name)


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
