"""SDO transfers under way, as CiA 301 has them: in one frame, in segments, in blocks."""

from __future__ import annotations

from dataclasses import dataclass, field

from twin.devices.akd.protocol import Key

SEGMENT, DOWNLOAD, UPLOAD, ABORT, BLOCK_UPLOAD, BLOCK_DOWNLOAD = 0, 1, 2, 4, 5, 6
DOWNLOAD_ANSWER = 3
"""Command specifiers of SDO: reading is an upload, writing a download."""
_SIZED, _EXPEDITED = 1, 2
"""Bits of the specifier that begins a transfer: its size is stated; all data are in this frame."""
_BLOCK_STEPS = {BLOCK_UPLOAD: 3, BLOCK_DOWNLOAD: 1}
"""Bits of the first byte of a client's frame that are 0 where it begins a block transfer."""
_BLOCK_END, _BLOCK_ACKNOWLEDGED, _LAST_SEGMENT = 1, 2, 0x80
"""Steps of a block transfer, in bits 0 and 1 of the first byte; the bit of the last segment."""
_ABORT_BYTE = 0x80
"""First byte of an abort; no segment of a block begins so."""
FIRST_BYTES = {0x20, 0x21, 0x22, 0x23, 0x27, 0x2B, 0x2F, 0x40}
"""First bytes of requests to write or read an object, without those of blocks."""


def begins_block(data: bytes) -> bool:
    """Whether a client's frame begins a block transfer."""
    steps = _BLOCK_STEPS.get(data[0] >> 5)
    return steps is not None and not data[0] & steps


def begins_transfer(data: bytes) -> bool:
    """Whether a client's frame has the form of one that begins a transfer of any kind."""
    reads = data[0] >> 5 == UPLOAD
    return begins_block(data) or (data[0] in FIRST_BYTES and not (reads and any(data[4:])))


@dataclass
class OpenTransfer:
    """A transfer under way.

    Attributes:
        since: When it was requested, s.
        frame: Number of the request.
        key: Its object.
        writes: Whether the client has the data.
        block: Whether it goes in blocks.
        data: What has come.
        more: Whether data are still to come.
        answered: Whether the server has answered.
        segments: Segments of a block that are not yet acknowledged.
        last: Whether the newest of them is the last of all.
        whole: Whether that is acknowledged.
        missed: Whether the trace lacks some.
    """

    since: float
    frame: int
    key: Key
    writes: bool
    block: bool
    data: bytes = b""
    more: bool = True
    answered: bool = False
    segments: list[bytes] = field(default_factory=list)
    last: bool = False
    whole: bool = False
    missed: bool = False

    def take(self, data: bytes, size: int, *, asks: bool) -> None:
        """Take in a frame of a transfer that does not go in blocks.

        Args:
            data: Its bytes.
            size: Bytes of the object, where the frame does not state them.
            asks: Whether it is the client's.
        """
        command = data[0] >> 5
        if command == SEGMENT:
            self.data += data[1 : 8 - (data[0] >> 1 & 7)]
            self.more = not data[0] & 1
        elif command == (DOWNLOAD if asks else UPLOAD) and data[0] & _EXPEDITED:
            sized = data[0] & _SIZED
            self.data = data[4 : 8 - (data[0] >> 2 & 3)] if sized else data[4:][:size]
            self.more = False

    def take_block(self, data: bytes, *, asks: bool) -> bool:
        """Take in a frame of a block transfer that was answered; False if it is none of it.

        The side that has the data numbers its segments from 1 in the first byte. The other
        acknowledges so many of them (byte 1), which then begin anew at 1. After the last the first
        side states how many bytes of it are no data (bits 2 to 4), and the other confirms.

        Args:
            data: Its bytes.
            asks: Whether it is the client's.
        """
        if not (self.block and self.answered) or data[0] == _ABORT_BYTE:
            return False
        if asks is self.writes and self.whole:
            if data[0] >> 5 != BLOCK_DOWNLOAD or data[0] & 3 != _BLOCK_END:
                return False
            self.data = self.data[: len(self.data) - (data[0] >> 2 & 7)]
        elif asks is self.writes:
            if data[0] & ~_LAST_SEGMENT == len(self.segments) + 1:
                self.segments.append(data[1:])
                self.last = bool(data[0] & _LAST_SEGMENT)
            elif asks and begins_transfer(data):
                return False
        elif data[0] >> 5 != BLOCK_UPLOAD:
            return False
        elif data[0] & 3 == _BLOCK_ACKNOWLEDGED:
            self.missed |= data[1] > len(self.segments)
            self.whole = self.last and data[1] == len(self.segments)
            self.data += b"".join(self.segments[: data[1]])
            self.segments.clear()
        elif data[0] & 3 == _BLOCK_END:
            self.more = False
        return True
