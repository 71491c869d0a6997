"""The object dictionary: the objects of a drive that the host knows, from ``objects.toml``."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

PDO_INVALID = 1 << 31
"""Bit of a PDO's COB-ID that switches it off."""
PDO_ENTRIES = 8


@dataclass(frozen=True)
class Object:
    """One object of a drive; type is U or I and the bits, access ro or rw."""

    index: int
    sub: int
    name: str
    type: str
    access: str
    default: int

    @property
    def bits(self) -> int:
        """Its length."""
        return int(self.type[1:])

    def encode(self, value: int) -> bytes:
        """The bytes of a value.

        Raises:
            OverflowError: If it is out of range.
        """
        return value.to_bytes(self.bits // 8, "little", signed=self.type[0] == "I")

    def decode(self, data: bytes) -> int:
        """The value of its bytes."""
        return int.from_bytes(data, "little", signed=self.type[0] == "I")


def objects(node: int) -> Iterator[Object]:
    """The built-in objects of a drive with this node, PDO parameters with their defaults."""
    for each in table()["objects"]:
        yield Object(*each)
    for number in range(4):
        receive, transmit = 0x200 + 0x100 * number + node, 0x180 + 0x100 * number + node
        yield from _parameters(0x1400 + number, "RPDO", receive)
        yield from _mapping(0x1600 + number, "RPDO")
        yield from _parameters(0x1800 + number, "TPDO", transmit)
        yield from _mapping(0x1A00 + number, "TPDO")


@cache
def table() -> dict[str, Any]:
    """The tables of ``objects.toml`` by their names."""
    text = (resources.files("twin.devices.akd") / "objects.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def kept(index: int, written: int, read: int) -> bool:
    """Whether what is read of an object is what was written, as far as the drive can keep it."""
    key = f"0x{index:04X}"
    share = table()["tolerances"].get(key, 0.0)
    ignored = table()["ignored_bits"].get(key, 0)
    same = (written ^ read) & ~ignored == 0
    return bool(same or abs(read - written) <= share * abs(written))


def abort_words(code: int) -> str:
    """Why a drive refuses, in words, with the abort code."""
    known = table()["aborts"].get(f"0x{code:08X}", "a reason of the vendor's own")
    return f"code {code:08X}h, {known}"


def _parameters(index: int, kind: str, cob_id: int) -> Iterator[Object]:
    name = f"{kind}{index % 4 + 1} parameter"
    yield Object(index, 0, name, "U8", "ro", 5)
    yield Object(index, 1, f"{name} COB-ID", "U32", "rw", cob_id)
    yield Object(index, 2, f"{name} type", "U8", "rw", 255)
    yield Object(index, 3, f"{name} inhibit time", "U16", "rw", 20 if kind == "TPDO" else 0)
    yield Object(index, 5, f"{name} event timer", "U16", "rw", 0)


def _mapping(index: int, kind: str) -> Iterator[Object]:
    name = f"{kind}{index % 4 + 1} mapping"
    entries = table()["default_maps"][f"0x{index:04X}"]
    yield Object(index, 0, name, "U8", "rw", len(entries))
    for sub in range(1, PDO_ENTRIES + 1):
        value = entries[sub - 1] if sub <= len(entries) else 0
        yield Object(index, sub, f"{name} {sub}", "U32", "rw", value)
