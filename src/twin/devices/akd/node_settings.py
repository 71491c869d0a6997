"""Settings of nodes that a trace shows: identifiers of services, and what a boot restores."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

from twin.devices.akd import protocol
from twin.devices.akd.object_names import PROFILE_OBJECTS, axis_of
from twin.devices.akd.protocol import Key

_SYNC_IDENTIFIER, _EMERGENCY_IDENTIFIER, _SDO_SERVERS = 0x1005, 0x1014, range(0x1200, 0x1280)
"""Objects with the identifiers of SYNC, of emergencies, and of SDO requests (1) and answers (2)."""
_STORE_WORD, _STORE_KEYS = 0x6576_6173, ((0x1010, 1), (0x1010, 2))
"""The word "save", and the objects that store the settings of PDOs when it is written to them."""
_RESTORE_WORD, _RESTORE_KEYS = 0x6461_6F6C, ((0x1011, 1), (0x1011, 2))
"""The word "load", and the objects that let the next boot restore their defaults."""


@dataclass
class NodeSettings:
    """What a trace shows of how nodes are set.

    Attributes:
        syncs: Identifiers of SYNC.
        moved: Service and node of identifiers that are not the usual ones of a node.
        described: Nodes of which the trace shows objects of a profile, or what a PDO carries.
        unstored: Settings of PDOs before they were written, by node, if not stored since.
        restored: Nodes that have the defaults of PDOs from their next boot on.
    """

    syncs: set[int] = field(default_factory=lambda: {protocol.SYNC})
    moved: dict[int, tuple[int, int]] = field(default_factory=dict)
    described: set[int] = field(default_factory=set)
    unstored: defaultdict[int, dict[Key, int | None]] = field(
        default_factory=lambda: defaultdict(dict)
    )
    restored: set[int] = field(default_factory=set)

    def take(self, number: int, key: Key, value: int, before: int | None, *, writes: bool) -> None:
        """Take in the value of an object of a node.

        Args:
            number: The node.
            key: Index and subindex.
            value: What was read or written.
            before: What was known of it.
            writes: Whether it was written.
        """
        index = axis_of(key[0])[0]
        of_pdo = index in protocol.PDO_PARAMETER_INDICES
        if of_pdo or index in PROFILE_OBJECTS:
            self.described.add(number)
        if writes and of_pdo:
            self.unstored[number].setdefault(key, before)
        elif writes and key in _STORE_KEYS and value == _STORE_WORD:
            self.unstored.pop(number, None)
        elif writes and key in _RESTORE_KEYS and value == _RESTORE_WORD:
            self.restored.add(number)
        identifier = value & 0x7FF
        if value & protocol.PDO_INVALID:
            return
        if index == _SYNC_IDENTIFIER:
            self.syncs.add(identifier)
        elif index == _EMERGENCY_IDENTIFIER:
            self.moved[identifier] = protocol.EMERGENCY, number
        elif index in _SDO_SERVERS and key[1] in (1, 2):
            service = protocol.SDO_REQUEST if key[1] == 1 else protocol.SDO_RESPONSE
            self.moved[identifier] = service, number
