"""Reader of captures of SocketCAN by Wireshark and tcpdump (.pcap, .pcapng).

The forms are those of tcpdump.org/linktypes and of the specification of pcapng.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from twin.devices.akd.trace_files.frames import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    LARGEST_STANDARD,
    REMOTE_FLAG,
    Notes,
    TracedFrame,
    classic_frame,
)

_SOCKETCAN, _SLL, _SLL2 = 227, 113, 276
"""Kinds of links: CAN alone, and any device, of which each packet states its protocol."""
_HEADER_BYTES = {_SOCKETCAN: 0, _SLL: 16, _SLL2: 20}
_OUTGOING_PACKET = 4
"""Type of a packet, in captures of any device, that the capturing computer sent."""
_CAN_PROTOCOL = b"\x00\x0c"
"""The protocol of classic frames."""
_FD_BYTES, _FD_FLAG, _XL_FLAG = 72, 0x04, 0x80
"""A packet of CAN FD by its size, or by byte 5; one of CAN XL by byte 4."""
_SECTION, _INTERFACE, _PACKET = b"\x0a\x0d\x0d\x0a", 1, 6
"""Kinds of blocks of a pcapng file: the first as bytes, which are the same in either order."""
_NAME, _RESOLUTION, _OFFSET = 2, 9, 14
"""Options of an interface: its name, the unit of its times, and what they count from."""


class _Packet(NamedTuple):
    """A packet of a capture: time in s, channel, kind of link, byte order of the file, bytes."""

    time: float
    channel: str | None
    link: int
    order: str
    content: bytes


def read_capture(raw: BinaryIO, _: Path, notes: Notes) -> Iterator[TracedFrame | None]:
    """The classic frames of a capture.

    Identifier and flags are big-endian, but in captures of any device they are in the byte order of
    the capturing computer, which is also the byte order of the file.
    """
    magic = raw.read(4)
    packets = _pcapng_packets if magic == _SECTION else _pcap_packets
    for packet in packets(magic, raw, notes):
        size, content = _HEADER_BYTES.get(packet.link), packet.content
        if size is None:
            remark = f"has packets of a kind of link ({packet.link}) that is not CAN"
            if remark not in notes.remarks:
                notes.remarks.append(remark)
            yield None
            continue
        protocol = {_SLL: content[14:16], _SLL2: content[:2]}.get(packet.link, _CAN_PROTOCOL)
        frame = content[size:]
        if (
            protocol != _CAN_PROTOCOL
            or not 8 <= len(frame) < _FD_BYTES
            or frame[4] & _XL_FLAG
            or frame[5] & _FD_FLAG
        ):
            yield None
            continue
        (mark,) = struct.unpack(f"{packet.order if size else '>'}I", frame[:4])
        channel = packet.channel
        if packet.link == _SLL2:
            channel = f"interface {int.from_bytes(content[4:8], 'big')}"
        kind = {_SLL: content[1:2], _SLL2: content[10:11]}.get(packet.link, b"")
        sent = kind == bytes([_OUTGOING_PACKET])
        yield _socketcan_frame(packet.time, mark, frame[4], frame[8:], channel, sent=sent)


def _socketcan_frame(
    time: float, mark: int, length: int, data: bytes, channel: str | None, *, sent: bool
) -> TracedFrame | None:
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
        sent=sent,
        channel=channel,
    )


def _pcap_packets(magic: bytes, raw: BinaryIO, notes: Notes) -> Iterator[_Packet]:
    order = "<" if magic[0] in {0xD4, 0x4D} else ">"
    unit = 1e-9 if b"\x3c" in magic[1:3] else 1e-6
    link = struct.unpack(f"{order}16xI", raw.read(20))[0] & 0xFFFF
    while head := raw.read(16):
        seconds, parts, length = struct.unpack(f"{order}3I", head[:12].ljust(12, b"\0"))
        content = raw.read(length)
        if len(head) < 16 or len(content) < length:
            notes.remarks.append("ends within a packet, which is left out")
            return
        yield _Packet(seconds + unit * parts, None, link, order, content)


class _CaptureInterface(NamedTuple):
    """An interface of a pcapng file: kind of link, unit and beginning of its times in s, name."""

    link: int
    unit: float
    begin: int
    name: str


def _pcapng_packets(block: bytes, raw: BinaryIO, notes: Notes) -> Iterator[_Packet]:
    order, interfaces = "<", list[_CaptureInterface]()
    block += raw.read(8)
    while block:
        if block[:4] == _SECTION:
            order, interfaces = "<" if block[8:12] == b"\x4d\x3c\x2b\x1a" else ">", []
        kind, size = struct.unpack(f"{order}2I", block[:8].ljust(8, b"\0"))
        body = block[8:] + raw.read(max(0, size - 12))
        if size < 12 or len(body) < size - 8:
            notes.remarks.append("ends within a block, which is left out")
            return
        if kind == _INTERFACE:
            interfaces.append(_read_interface(body, order, len(interfaces)))
        elif kind == _PACKET:
            number, high, low, length = struct.unpack(f"{order}4I", body[:16])
            its = interfaces[number]
            time = its.begin + its.unit * (high << 32 | low)
            yield _Packet(time, its.name, its.link, order, body[20 : 20 + length])
        block = raw.read(12)


def _read_interface(body: bytes, order: str, number: int) -> _CaptureInterface:
    link, options, at = struct.unpack(f"{order}H", body[:2])[0], dict[int, bytes](), 8
    while len(body) >= at + 8:
        code, length = struct.unpack(f"{order}HH", body[at : at + 4])
        options[code] = body[at + 4 : at + 4 + length]
        at += 4 + (length + 3) // 4 * 4
    power = options.get(_RESOLUTION, b"\x06")[0]
    unit = 2.0 ** -(power & 0x7F) if power & 0x80 else 10.0**-power
    begin = int.from_bytes(options.get(_OFFSET, b""), "little" if order == "<" else "big")
    name = options.get(_NAME, b"").decode(errors="replace") or f"interface {number}"
    return _CaptureInterface(link, unit, begin, name)
