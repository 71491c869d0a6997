"""SDO reads while the cycle runs: nobody waits for the answer, which comes some cycles later."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from twin.devices.akd import conditions as c
from twin.devices.akd import frames
from twin.devices.akd.bringup import monitoring
from twin.devices.akd.conditions import FaultReports
from twin.devices.akd.config import AkdConfig

_MONITORING = (0x1016, 1)
_FAULT_NUMBER = (0x2001, 1)
_STO_FAULT = 602
_DOWN = (c.DRIVE_FAULT, c.DRIVE_DISABLED, c.RESET_REFUSED)
"""Conditions after which a drive's fault number is read."""


@dataclass(frozen=True)
class SdoRequest:
    """An object to be read from a node."""

    node: int
    index: int
    sub: int

    def __str__(self) -> str:
        return f"reading {self.index:04X}h:{self.sub}"


class SdoResponse(NamedTuple):
    """The answer to a request: the value, or the abort code if it was refused."""

    request: SdoRequest
    value: int
    aborted: bool


class SdoReader:
    """A queue of read requests, one of them on the wire at a time.

    Args:
        timeout: Time in s after which a request counts as unanswered.
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._queue: deque[SdoRequest] = deque()
        self._pending: SdoRequest | None = None
        self._sent = 0.0

    @property
    def idle(self) -> bool:
        """Whether no request is pending or queued."""
        return self._pending is None and not self._queue

    def request(self, request: SdoRequest) -> None:
        """Queue a request."""
        self._queue.append(request)

    def next_frame(self, at: float) -> tuple[int, bytes] | None:
        """The frame to send at a time in s, identifier and data, if any."""
        if self._pending is not None or not self._queue:
            return None
        self._pending, self._sent = self._queue.popleft(), at
        pending = self._pending
        data = frames.encode_sdo_read(pending.index, pending.sub)
        return frames.SDO_REQUEST + pending.node, data

    def receive(self, node: int, data: bytes) -> SdoResponse | None:
        """Take in an answer, any bytes; None if it does not answer the pending request."""
        answer = frames.decode_sdo(data)
        if self._pending is None or answer is None or not answer.data:
            return None
        if SdoRequest(node, *answer.key) != self._pending:
            return None
        pending, self._pending = self._pending, None
        return SdoResponse(pending, answer.value, answer.aborted)

    def expired(self, at: float) -> SdoRequest | None:
        """The pending request if it was not answered in time; it is given up."""
        if self._pending is None or at - self._sent <= self._timeout:
            return None
        pending, self._pending = self._pending, None
        return pending


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
        self._reader = SdoReader(config.watch.answer)
        self._polled = at
        self._turn = 0
        self._number_read: set[int] = set()

    def next_frame(self, at: float) -> tuple[int, bytes] | None:
        """The frame to send at a time in s, identifier and data, if any."""
        for node, where in self._where.items():
            down = any(self._reports.latched(each, where) for each in _DOWN)
            if down and node not in self._number_read:
                self._number_read.add(node)
                self._reader.request(SdoRequest(node, *_FAULT_NUMBER))
        expired = self._reader.expired(at)
        if expired is not None:
            self._reports.report(c.SDO_TIMEOUT, self._where[expired.node], str(expired), at)
        if self._reader.idle and at - self._polled > self._config.watch.enquiry:
            self._polled = at
            self._turn = 1 - self._turn
            self._reader.request(SdoRequest(self._config.axes[self._turn].node, *_MONITORING))
        return self._reader.next_frame(at)

    def receive(self, node: int, data: bytes, at: float) -> None:
        """Take in an SDO answer of a drive, any bytes."""
        response = self._reader.receive(node, data)
        if response is None:
            return
        request, where = response.request, self._where[node]
        if response.aborted:
            detail = f"{request}: code {response.value:08X}h"
            self._reports.report(c.SDO_ABORT, where, detail, at)
        elif (request.index, request.sub) == _FAULT_NUMBER:
            self._report_number(response.value, where, at)
        elif response.value != monitoring(self._config):
            detail = f"1016h:1 holds {response.value:08X}h: it would go on without the host"
            self._reports.report(c.MONITORING_OFF, where, detail, at)

    def reset(self) -> None:
        """Read fault numbers again, after a reset."""
        self._number_read.clear()

    def _report_number(self, number: int, where: str, at: float) -> None:
        if number == _STO_FAULT:
            self._reports.report(c.STO_OPEN, where, "F602", at)
        elif number:
            self._reports.report(c.FAULT_NUMBER, where, frames.fault_words([number]), at)
