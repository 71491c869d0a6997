"""The object dictionaries of the nodes of a trace: what objects are and hold, and that in words.

Values are those that the trace shows, else those of the rig file, of an EDS or DCF file, or the
defaults of CiA 402. Positions are angles only where the trace shows what a unit of them is.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from twin.devices.akd import protocol
from twin.devices.akd.object_names import (
    AXIS_OFFSET,
    CONTROL,
    ERROR_CODE,
    FAULTS,
    MODE_OBJECTS,
    PLACE,
    PROFILE_OBJECTS,
    SPEED,
    STATUS,
    TARGET,
    Names,
    axis_of,
    key_of_axis,
)
from twin.devices.akd.observed import Change
from twin.devices.akd.protocol import RPM_RAD_S, TURN_RAD, Key, Object, mappings, table
from twin.devices.akd.wire_values import PRODUCT, PROFILE, VENDOR, shown_mask, split_mapping

if TYPE_CHECKING:
    from twin.devices.akd.config import AkdConfig

_REPORTED_OBJECTS = {CONTROL, STATUS, 0x6060, 0x6061, ERROR_CODE, 0x1001, 0x60FD}
"""Objects of which every change in a PDO is reported."""
_POSITION_OBJECTS = (0x6062, PLACE, 0x607A, 0x60F4)
"""In units of the user; the feed (6092h) gives their number in a turn of the shaft."""
_ENCODER_OBJECTS = (0x6063, 0x60FC)
"""In increments of the encoder; its resolution (608Fh) gives their number in a turn."""
_VELOCITY_OBJECTS = (0x606B, SPEED, TARGET)
"""In 0.001 rpm of an AKD, unless a rig file states their scale."""
_DRIVE_PROFILES = {0, 402, 0xFFFF}
"""Profiles (low word of 1000h) of drives, of devices of several profiles, and of none (0)."""


class _Held(dict[int, dict[Key, int]]):
    """Values of objects of nodes: at first those that are known without the trace."""

    def __init__(self, known: Callable[[int], dict[Key, int]]) -> None:
        super().__init__()
        self._known = known

    def __missing__(self, node: int) -> dict[Key, int]:
        return self.setdefault(node, self._known(node))


class ObjectDictionaries:
    """The object dictionaries of all nodes of a trace.

    Args:
        names: Names and types of objects.
        rig: The owner of the drives; None if it is not known.
        identities: Profile, vendor and product of nodes, by node and object.
        changes: Values of the objects of which every change is reported, by node and object; filled
            while the trace is decoded.
    """

    def __init__(
        self,
        names: Names,
        rig: AkdConfig | None,
        identities: Mapping[tuple[int, Key], int],
        changes: Mapping[tuple[int, Key], Sequence[Change]],
    ) -> None:
        self._names, self._identities, self._changes = names, identities, changes
        self._axes = {axis.node: axis for axis in rig.axes} if rig else {}
        self.values = _Held(self.known_without_trace)
        """Values of objects of nodes, as far as they were read or written until now."""
        self._objects: dict[tuple[int, Key], Object] = {}
        self._shown_bits: defaultdict[tuple[int, int], int] = defaultdict(int)

    def vendor(self, node: int) -> int | None:
        """The vendor that a node states in the trace; None if it does not."""
        return self._identities.get((node, VENDOR))

    def has_known_kind(self, node: int) -> bool:
        """Whether the rig file, the EDS file or the trace shows which kind of device a node is."""
        known = node in self._axes or (node, PROFILE) in self._identities or self.is_akd(node)
        return known or bool(self._names.sheet.objects and self.is_of_sheet(node))

    def note_status(self, node: int, index: int, status: int) -> None:
        """Take note of the bits that a status word sets: the drive uses these."""
        self._shown_bits[node, index] |= status

    def is_akd(self, node: int) -> bool:
        """Whether a node is an AKD: by the rig file, the trace, or the EDS file."""
        sheet = self._names.sheet
        vendor = self._identities.get((node, VENDOR), sheet.vendor)
        product = self._identities.get((node, PRODUCT))
        if product is None:
            product = sheet.defaults[PRODUCT].number if PRODUCT in sheet.defaults else 0
        known = vendor == protocol.AKD_VENDOR_ID and protocol.is_akd_product(product)
        return node in self._axes or known

    def is_drive(self, node: int) -> bool:
        """Whether a node may be a drive: unless the trace or its file shows a different profile."""
        default = self._names.sheet.defaults.get(PROFILE) if self.is_of_sheet(node) else None
        profile = self._identities.get((node, PROFILE), default.number if default else None)
        return node in self._axes or profile is None or profile & 0xFFFF in _DRIVE_PROFILES

    def is_of_sheet(self, node: int) -> bool:
        """Whether the EDS file may describe a node: not if the trace shows a different vendor."""
        vendor = self._identities.get((node, VENDOR))
        return vendor is None or self._names.sheet.vendor in (None, vendor)

    def known_without_trace(self, node: int) -> dict[Key, int]:
        """Values of a node's objects by the defaults of CiA 402, the EDS file and the rig file."""
        known = dict[Key, int]()
        if self.is_drive(node):
            known |= mappings({int(at, 16): each for at, each in table()["defaults"].items()})
        if self.is_of_sheet(node):
            known |= self._names.sheet.held_by(node)
        if node in self._axes:
            known |= mappings(protocol.pdo_maps(self._axes[node].plate_object))
        return known

    def find(self, node: int, key: Key) -> Object:
        """An object of a node: its name and type."""
        found = self._objects.get((node, key))
        if found is None:
            found = self._objects[node, key] = self._names.describe(
                key,
                akd=self.is_akd(node),
                drive=self.is_drive(node),
                sheet=self.is_of_sheet(node),
            )
        return found

    def name(self, node: int, key: Key) -> str:
        """Name of an object of a node."""
        name = self.find(node, key).name
        return f"{key[0]:04X}h{f':{key[1]}' if key[1] else ''}{f' {name}' if name else ''}"

    def reports_changes(self, node: int, key: Key) -> bool:
        """Whether every change of an object is reported."""
        index = axis_of(key[0])[0]
        if index == FAULTS:
            return self.is_akd(node)
        return index in _REPORTED_OBJECTS and (index < PROFILE_OBJECTS.start or self.is_drive(node))

    def plate_object(self, node: int) -> Key | None:
        """The object of the plate's encoder in a node; None if no rig file names it."""
        return self._axes[node].plate_object if node in self._axes else None

    def mode(self, node: int, axis: int, time: float = math.inf) -> int | None:
        """The mode of operation of an axis at a time in s; None if the trace does not show it.

        The mode that the drive displays counts, else the one that it is given.
        """
        for index in MODE_OBJECTS:
            changes = self._changes.get((node, key_of_axis(index, axis)), ())
            shown = (each.value for each in reversed(changes) if each.time <= time)
            if (mode := next(shown, None)) is not None:
                return mode
        return None

    def scale(self, node: int, key: Key) -> tuple[float, str]:
        """Factor and SI unit of an object of a node; 1 and nothing if they are not known.

        Positions are in units of the user: 6092h:1 of them make 6092h:2 turns of the driven shaft.
        Where the trace does not show these, the gear (6091h) and the encoder's resolution (608Fh),
        positions stay counts. An AKD counts by 608Fh alone unless bit 4 of its
        FBUS.PARAM05 (36E9h) is set.
        """
        axis, (index, number) = self._axes.get(node), axis_of(key[0])
        if axis is not None and key == axis.plate_object:
            return axis.plate, "rad"
        if key[1] or not self.is_drive(node):
            return 1.0, ""
        if axis is not None and index in _POSITION_OBJECTS:
            return axis.position, "rad"
        if index in _VELOCITY_OBJECTS and self.is_akd(node):
            return axis.velocity if axis else 0.001 * RPM_RAD_S, "rad/s"
        units = self._units_per_turn(node, index, (number - 1) * AXIS_OFFSET)
        return (TURN_RAD / units, "rad") if units else (1.0, "")

    def _units_per_turn(self, node: int, index: int, offset: int) -> float | None:
        """How many units of a position a turn has; None if the trace does not show it.

        Args:
            node: Number of the node.
            index: The position's, of the first axis.
            offset: From the objects of the first axis to those of the position's.
        """
        values = self.values[node]

        def ratio(of: int) -> float | None:
            above, below = (values.get((of + offset, sub)) for sub in (1, 2))
            return above / below if above and below else None

        resolution, gear, feed = (ratio(of) for of in (0x608F, 0x6091, 0x6092))
        increments = self.is_akd(node) and not values.get((0x36E9, 0), 0) & 1 << 4
        if index in _ENCODER_OBJECTS or (index in _POSITION_OBJECTS and increments):
            return resolution
        return feed if index in _POSITION_OBJECTS and resolution and gear else None

    def words(self, node: int, key: Key, value: float) -> str:
        """A value of an object in words."""
        if isinstance(value, float):
            return f"{value:.7g}"
        index, sub = axis_of(key[0])[0], key[1]
        factor, unit = self.scale(node, key)
        of_pdo, maps = index in protocol.PDO_PARAMETER_INDICES, bool(index & 0x200)
        text = f"{value}" if abs(value) < 1 << 16 else f"{value} ({value & shown_mask(value):X}h)"
        drive = self.is_drive(node)
        if index == STATUS and drive:
            seen = self._shown_bits[node, key[0]]
            served = 0xFFFF if self.is_akd(node) else seen
            mode = self.mode(node, axis_of(key[0])[1])
            text = f"{protocol.status_words(value, served, mode, seen)} ({value:04X}h)"
        elif index == CONTROL and drive:
            mode = self.mode(node, axis_of(key[0])[1])
            text = f"{protocol.control_words(value, mode)} ({value:04X}h)"
        elif index in {0x6060, 0x6061} and drive:
            text = table()["modes"].get(f"{value}", f"mode {value}")
        elif key == PROFILE and value:
            text = f"CiA {value & 0xFFFF} ({value:X}h)"
        elif index == ERROR_CODE and drive and value:
            words = protocol.error_words(value, akd=self.is_akd(node))
            text = f"{value:04X}h {words}".strip()
        elif index == protocol.CONSUMER_HEARTBEAT and sub and value:
            text = "node {} within {} ms".format(*protocol.split_watch(value))
        elif of_pdo and not maps and sub == 1:
            text = f"{value & 0x7FF:03X}h{' off' if value & protocol.PDO_INVALID else ''}"
        elif of_pdo and maps and sub and value:
            carried, bits = split_mapping(value)
            text = f"{self.name(node, carried)}, {bits} bits"
        elif index == FAULTS and sub and value and self.is_akd(node):
            text = protocol.fault_words([value])
        elif unit:
            text = f"{value * factor:.6g} {unit}"
        return text
