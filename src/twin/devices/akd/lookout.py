"""What is asked of the drives in mid-run: their fault numbers, and whether they still watch us."""

from __future__ import annotations

from twin.devices.akd import conditions as c
from twin.devices.akd import frames
from twin.devices.akd.bringup import monitoring
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.enquiry import Enquiry, Question, Reply
from twin.devices.akd.reports import Reports

_MONITORING = (0x1016, 1)
_FAULT_NUMBER = (0x2001, 1)
_STO_FAULT = 602


class Lookout:
    """Asks over SDO, a frame now and then, and reports what the answers mean.

    Args:
        config: Axes and thresholds.
        reports: Where faults go.
        at: Time now in s.
    """

    def __init__(self, config: AkdConfig, reports: Reports, at: float) -> None:
        self._config = config
        self._where = {axis.node: axis.where for axis in config.axes}
        self._reports = reports
        self._enquiry = Enquiry(config.watch.answer)
        self._enquired = at
        self._turn = 0
        self._asked: set[int] = set()

    def next(self, at: float) -> tuple[int, bytes] | None:
        """The frame to send now, identifier and data, if any."""
        for node, where in self._where.items():
            down = any(self._reports.latched(each, where) for each in _DOWN)
            if down and node not in self._asked:
                self._asked.add(node)
                self._enquiry.ask(Question(node, *_FAULT_NUMBER))
        overdue = self._enquiry.overdue(at)
        if overdue is not None:
            self._reports.report(c.SDO_TIMEOUT, self._where[overdue.node], str(overdue), at)
        if self._enquiry.idle and at - self._enquired > self._config.watch.enquiry:
            self._enquired = at
            self._turn = 1 - self._turn
            self._enquiry.ask(Question(self._config.axes[self._turn].node, *_MONITORING))
        return self._enquiry.next(at)

    def take(self, node: int, data: bytes, at: float) -> None:
        """Take in an SDO answer of a drive, any bytes."""
        reply = self._enquiry.take(node, data)
        if reply is None:
            return
        where = self._where[node]
        if reply.aborted:
            detail = f"{reply.question}: code {reply.value:08X}h"
            self._reports.report(c.SDO_ABORT, where, detail, at)
        elif (reply.question.index, reply.question.sub) == _FAULT_NUMBER:
            self._number(reply, where, at)
        elif reply.value != monitoring(self._config):
            detail = f"1016h:1 holds {reply.value:08X}h: it would go on without the host"
            self._reports.report(c.MONITORING_OFF, where, detail, at)

    def forget(self) -> None:
        """Ask for fault numbers anew, after a reset."""
        self._asked.clear()

    def _number(self, reply: Reply, where: str, at: float) -> None:
        if reply.value == _STO_FAULT:
            self._reports.report(c.STO_OPEN, where, "F602", at)
        elif reply.value:
            name = frames.FAULTS.get(reply.value, "")
            self._reports.report(c.FAULT_NUMBER, where, f"F{reply.value} {name}".strip(), at)


_DOWN = (c.DRIVE_FAULT, c.DRIVE_DISABLED, c.RESET_REFUSED)
