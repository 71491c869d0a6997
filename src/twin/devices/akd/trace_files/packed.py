"""Readers of traces in packed bytes: captures here, what python-can reads by python-can."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import can

from twin.devices.akd.trace_files.frames import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    LARGEST_STANDARD,
    REMOTE_FLAG,
    Notes,
    classic_frame,
)

_SOCKETCAN, _COOKED, _CAN_PROTOCOL = 227, 113, 0x000C
"""Kinds of links: CAN alone, and any device, where a number says that it is CAN."""


def read_capture(raw: BinaryIO, _: Path, notes: Notes) -> Iterator[can.Message | None]:
    """What Wireshark and tcpdump keep of SocketCAN (.pcap, .pcapng)."""
    for time, link, packet in _packets(raw):
        at = 16 if link == _COOKED else 0
        is_can = link == _SOCKETCAN or (
            link == _COOKED and struct.unpack(">H", packet[14:16])[0] == _CAN_PROTOCOL
        )
        if not is_can or len(packet) < at + 8:
            if not is_can and not notes.remarks:
                notes.remarks.append(f"has packets of another kind of link ({link}) than CAN")
            yield None
            continue
        mark, length = struct.unpack(">IB", packet[at : at + 5])
        if len(packet) > at + 16 and length > 8:
            yield None  # a frame of CAN FD
            continue
        remote, error = bool(mark & REMOTE_FLAG), bool(mark & ERROR_FLAG)
        if not remote and len(packet) < at + 8 + length:
            yield None  # cut off
            continue
        extended = bool(mark & EXTENDED_FLAG)
        yield classic_frame(
            time,
            mark & (ERROR_FLAG - 1) if extended or error else mark & LARGEST_STANDARD,
            b"" if remote else packet[at + 8 : at + 8 + length],
            extended=extended,
            remote=length if remote else None,
            error=error,
        )


def _packets(raw: BinaryIO) -> Iterator[tuple[float, int, bytes]]:
    """Time in s, kind of link and bytes of each packet of a capture."""
    magic = raw.read(4)
    if magic != b"\x0a\x0d\x0d\x0a":
        order = "<" if magic[0] in {0xD4, 0x4D} else ">"
        unit = 1e-9 if b"\x3c" in magic[1:3] else 1e-6
        link = struct.unpack(f"{order}16xI", raw.read(20))[0] & 0xFFFF
        while len(head := raw.read(16)) == 16:
            seconds, parts, length, _ = struct.unpack(f"{order}4I", head)
            yield seconds + unit * parts, link, raw.read(length)
        return
    order, links, block = "<", list[tuple[int, float]](), magic + raw.read(8)
    while len(block) == 12:
        kind = struct.unpack(f"{order}I", block[:4])[0]
        if block[:4] == b"\x0a\x0d\x0d\x0a":
            order, links = "<" if block[8:12] == b"\x4d\x3c\x2b\x1a" else ">", []
        size = struct.unpack(f"{order}I", block[4:8])[0]
        body = block[8:] + raw.read(size - 12)
        if kind == 1:
            links.append((struct.unpack(f"{order}H", body[:2])[0], _resolution(body[8:-4], order)))
        elif kind == 6:
            number, high, low, length, _ = struct.unpack(f"{order}5I", body[:20])
            link, unit = links[number]
            yield unit * (high << 32 | low), link, body[20 : 20 + length]
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


def read_blf(raw: BinaryIO, file: Path, notes: Notes) -> Iterator[can.Message]:
    """What Vector's tools pack (.blf)."""
    number = 0
    with can.BLFReader(raw) as reader:
        for number, message in enumerate(reader, 1):  # noqa: B007
            yield message
        if file.suffix.lower() != ".gz" and reader.file_size > file.stat().st_size:
            notes.remarks.append(f"cut off, ends after frame {number}")  # as its head says


def read_database(_: BinaryIO, file: Path, notes: Notes) -> Iterator[can.Message]:
    """What python-can keeps in a database (.db)."""
    notes.remarks.append(
        "python-can's writer of .db drops the frames that wait when it is stopped: the end of what "
        "was heard may be missing"
    )
    with can.SqliteReader(file) as reader:
        yield from reader


def read_mf4(_: BinaryIO, file: Path, __: Notes) -> Iterator[can.Message]:
    """Measurement files (.mf4), where asammdf is installed."""
    with can.MF4Reader(file) as reader:
        yield from reader
