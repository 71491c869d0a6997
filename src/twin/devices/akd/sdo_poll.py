"""SDO reads while the cycle runs: nobody waits for the answer, which comes some cycles later."""

from __future__ import annotations

from collections import deque

from twin.devices.akd import conditions as c
from twin.devices.akd import frames
from twin.devices.akd.bringup import monitoring
from twin.devices.akd.conditions import FaultReports
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.dictionary import abort_words

_MONITORING = (0x1016, 1)
_FAULT_NUMBER = (0x2001, 1)
_STO_FAULT = 602
_DOWN = (c.DRIVE_FAULT, c.DRIVE_DISABLED, c.RESET_REFUSED)
"""Conditions after which a drive's fault number is read."""


class SdoPolling:
    """Polls the drives' monitoring of the host, and reads the fault number of one that is down.

    Args:
        config: Axes and thresholds.
        reports: Where faults are reported.
        at: Time now in s.
    """

    def __init__(self, config: AkdConfig, reports: FaultReports, at: float) -> None:
        self._config = config
        self._where = {axis.node: axis.where for axis in config.axes}
        self._reports = reports
        self._queue: deque[tuple[int, int, int]] = deque()
        """Node, index and subindex of what is to be read, one after the other."""
        self._pending: tuple[int, int, int] | None = None
        """What is being read."""
        self._sent = self._polled = at
        self._turn = 0
        self._number_read: set[int] = set()

    def next_frame(self, at: float) -> tuple[int, bytes] | None:
        """The frame to send at a time in s, identifier and data, if any."""
        for node, where in self._where.items():
            down = any(self._reports.latched(each, where) for each in _DOWN)
            if down and node not in self._number_read:
                self._number_read.add(node)
                self._queue.append((node, *_FAULT_NUMBER))
        if self._pending is not None and at - self._sent > self._config.watch.answer:
            node, *key = self._pending
            self._reports.report(c.SDO_TIMEOUT, self._where[node], _reading(*key), at)
            self._pending = None
        idle = self._pending is None and not self._queue
        if idle and at - self._polled > self._config.watch.enquiry:
            self._polled = at
            self._turn = 1 - self._turn
            self._queue.append((self._config.axes[self._turn].node, *_MONITORING))
        if self._pending is not None or not self._queue:
            return None
        self._pending, self._sent = self._queue.popleft(), at
        node, *key = self._pending
        return frames.SDO_REQUEST + node, frames.encode_sdo_read(*key)

    def receive(self, node: int, data: bytes, at: float) -> None:
        """Take in what a drive answers, any bytes; what answers no pending request is left out."""
        answer = frames.decode_sdo(data)
        if answer is None or not answer.data or self._pending != (node, *answer.key):
            return
        self._pending, where = None, self._where[node]
        if answer.aborted:
            detail = f"{_reading(*answer.key)}: {abort_words(answer.value)}"
            self._reports.report(c.SDO_ABORT, where, detail, at)
        elif answer.key == _FAULT_NUMBER:
            self._report_number(answer.value, where, at)
        elif answer.value != monitoring(self._config):
            detail = f"1016h:1 holds {answer.value:08X}h: it would go on without the host"
            self._reports.report(c.MONITORING_OFF, where, detail, at)

    def _report_number(self, number: int, where: str, at: float) -> None:
        if number == _STO_FAULT:
            self._reports.report(c.STO_OPEN, where, "F602", at)
        elif number:
            self._reports.report(c.FAULT_NUMBER, where, frames.fault_words([number]), at)


def _reading(index: int, sub: int) -> str:
    return f"reading {index:04X}h:{sub}"
