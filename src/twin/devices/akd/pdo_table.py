"""The PDOs of a bus: which identifier carries which objects of a node, at each time of a trace.

Identifiers and mappings are those that the trace shows as they are read and written; a boot takes
back the ones that were not stored. Where it shows none, a PDO has its usual identifier.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Collection, Iterable
from typing import Any, NamedTuple

from twin.devices.akd import protocol
from twin.devices.akd.node_settings import NodeSettings
from twin.devices.akd.object_dictionaries import ObjectDictionaries
from twin.devices.akd.protocol import Key
from twin.devices.akd.wire_values import split_mapping

_MIN_MAPPED_INDEX = 0x20
"""Lowest index of a mapped object: a lower one is a data type, used as padding."""


class Pdo(NamedTuple):
    """A PDO with its mapped objects.

    Attributes:
        node: The sending or receiving node.
        name: ``TPDO1``, ``RPDO2``, ...
        entries: Its objects and their bits, in order.
    """

    node: int
    name: str
    entries: tuple[tuple[Key, int], ...]


class Series(NamedTuple):
    """Values of an object in the PDOs of a node: s since the first frame, and as they were sent.

    They are whole counts, or of an object of IEEE 754 its numbers.
    """

    time: array[float]
    counts: array[Any]


class PdoEntry(NamedTuple):
    """An object in a PDO.

    Attributes:
        key: Index and subindex.
        type: Letter and bits, as `Object` has them.
        first: Its first bit in the data.
        bits: Number of its bits.
        reports_changes: Whether every change of it is reported.
        series: The values that were sent.
    """

    key: Key
    type: str
    first: int
    bits: int
    reports_changes: bool
    series: Series


class PdoTable:
    """The PDOs of a bus by their identifiers, as far as they are known until now.

    Args:
        objects: The object dictionaries of the nodes.
        settings: The settings of nodes that the trace shows.
        there: Nodes that say anything in the trace.
        sheet_node: Number of the node that an EDS or DCF file describes; 0 if it states none.
    """

    def __init__(
        self,
        objects: ObjectDictionaries,
        settings: NodeSettings,
        there: Collection[int],
        sheet_node: int,
    ) -> None:
        self.by_identifier: dict[int, Pdo] = {}
        """PDOs by their identifier; of those that several nodes have, the one that is sent."""
        self.series: dict[tuple[int, Key], Series] = {}
        """What PDOs carried, by node and object."""
        self._objects, self._settings = objects, settings
        self._there, self._sheet_node = there, sheet_node
        self._receivers: defaultdict[int, dict[tuple[int, str], Pdo]] = defaultdict(dict)
        self._layouts: dict[tuple[int, str], tuple[int, list[PdoEntry]]] = {}
        self._no_pdo: set[int] = set()
        self._identified: set[tuple[int, int]] = set()

    def find(self, identifier: int) -> Pdo | None:
        """The PDO that an identifier carries; None if it is no PDO's."""
        return self.by_identifier.get(identifier) or self._usual(identifier)

    def receivers(self, identifier: int) -> Iterable[Pdo]:
        """Further PDOs with an identifier: of nodes that receive what another node sends."""
        return self._receivers.get(identifier, {}).values()

    def take(self, number: int, key: Key) -> None:
        """Take note that an object of a node's PDO was read or written; it holds the value now."""
        index, sub = key
        if not index & 0x200 and sub == 1:
            self._identified.add((number, index))
        self._assign(number, index & ~0x200)

    def forget(self, number: int) -> None:
        """Take back the settings of PDOs that a node has no more as it boots.

        These are the ones that it was given and did not store, all if it was to restore defaults.
        """
        before, values = self._settings.unstored.pop(number, {}), self._objects.values[number]
        if number in self._settings.restored:
            self._settings.restored.remove(number)
            known = self._objects.known_without_trace(number)
            its = [key for key in values if key[0] in protocol.PDO_PARAMETER_INDICES]
            before = {key: known.get(key) for key in its}
        for key, value in before.items():
            self._identified.discard((number, key[0]))
            if value is None:
                del values[key]
            else:
                values[key] = value
        for parameters in {index & ~0x200 for index, _ in before}:
            self._assign(number, parameters)

    def layout(self, pdo: Pdo, bits: int) -> list[PdoEntry] | None:
        """The objects of a PDO with their types, without padding; None if its length is different.

        Args:
            pdo: The PDO.
            bits: Length of the data of its frame.
        """
        length, entries = self._layouts.get(pdo[:2]) or (sum(size for _, size in pdo.entries), None)
        if bits != length:
            return None
        return self._lay_out(pdo) if entries is None else entries

    def _lay_out(self, pdo: Pdo) -> list[PdoEntry]:
        """The objects of a PDO with their types, without padding; they are kept as its layout.

        Without those, too, that were mapped with a different kind of number before.
        """
        found, first = list[PdoEntry](), 0
        for key, bits in pdo.entries:
            if 0 < bits <= 64 and key[0] >= _MIN_MAPPED_INDEX:
                kind = self._objects.find(pdo.node, key).type
                real = kind[0] == "F" and kind[1:] == f"{bits}"
                code = "d" if real else "q" if kind[0] == "I" else "Q"
                series = self.series.setdefault((pdo.node, key), Series(array("d"), array(code)))
                reports = self._objects.reports_changes(pdo.node, key)
                if series.counts.typecode == code:
                    found.append(PdoEntry(key, kind, first, bits, reports, series))
            first += bits
        self._layouts[pdo[:2]] = first, found
        return found

    def _assign(self, number: int, parameters: int) -> None:
        """Take note of the identifier and mapping of a PDO, as far as they are known now.

        An identifier that a PDO has left is its no more. One that a node receives may be one that
        a different node sends.
        """
        cob_id, its = self._cob_id(number, parameters), self._assigned(number, parameters)
        if cob_id is None:
            return
        self._no_pdo.discard(cob_id)
        self._layouts.clear()
        for other, pdo in list(self.by_identifier.items()):
            if pdo[:2] == its[:2] and other != cob_id:
                del self.by_identifier[other]
        for others in self._receivers.values():
            others.pop(its[:2], None)
        there = self.by_identifier.get(cob_id) or self._sender(cob_id, number)
        if there is None or there[:2] == its[:2]:
            self.by_identifier[cob_id] = its
        elif its.name[0] == "R":
            self._receivers[cob_id][its[:2]], self.by_identifier[cob_id] = its, there
        else:
            self._receivers[cob_id][there[:2]], self.by_identifier[cob_id] = there, its

    def _usual(self, identifier: int) -> Pdo | None:
        """The PDO that an identifier is by what is known without the trace; None if it is none.

        Those that are sent come before those that are received.
        """
        if identifier in self._no_pdo:
            return None
        nodes = {identifier & protocol.NODE_MASK, self._sheet_node} - {0}
        for parameters in self._pdo_parameters(nodes):
            for number in nodes:
                if self._cob_id(number, parameters) == identifier:
                    found = self.by_identifier[identifier] = self._assigned(number, parameters)
                    return found
        self._no_pdo.add(identifier)
        return None

    def _sender(self, cob_id: int, number: int) -> Pdo | None:
        """The PDO that a different node, which is there, sends by an identifier."""
        other = cob_id & protocol.NODE_MASK
        if other == number or other not in self._there:
            return None
        sent = (each for each in self._pdo_parameters([other]) if each >= 0x1800)
        found = next((each for each in sent if self._cob_id(other, each) == cob_id), None)
        return self._assigned(other, found) if found is not None else None

    def _pdo_parameters(self, nodes: Iterable[int]) -> list[int]:
        """The parameters of PDOs that nodes may have, those that they send first."""
        known = {i for number in nodes for i, sub in self._objects.values[number] if sub == 1}
        given = {
            index
            for index in known
            if index in protocol.PDO_PARAMETER_INDICES and not index & 0x200
        }
        usual = {first + k for first in (0x1400, 0x1800) for k in range(4)}
        return sorted(given | usual, key=lambda index: (index < 0x1800, index))

    def _cob_id(self, number: int, parameters: int) -> int | None:
        """The identifier of a PDO of a node, as far as it is known now; None if it has none."""
        base = protocol.RPDO1 if parameters < 0x1800 else protocol.TPDO1
        place = parameters & 0x1FF
        usual = base + 0x100 * place + number if place < 4 else None
        value = self._objects.values[number].get((parameters, 1))
        if value is None:
            return usual
        if (number, parameters) not in self._identified:  # frames of it show that it is on
            return value & 0x7FF or usual
        return None if value & protocol.PDO_INVALID else value & 0x7FF

    def _assigned(self, number: int, parameters: int) -> Pdo:
        """What a PDO of a node carries, as far as it is known now."""
        mapping, values = parameters + 0x200, self._objects.values[number]
        count = values.get((mapping, 0), 0) & 0xFF
        entries = [split_mapping(values.get((mapping, sub), 0)) for sub in range(1, count + 1)]
        name = f"{'T' if parameters >= 0x1800 else 'R'}PDO{(parameters & 0x1FF) + 1}"
        return Pdo(number, name, tuple(entries))
