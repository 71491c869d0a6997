"""The object dictionary: the objects of a drive that the host knows, from ``objects.toml``.

What objects of any drive are called, by its maker's EDS file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from twin.data_file import packaged
from twin.errors import LogError

PDO_INVALID = 1 << 31
"""Bit of a PDO's COB-ID that switches it off."""
PDO_ENTRIES = 8
PDOS = (0x1400, 0x1C00)
"""First and last of their parameters, and 200h above these mappings."""
Key = tuple[int, int]
"""Index and subindex."""


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


def entry(index: int, sub: int) -> int:
    """An object as an entry of a mapping.

    Raises:
        KeyError: If the host does not know it.
    """
    return index << 16 | sub << 8 | objects()[index, sub].bits


@cache
def mapping_objects() -> dict[Key, int]:
    """The mappings of the PDOs that CiA 402 has by default, as the objects that hold them."""
    entries = {int(key, 16): each for key, each in table()["defaults"].items()}
    return as_objects(entries)


def as_objects(entries: Mapping[int, Sequence[int]]) -> dict[Key, int]:
    """Mappings, by the index of their PDO's parameters, as the objects that hold them."""
    return {
        (parameters + 0x200, sub): value
        for parameters, each in entries.items()
        for sub, value in enumerate((len(each), *each))
    }


class Names:
    """What objects are called: by an EDS file, else as the standards and an AKD have them.

    Args:
        eds: The file, EDS or DCF.

    Raises:
        LogError: If it cannot be read.
    """

    def __init__(self, eds: Path | None = None) -> None:
        known = [Object(*each) for each in table()["standard"]]
        self._known = {(each.index, each.sub): each for each in known} | objects()
        self.defaults: dict[Key, int] = {}
        """Default values that the file gives for mappings of PDOs."""
        for each, kind in () if eds is None else _variables(eds):
            key = each.index, each.subindex
            self._known[key] = Object(*key, each.qualname.replace(".", ": "), kind)
            mapping = PDOS[0] <= each.index < PDOS[1] and each.index & 0x200
            if mapping and isinstance(each.default, int):
                self.defaults[key] = each.default

    def __getitem__(self, key: Key) -> Object:
        """The object; one that nobody knows is called by its index."""
        return self._known.get(key) or Object(*key, "", "U0")


def _variables(eds: Path) -> list[tuple[Any, str]]:
    """All variables of an EDS file, as canopen has them, with their types."""
    from canopen.objectdictionary import ODVariable, import_od  # noqa: PLC0415  rarely needed
    from canopen.objectdictionary.datatypes import SIGNED_TYPES  # noqa: PLC0415

    try:
        found = import_od(str(eds), node_id=None).values()
    except Exception as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise LogError(f"--eds {eds}: not a readable EDS file: {why}") from error
    every = [v for one in found for v in ([one] if isinstance(one, ODVariable) else one.values())]
    return [
        (each, f"{'I' if each.data_type in SIGNED_TYPES else 'U'}{len(each)}") for each in every
    ]
