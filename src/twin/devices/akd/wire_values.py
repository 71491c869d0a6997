"""Values and frames as they are on the wire: numbers by their type, who sent what, error frames."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from twin.devices.akd import protocol
from twin.devices.akd.protocol import Key, table

if TYPE_CHECKING:
    from twin.devices.akd.trace_files.frames import BusFrame

PROFILE, VENDOR, PRODUCT = (0x1000, 0), (0x1018, 1), (0x1018, 2)
"""Objects by which a node introduces itself."""
BUS_OFF, BUS_ERROR, CONTROLLER = 0x040, 0x080, 0x004
"""Classes of error frames, as SocketCAN has them."""
_ECHO_S = 0.02
"""Time in s within which an adapter hands back a frame that it sent."""
_ECHO_SHARE = 0.5
"""Share of the frames that it sent which an adapter hands back, if it does."""


def decode_value(kind: str, data: bytes) -> int | float | str | bytes:
    """A value by the type of its object.

    Args:
        kind: Type of the object, as `Object` has it.
        data: Its bytes, least first; as many as were sent.

    Returns:
        A number, text, or the bytes themselves where they are neither. Of an unknown type up to
        four bytes are a number without sign, more are text if they are nothing else than ASCII.
    """
    letter, bits = kind[0], int(kind[1:])
    bare = data.rstrip(b"\0")
    if letter == "S":
        text = _text(bare)
        return text if text.isprintable() else data
    if letter in "UI" and not bits and len(data) > 4:
        return bare.decode("ascii") if bare.isascii() and bare.decode().isprintable() else data
    if letter == "B" or not data or len(data) > 8:
        return data
    return decode_number(kind, int.from_bytes(data, "little"), 8 * len(data))


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def decode_number(kind: str, raw: int, sent: int) -> int | float:
    """A number of a type out of the bits that were sent, which may be more or fewer than its own.

    More bits are left out if they only fill it up: with zeros, or with the sign.
    """
    letter, bits = kind[0], int(kind[1:])
    if letter == "F" and bits == sent:
        whole = raw.to_bytes(bits // 8, "little")
        return float(struct.unpack("<f" if bits == 32 else "<d", whole)[0])
    if letter == "I":
        above = raw >> bits
        if bits < sent and above in (0, (1 << sent - bits) - 1):
            raw, sent = raw & (1 << bits) - 1, bits
        if raw >> sent - 1:
            return raw - (1 << sent)
    return raw


def shown_mask(value: int) -> int:
    """As many bits as a number is shown with."""
    return 0xFFFFFFFF if -(1 << 31) <= value < 1 << 32 else (1 << 64) - 1


def find_identities(heard: Iterable[BusFrame]) -> tuple[set[int], dict[tuple[int, Key], int]]:
    """Nodes that say anything of themselves; profiles, vendors, products, by node and object."""
    there, found = set[int](), dict[tuple[int, Key], int]()
    for message in heard:
        service = message.arbitration_id & ~protocol.NODE_MASK
        if service not in (protocol.HEARTBEAT, protocol.SDO_RESPONSE) or message.is_error_frame:
            continue
        node = message.arbitration_id & protocol.NODE_MASK
        there.add(node)
        if service == protocol.SDO_RESPONSE:
            answer = protocol.decode_sdo(bytes(message.data))
            if (
                answer
                and answer.data
                and answer.key in (PROFILE, VENDOR, PRODUCT)
                and not answer.aborted
            ):
                found[node, answer.key] = answer.value
    return there - {0}, found


def list_foreign(heard: Sequence[BusFrame]) -> tuple[list[int], set[int]]:
    """Numbers of frames that were received with an identifier that the host sends.

    First frames of a second sender, then frames that an adapter sent and handed back.
    """
    sent = {(each.arbitration_id, each.is_extended_id) for each in heard if not each.is_rx}
    newest = dict[tuple[int, bytes], float]()
    foreign, echoes = list[int](), set[int]()
    for number, each in enumerate(heard, 1):
        if (each.arbitration_id, each.is_extended_id) not in sent:
            continue
        if each.is_error_frame or each.is_remote_frame:
            continue
        key = each.arbitration_id, bytes(each.data)
        if not each.is_rx:
            newest[key] = each.timestamp
        elif each.timestamp - newest.pop(key, -math.inf) > _ECHO_S:
            foreign.append(number)
        else:
            echoes.add(number)
    handed_back = len(echoes) > _ECHO_SHARE * sum(not each.is_rx for each in heard)
    return (foreign, echoes) if handed_back else (sorted({*foreign, *echoes}), set())


def longest_bits(message: BusFrame) -> int:
    """Bits of a classic frame with the pause after it, stuffed as badly as can be."""
    size = 0 if message.is_remote_frame else 8 * len(message.data)
    fixed, stuffed = (67, 53) if message.is_extended_id else (47, 33)
    return fixed + size + (stuffed + size) // 4


def error_words_of(identifier: int, data: bytes) -> str:
    """An error frame in words; the number of its classes and its bytes if these are not known.

    Classes and bytes are those of SocketCAN.
    """
    known = [words for bit, words in table()["bus_errors"].items() if identifier & int(bit, 16)]
    if identifier & CONTROLLER and len(data) > 1:
        more = table()["controller_errors"].items()
        known += [words for bit, words in more if data[1] & int(bit, 16)]
    rest = f"{identifier:03X}h {data.hex(' ')}".strip() if identifier or data else "of unknown kind"
    return ", ".join(known) or rest


def split_mapping(entry: int) -> tuple[Key, int]:
    """The object that an entry of a mapping names, and its bits."""
    return (entry >> 16, entry >> 8 & 0xFF), entry & 0xFF
