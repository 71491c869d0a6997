"""What ends a bring-up or refuses a request: one line, with the fault behind it."""

from __future__ import annotations

from twin.errors import TwinError
from twin.hal.faults import Condition, Fault


class DriveError(TwinError, ConnectionError):
    """A drive or its bus cannot be used as asked.

    Args:
        condition: What is wrong.
        where: The device.
        detail: What was seen and what to do, in one line.
    """

    def __init__(self, condition: Condition, where: str, detail: str) -> None:
        self.fault = Fault(condition, where, detail)
        super().__init__(f"{where}: {detail}")
