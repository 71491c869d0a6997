"""Objects of CANopen devices: which of what axis they are, and their names and types.

Names come from an EDS or DCF file, else from the standards and, of an AKD, from its manual.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from twin.devices.akd import protocol
from twin.devices.akd.eds import DataSheet, read_data_sheet
from twin.devices.akd.protocol import Key, Object, table

CONTROL, STATUS, PLACE, SPEED, TARGET = 0x6040, 0x6041, 0x6064, 0x606C, 0x60FF
ERROR_CODE, FAULTS = 0x603F, 0x2001
MODE_OBJECTS = (0x6061, 0x6060)
"""The mode of operation, as it is displayed and as it is given."""
_VENDORS_OBJECTS, PROFILE_OBJECTS = range(0x2000, 0x6000), range(0x6000, 0xA000)
"""Indices of the objects of a vendor, and of those of a profile."""
AXIS_OFFSET = 0x800
"""Objects from one axis of a drive to the next."""


class Names:
    """Names of objects: from an EDS or DCF file, else from the standards and the AKD.

    Args:
        eds: The file.

    Raises:
        LogError: If it cannot be read.
    """

    def __init__(self, eds: Path | None = None) -> None:
        standard = [Object(*each) for each in table()["standard"]]
        self._known = {(each.index, each.sub): each for each in standard} | protocol.objects()
        self.sheet = read_data_sheet(eds) if eds is not None else DataSheet()
        """The content of the file."""

    def describe(self, key: Key, *, akd: bool, drive: bool, sheet: bool) -> Object:
        """An object of a node; of one that nobody knows, name and type are empty.

        Args:
            key: Index and subindex.
            akd: Whether the node is an AKD.
            drive: Whether it may be a drive of CiA 402.
            sheet: Whether the file may describe the node.
        """
        blank = Object(*key, "", "U0")
        if sheet and key in self.sheet.objects:
            found, known = self.sheet.objects[key], self._known.get(key)
            if found.type == "U0" and known and key[0] >= 0x6000 and drive:
                return replace(found, type=known.type)  # the file lacks it, the standard has it
            return found
        if key[0] in _VENDORS_OBJECTS:
            return self._known.get(key, blank) if akd else blank
        if key[0] not in PROFILE_OBJECTS:
            return self._known.get(key, blank)
        base, axis = axis_of(key[0])
        known = self._known.get((base, key[1])) if drive else None
        if known is None:
            return blank
        return Object(*key, known.name + (f" of axis {axis}" if axis > 1 else ""), known.type)


def axis_of(index: int) -> tuple[int, int]:
    """The object of the first axis that an object is like, and its axis, 1 for the first."""
    if index not in PROFILE_OBJECTS:
        return index, 1
    axis, offset = divmod(index - PROFILE_OBJECTS.start, AXIS_OFFSET)
    return PROFILE_OBJECTS.start + offset, axis + 1


def key_of_axis(index: int, axis: int) -> Key:
    """The object of an axis, 1 for the first, that is like an object of the first axis."""
    return index + (axis - 1) * AXIS_OFFSET, 0
