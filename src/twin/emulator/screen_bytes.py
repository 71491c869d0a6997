"""What a Lumio screen sends for the contacts of one frame, in each of its protocols.

Written from the layouts alone, sharing no code with the decoders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import NamedTuple


class Protocol(StrEnum):
    """What the screen speaks."""

    MICROTOUCH = "microtouch"
    ELO = "elo"
    HID_0006 = "hid-0006"
    HID_0007 = "hid-0007"


class Spot(NamedTuple):
    """A contact on the screen.

    Attributes:
        x: Along the screen's first axis, 0..1.
        y: Along its second axis, downwards, 0..1.
        id: Its number, from 1.
        down: Whether it touches; False in the frame of its lift-off.
    """

    x: float
    y: float
    id: int = 1
    down: bool = True


def microtouch(spots: Sequence[Spot]) -> list[bytes]:
    """Format Tablet of the first contact: 14 bit in two sevens, y counting upwards."""
    if not spots:
        return []
    x, y = _counts(spots[0].x, 16383), 16383 - _counts(spots[0].y, 16383)
    head = 0b1100_0000 if spots[0].down else 0b1000_0000
    return [bytes([head, x % 128, x // 128, y % 128, y // 128])]


def elo(spots: Sequence[Spot]) -> list[bytes]:
    """SmartSet of the first contact, as in a stream of touches."""
    if not spots:
        return []
    status = 2 if spots[0].down else 4
    x, y = _counts(spots[0].x, 4095), _counts(spots[0].y, 4095)
    body = bytes([0x55, 0x54, status, x % 256, x // 256, y % 256, y // 256, 0, 0])
    return [body + bytes([(sum(body) + 0xAA) % 256])]


def hid_0006(spots: Sequence[Spot]) -> list[bytes]:
    """Reports of four contacts each, the first telling how many there are."""
    reports = []
    for begin in range(0, len(spots), 4):
        blocks = b"".join(_status(s) + bytes([s.id]) + _pair(s) for s in spots[begin : begin + 4])
        number = len(spots) if begin == 0 else 0
        reports.append(blocks.ljust(24, b"\0") + bytes([number]))
    return reports


def hid_0007(spots: Sequence[Spot]) -> list[bytes]:
    """One report per contact."""
    return [_status(s) + b"\0" + _pair(s) + bytes([s.id, 0]) for s in spots]


ENCODERS: dict[Protocol, Callable[[Sequence[Spot]], list[bytes]]] = {
    Protocol.MICROTOUCH: microtouch,
    Protocol.ELO: elo,
    Protocol.HID_0006: hid_0006,
    Protocol.HID_0007: hid_0007,
}
"""The packets of a frame, by protocol."""


def beyond(packet: bytes, protocol: Protocol) -> bytes:
    """The packet with its first coordinate beyond the range; Format Tablet's names the far corner.

    It cannot say more.
    """
    changed = bytearray(packet)
    if protocol is Protocol.ELO:
        changed[3:5] = b"\xff\x7f"
        changed[9] = (sum(changed[:9]) + 0xAA) % 256
    elif protocol is Protocol.MICROTOUCH:
        changed[1:] = b"\x7f\x7f\x7f\x7f"
    else:
        changed[2:4] = b"\xf8\xff"
    return bytes(changed)


def _counts(share: float, top: int) -> int:
    """Whole counts of a range 0..top on the native grid of 4096 x 4096."""
    cell = min(4095, max(0, round(share * 4095)))
    return round(cell * top / 4095)


def _status(spot: Spot) -> bytes:
    return b"\x31" if spot.down else b"\x30"


def _pair(spot: Spot) -> bytes:
    # On USB the native grid appears as multiples of 8, up to 32760 of 32767.
    return b"".join((_counts(v, 4095) * 8).to_bytes(2, "little") for v in (spot.x, spot.y))
