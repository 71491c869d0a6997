"""Readers of traces in packed bytes: captures here, what python-can reads by python-can."""

from __future__ import annotations

import gzip
import shutil
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from twin.devices.akd.trace_files.frames import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    LARGEST_STANDARD,
    REMOTE_FLAG,
    Notes,
    TracedFrame,
    classic_frame,
)

if TYPE_CHECKING:
    import can

_SOCKETCAN = 227
"""Kind of link that has frames of CAN alone."""
_COOKED = {113: (16, 14), 276: (20, 0)}
"""Kinds of links of any device (SLL, SLL2): bytes of their header, and the protocol's place."""
_CAN_PROTOCOL = 0x000C
"""That of classic frames."""
_FD_SIZE, _FD_FLAG, _XL_FLAG = 72, 0x04, 0x80
"""A packet of CAN FD by its size, or by byte 5; one of CAN XL by byte 4."""


class _Packet(NamedTuple):
    """A packet of a capture: time in s, kind of link, byte order of the file, bytes."""

    time: float
    link: int
    order: str
    content: bytes


def read_capture(raw: BinaryIO, _: Path, notes: Notes) -> Iterator[TracedFrame | None]:
    """What Wireshark and tcpdump keep of SocketCAN (.pcap, .pcapng).

    Identifier and flags are big-endian, but in captures of any device they are in the byte order of
    the computer that captured, which is that of the file (tcpdump.org, LINKTYPE_LINUX_SLL).
    """
    for packet in _packets(raw):
        at, place = _COOKED.get(packet.link, (0, 0))
        frame = packet.content[at:]
        protocol = packet.content[place : place + 2] if at else b""
        if packet.link != _SOCKETCAN and not at and not notes.remarks:
            notes.remarks.append(f"has packets of a kind of link ({packet.link}) that is not CAN")
        if (
            (packet.link != _SOCKETCAN and not at)
            or (at and protocol != _CAN_PROTOCOL.to_bytes(2, "big"))
            or len(frame) < 8
            or len(frame) == _FD_SIZE
            or frame[4] & _XL_FLAG
            or frame[5] & _FD_FLAG
        ):
            yield None
        else:
            (mark,) = struct.unpack(f"{packet.order if at else '>'}I", frame[:4])
            yield _socketcan_frame(packet.time, mark, frame[4], frame[8:])


def _socketcan_frame(time: float, mark: int, length: int, data: bytes) -> TracedFrame | None:
    """A frame by its identifier with flags; None if it has not so many bytes of data."""
    remote, error = bool(mark & REMOTE_FLAG), bool(mark & ERROR_FLAG)
    if not remote and len(data) < length:
        return None
    extended = bool(mark & EXTENDED_FLAG)
    return classic_frame(
        time,
        mark & (ERROR_FLAG - 1) if extended or error else mark & LARGEST_STANDARD,
        b"" if remote else data[:length],
        extended=extended,
        remote=length if remote else None,
        error=error,
    )


def _packets(raw: BinaryIO) -> Iterator[_Packet]:
    """The packets of a capture of either form."""
    magic = raw.read(4)
    return _pcapng_packets(magic, raw) if magic == _SECTION else _pcap_packets(magic, raw)


def _pcap_packets(magic: bytes, raw: BinaryIO) -> Iterator[_Packet]:
    order = "<" if magic[0] in {0xD4, 0x4D} else ">"
    unit = 1e-9 if b"\x3c" in magic[1:3] else 1e-6
    link = struct.unpack(f"{order}16xI", raw.read(20))[0] & 0xFFFF
    while len(head := raw.read(16)) == 16:
        seconds, parts, length, _ = struct.unpack(f"{order}4I", head)
        yield _Packet(seconds + unit * parts, link, order, raw.read(length))


_SECTION, _INTERFACE_BLOCK, _PACKET_BLOCK = b"\x0a\x0d\x0d\x0a", 1, 6
"""Kinds of blocks of a pcapng file: the first as bytes, which are the same in either order."""


