"""SDO reads in mid-run that nobody waits for: one question at a time, answered cycles later."""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from twin.devices.akd import frames

_READ = 0x40
_ABORT = 0x80
_EXPEDITED = 0x43
_ANSWER = struct.Struct("<BHBI")


@dataclass(frozen=True)
class Question:
    """An object to be read from a node."""

    node: int
    index: int
    sub: int

    def __str__(self) -> str:
        return f"reading {self.index:04X}h:{self.sub}"


class Reply(NamedTuple):
    """An answer: the value, or the abort code if it was refused."""

    question: Question
    value: int
    aborted: bool


class Enquiry:
    """Questions to the drives, sent one after the other.

    Args:
        patience: Time in s after which a question counts as unanswered.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._waiting: deque[Question] = deque()
        self._open: Question | None = None
        self._sent = 0.0

    @property
    def idle(self) -> bool:
        """Whether nothing is asked or to be asked."""
        return self._open is None and not self._waiting

    def ask(self, question: Question) -> None:
        """Ask when the line is free."""
        self._waiting.append(question)

    def next(self, at: float) -> tuple[int, bytes] | None:
        """The frame to send now, identifier and data, if any."""
        if self._open is not None or not self._waiting:
            return None
        self._open, self._sent = self._waiting.popleft(), at
        asked = self._open
        return frames.REQUEST + asked.node, _ANSWER.pack(_READ, asked.index, asked.sub, 0)

    def take(self, node: int, data: bytes) -> Reply | None:
        """Take in an answer, any bytes; None if it answers nothing that was asked."""
        if self._open is None or len(data) != _ANSWER.size:
            return None
        command, index, sub, value = _ANSWER.unpack(data)
        if Question(node, index, sub) != self._open:
            return None
        question = self._open
        if command == _ABORT:
            self._open = None
            return Reply(question, value, aborted=True)
        if command & ~0x0C != _EXPEDITED:
            return None
        self._open = None
        size = 4 - (command >> 2 & 3)
        return Reply(question, value & ((1 << 8 * size) - 1), aborted=False)

    def overdue(self, at: float) -> Question | None:
        """A question that was not answered in time; it is given up."""
        if self._open is None or at - self._sent <= self._patience:
            return None
        question, self._open = self._open, None
        return question
