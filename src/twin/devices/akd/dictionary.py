"""The object dictionary: the objects of a drive that the host knows, from ``objects.toml``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from twin.data_file import packaged

PDO_INVALID = 1 << 31
"""Bit of a PDO's COB-ID that switches it off."""
PDO_ENTRIES = 8


@dataclass(frozen=True)
class Object:
    """One object of a drive; type is U or I and the bits."""

    index: int
    sub: int
    name: str
    type: str

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


@cache
def objects() -> dict[tuple[int, int], Object]:
    """The objects of a drive that the host knows, by index and subindex."""
    found = [Object(*each) for each in table()["objects"]]
    for kind, first in (("RPDO", 0x1400), ("TPDO", 0x1800)):
        for number in range(4):
            name, index = f"{kind}{number + 1}", first + number
            found += [Object(index, s, f"{name} {what}", t) for s, what, t in table()["parameters"]]
            found += [
                Object(index + 0x200, sub, f"{name} mapping {sub}", "U32" if sub else "U8")
                for sub in range(PDO_ENTRIES + 1)
            ]
    return {(each.index, each.sub): each for each in found}


@cache
def table() -> dict[str, Any]:
    """The tables of ``objects.toml`` by their names."""
    return packaged("twin.devices.akd", "objects.toml")


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