def _pcapng_packets(block: bytes, raw: BinaryIO) -> Iterator[_Packet]:
    order, links = "<", list[tuple[int, float]]()
    block += raw.read(8)
    while len(block) == 12:
        if block[:4] == _SECTION:
            order, links = "<" if block[8:12] == b"\x4d\x3c\x2b\x1a" else ">", []
        kind, size = struct.unpack(f"{order}2I", block[:8])
        body = block[8:] + raw.read(size - 12)
        if len(body) < size - 8:
            return  # cut off
        if kind == _INTERFACE_BLOCK:
            link = struct.unpack(f"{order}H", body[:2])[0]
            links.append((link, _resolution(body[8:-4], order)))
        elif kind == _PACKET_BLOCK:
            number, high, low, length, _ = struct.unpack(f"{order}5I", body[:20])
            link, unit = links[number]
            yield _Packet(unit * (high << 32 | low), link, order, body[20 : 20 + length])
        block = raw.read(12)


def _resolution(options: bytes, order: str) -> float:
    """Unit of time in s, by option 9 of an interface; microseconds without it."""
    at = 0
    while len(options) >= at + 5:
        code, length = struct.unpack(f"{order}HH", options[at : at + 4])
        if code == 9:
            power = options[at + 4]
            return float(2.0 ** -(power & 0x7F) if power & 0x80 else 10.0**-power)
        at += 4 + (length + 3) // 4 * 4
    return 1e-6


def read_blf(raw: BinaryIO, file: Path, notes: Notes) -> Iterator[TracedFrame | None]:
    """What Vector's tools pack (.blf)."""
    import can  # noqa: PLC0415  takes 0.2 s

    number = 0
    with can.BLFReader(raw) as reader:
        for number, message in enumerate(reader, 1):  # noqa: B007
            yield _of_message(message)
        if file.suffix.lower() != ".gz" and reader.file_size > file.stat().st_size:
            notes.remarks.append(f"cut off, ends after frame {number}")  # as its head says


def read_database(raw: BinaryIO, file: Path, notes: Notes) -> Iterator[TracedFrame | None]:
    """What python-can keeps in a database (.db)."""
    import can  # noqa: PLC0415  takes 0.2 s

    notes.remarks.append(
        "python-can's writer of .db drops the frames that wait when it is stopped: the last frames "
        "of the bus may be missing"
    )
    with _unpacked(raw, file) as plain, can.SqliteReader(plain) as reader:
        yield from map(_of_message, reader)


def read_mf4(raw: BinaryIO, file: Path, _: Notes) -> Iterator[TracedFrame | None]:
    """Measurement files (.mf4), where asammdf is installed."""
    import can  # noqa: PLC0415  takes 0.2 s

    with _unpacked(raw, file) as plain, can.MF4Reader(plain) as reader:
        yield from map(_of_message, reader)


def _of_message(message: can.Message) -> TracedFrame | None:
    """The classic frame that python-can read; None for one of CAN FD."""
    if message.is_fd or len(message.data) > message.dlc:
        return None
    return classic_frame(
        message.timestamp,
        message.arbitration_id,
        bytes(message.data),
        extended=message.is_extended_id,
        remote=message.dlc if message.is_remote_frame else None,
        error=message.is_error_frame,
        sent=not message.is_rx,
        channel=None if message.channel is None else str(message.channel),
    )


@contextmanager
def _unpacked(raw: BinaryIO, file: Path) -> Iterator[Path]:
    """A file for readers that open it themselves; of one packed by gzip, a copy of its content."""
    if not isinstance(raw, gzip.GzipFile):
        yield file
        return
    with TemporaryDirectory() as folder:
        plain = Path(folder) / file.stem
        with plain.open("wb") as copy:
            shutil.copyfileobj(raw, copy)
        yield plain
