"""The object dictionary: a minimal one of our own, or the vendor's EDS file."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import canopen
from canopen import objectdictionary as od

from twin.devices.akd.conditions import WRONG_SETTING, DriveError

PDO_INVALID = 1 << 31
"""Bit of a PDO's COB-ID that switches it off."""
PDO_ENTRIES = 8

_TYPES = {
    "U8": od.UNSIGNED8,
    "U16": od.UNSIGNED16,
    "U32": od.UNSIGNED32,
    "I8": od.INTEGER8,
    "I16": od.INTEGER16,
    "I32": od.INTEGER32,
}

_DEFAULT_MAPS = {
    0x1600: (0x60400010,),
    0x1601: (0x60400010, 0x60600008),
    0x1602: (0x60400010, 0x607A0020),
    0x1603: (0x60400010, 0x60FF0020),
    0x1A00: (0x60410010,),
    0x1A01: (0x60410010, 0x60610008),
    0x1A02: (0x60410010, 0x60640020),
    0x1A03: (0x60410010, 0x606C0020),
}


@dataclass(frozen=True)
class Object:
    """One object of a drive; type is U or I and the bits, access ro or rw."""

    index: int
    sub: int
    name: str
    type: str
    access: str
    default: int


def objects(node: int) -> Iterator[Object]:
    """The built-in objects of a drive with this node, PDO parameters with their defaults."""
    for each in _table()["objects"]:
        yield Object(*each)
    for number in range(4):
        receive, transmit = 0x200 + 0x100 * number + node, 0x180 + 0x100 * number + node
        yield from _parameters(0x1400 + number, "RPDO", receive)
        yield from _mapping(0x1600 + number, "RPDO")
        yield from _parameters(0x1800 + number, "TPDO", transmit)
        yield from _mapping(0x1A00 + number, "TPDO")


@cache
def _table() -> dict[str, Any]:
    text = (resources.files("twin.devices.akd") / "objects.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def kept(index: int, written: int, read: int) -> bool:
    """Whether what is read of an object is what was written, as far as the drive can keep it."""
    key = f"0x{index:04X}"
    share = _table()["tolerances"].get(key, 0.0)
    ignored = _table()["ignored_bits"].get(key, 0)
    same = (written ^ read) & ~ignored == 0
    return bool(same or abs(read - written) <= share * abs(written))


def _parameters(index: int, kind: str, cob_id: int) -> Iterator[Object]:
    name = f"{kind}{index % 4 + 1} parameter"
    yield Object(index, 0, name, "U8", "ro", 5)
    yield Object(index, 1, f"{name} COB-ID", "U32", "rw", cob_id)
    yield Object(index, 2, f"{name} type", "U8", "rw", 255)
    yield Object(index, 3, f"{name} inhibit time", "U16", "rw", 20 if kind == "TPDO" else 0)
    yield Object(index, 5, f"{name} event timer", "U16", "rw", 0)


def _mapping(index: int, kind: str) -> Iterator[Object]:
    name = f"{kind}{index % 4 + 1} mapping"
    entries = _DEFAULT_MAPS[index]
    yield Object(index, 0, name, "U8", "rw", len(entries))
    for sub in range(1, PDO_ENTRIES + 1):
        value = entries[sub - 1] if sub <= len(entries) else 0
        yield Object(index, sub, f"{name} {sub}", "U32", "rw", value)


def dictionary(node: int, eds: Path | None = None) -> Any:
    """The `canopen` object dictionary of a drive, from an EDS file if one is given.

    Raises:
        DriveError: If the file cannot be read, or lacks an object that is needed.
    """
    if eds is None:
        return _built_in(node)
    try:
        given = canopen.import_od(str(eds), node)
    except Exception as error:  # the parser lets every kind of error through
        reason = error.strerror if isinstance(error, OSError) else "not an EDS file"
        raise DriveError(WRONG_SETTING, f"EDS {eds}", reason or "cannot be read") from error
    for each in objects(node):
        variable = given.get_variable(each.index, each.sub)
        what = f"{each.index:04X}h:{each.sub} ({each.name})"
        if variable is None and each.sub <= 2:
            raise DriveError(WRONG_SETTING, f"EDS {eds}", f"lacks {what}")
        if variable is not None and variable.data_type != _TYPES[each.type]:
            detail = f"gives {what} another type; an AKD has {each.type}"
            raise DriveError(WRONG_SETTING, f"EDS {eds}", detail)
    return given


def _built_in(node: int) -> Any:
    result = od.ObjectDictionary()
    table = list(objects(node))
    records = {each.index for each in table if each.sub}
    for each in table:
        variable = od.ODVariable(each.name, each.index, each.sub)
        variable.data_type = _TYPES[each.type]
        variable.access_type = each.access
        variable.default = each.default
        variable.pdo_mappable = True
        if each.index not in records:
            result.add_object(variable)
            continue
        if each.sub == 0:
            # A record, not an array: canopen writes no PDO mapping into an array.
            result.add_object(od.ODRecord(each.name, each.index))
            variable.name = "Number of entries"
        result[each.index].add_member(variable)
    return result
