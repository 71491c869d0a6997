"""Observations in a trace, as data: the decoder collects them, and findings are made of them.

Times are in s since the first frame. Frames are numbered from 1, in the order of their times.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

from twin.devices.akd.protocol import Key

BUS = 0
"""Number that stands for no node: the bus, or all nodes."""


class StreamKey(NamedTuple):
    """A stream of repeated frames: its node, ``BUS`` for SYNC, and its name."""

    node: int
    name: str


class Stream(NamedTuple):
    """The frames of one kind: time in s and number of each, shape (K,) both."""

    time: array[float]
    frame: array[int]

    def append(self, time: float, frame: int) -> None:
        """Add a frame."""
        self.time.append(time)
        self.frame.append(frame)


def empty_stream() -> Stream:
    """A stream without frames."""
    return Stream(array("d"), array("L"))


class Gap(NamedTuple):
    """Where a regular stream paused: time of the frames around in s, and the number of the first.

    ``end`` is None where the stream ended before the trace did.
    """

    begin: float
    end: float | None
    frame: int


class Rhythm(NamedTuple):
    """The rhythm of a regular stream: its usual and its worst pause in s, and its gaps."""

    usual: float
    worst: float
    gaps: list[Gap]

    def long(self, pauses: float) -> list[Gap]:
        """Its gaps of more than so many usual pauses, and its end if it ends before the trace."""
        limit = pauses * self.usual
        return [each for each in self.gaps if each.end is None or each.end - each.begin > limit]

    def summary(self) -> dict[str, float]:
        """Usual and worst pause, the number of gaps that ended, and the longest of these (s)."""
        lengths = [gap.end - gap.begin for gap in self.gaps if gap.end is not None]
        longest = max(lengths, default=0.0)
        return {
            "usual": self.usual,
            "worst": self.worst,
            "gaps": len(lengths),
            "longest": longest,
        }


class Change(NamedTuple):
    """A value of an object that differs from the one before."""

    time: float
    frame: int
    value: int


class Command(NamedTuple):
    """An NMT command to a node, or to all (``BUS``)."""

    time: float
    frame: int
    command: int
    node: int


class EmergencyReport(NamedTuple):
    """An emergency message: its code, None if it is too short for one, and its words."""

    time: float
    frame: int
    node: int
    code: int | None
    words: str


class ErrorFrame(NamedTuple):
    """An error frame: its classes as SocketCAN has them, and its words."""

    time: float
    frame: int
    classes: int
    words: str


class Transfer(NamedTuple):
    """An SDO transfer.

    Attributes:
        begin: Time of the request, s.
        end: Time of the last frame of the answer, s; None without an answer.
        frames: Numbers of the request and of the last frame of the answer.
        node: The server.
        key: The object.
        writes: Whether it is written.
        abort: The abort code; None if it was not refused or given up.
        value: The number that was transferred; None if it is no number.
        overlapped: Whether the answer came after the next request to the node.
        unfinished: Whether it was answered, and the host did not ask for the rest.
        given_up: Whether the abort is the host's.
    """

    begin: float
    end: float | None
    frames: tuple[int, ...]
    node: int
    key: Key
    writes: bool
    abort: int | None
    value: int | None
    overlapped: bool = False
    unfinished: bool = False
    given_up: bool = False

    @property
    def good(self) -> bool:
        """Whether it was answered and not refused."""
        return self.end is not None and self.abort is None


class StrayAnswer(NamedTuple):
    """An SDO answer to no request of the trace."""

    time: float
    frame: int
    node: int
    key: Key


@dataclass
class Observed:
    """Observations in the frames of a trace, as data.

    Attributes:
        times: Times of all frames, s.
        bits: Bits of each of them, at most.
        guards: Remote requests for the life of a node (node guarding), by its number.
        life: What a node sends with the identifier of heartbeats, by its number.
        foreign: Numbers of frames that somebody else sent with an identifier of the host, where
            the trace has who sent a frame.
        streams: When SYNC, heartbeats and PDOs came.
        misfits: PDOs with a length other than the length of their mapping.
        rhythms: Those of them that came regularly.
        sent_by: All frames of a node, by its number.
        changes: Values of the objects of which every change is reported, by node and object.
        network: Network states in heartbeats, by node, where they changed, and each boot-up (0).
        commands: NMT commands.
        transfers: SDO transfers, in the order of their ends.
        strays: SDO answers to no request.
        short_transfers: SDO frames that have not the 8 bytes of CiA 301, by node.
        emergencies: Emergency messages.
        error_frames: Error frames.
    """

    times: array[float] = field(default_factory=lambda: array("d"))
    bits: array[int] = field(default_factory=lambda: array("L"))
    guards: defaultdict[int, Stream] = field(default_factory=lambda: defaultdict(empty_stream))
    life: defaultdict[int, list[Change]] = field(default_factory=lambda: defaultdict(list))
    foreign: list[int] = field(default_factory=list)
    streams: defaultdict[StreamKey, Stream] = field(
        default_factory=lambda: defaultdict(empty_stream)
    )
    misfits: defaultdict[StreamKey, Stream] = field(
        default_factory=lambda: defaultdict(empty_stream)
    )
    rhythms: dict[StreamKey, Rhythm] = field(default_factory=dict)
    sent_by: defaultdict[int, Stream] = field(default_factory=lambda: defaultdict(empty_stream))
    changes: defaultdict[tuple[int, Key], list[Change]] = field(
        default_factory=lambda: defaultdict(list)
    )
    network: defaultdict[int, list[Change]] = field(default_factory=lambda: defaultdict(list))
    commands: list[Command] = field(default_factory=list)
    transfers: list[Transfer] = field(default_factory=list)
    strays: list[StrayAnswer] = field(default_factory=list)
    short_transfers: defaultdict[int, Stream] = field(
        default_factory=lambda: defaultdict(empty_stream)
    )
    emergencies: list[EmergencyReport] = field(default_factory=list)
    error_frames: list[ErrorFrame] = field(default_factory=list)
