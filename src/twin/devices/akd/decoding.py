"""What the frames of a trace say: any CANopen devices, drives of CiA 402 in words.

What a PDO carries is taken from the trace itself, where its mapping is written or read; else from
the rig file, from an EDS file, or, where the length fits, from what CiA 402 has as default.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np

from twin.devices.akd import cia402, dictionary, frames
from twin.devices.akd.cia402 import DriveState
from twin.devices.akd.config import RPM, TURN, AkdConfig
from twin.devices.akd.dictionary import PDO_INVALID, Object, table
from twin.errors import LogError

Key = tuple[int, int]
"""Index and subindex."""
CONTROL, STATUS, PLACE, SPEED, TARGET = 0x6040, 0x6041, 0x6064, 0x606C, 0x60FF
_TOLD = {CONTROL, STATUS, 0x6060, 0x6061, 0x603F, 0x1001, 0x60FD, 0x2001}
"""Objects whose every change in a PDO is told."""
_POSITIONS = (0x6062, 0x6063, PLACE, 0x607A, 0x60F4)
_VELOCITIES = (0x606B, SPEED, TARGET)
_AKD = 0x6A
"""Vendor whose drives count velocities in 0.001 rpm."""
_KINDS = {0x080: "EMCY", 0x580: "SDO", 0x600: "SDO", 0x700: "heartbeat"}
_TIME, _LSS = 0x100, (0x7E4, 0x7E5)
_IRREGULAR = 0.05
"""Share of long pauses from which a sequence of frames is no regular one."""
_LONG = 1.6
"""Times the usual pause from which one is a gap."""
_FEW, _MOST = 10, 20
"""Fewest frames in which a rhythm is seen; most gaps of one kind that are told, the longest."""
_ENDED, _ENDED_FOR = 5, 0.05
"""Times the usual pause, and s, from which something has ended before the trace does."""
_PDOS = (0x1400, 0x1C00)
"""Objects of PDOs: parameters, and 200h above them mappings."""
HOST = "host"
"""Who sends what only a master sends."""


class Event(NamedTuple):
    """Something that was said.

    Attributes:
        time: Seconds since the first frame.
        who: Who said it.
        kind: NMT, SDO, PDO, EMCY, heartbeat, SYNC or bus.
        text: What, in words.
    """

    time: float
    who: str
    kind: str
    text: str


class Names:
    """What objects are called: by an EDS file, else as the standards and an AKD have them.

    Args:
        eds: The file, EDS or DCF.

    Raises:
        LogError: If it cannot be read.
    """

    def __init__(self, eds: Path | None = None) -> None:
        self._known = dict(_packaged())
        self.defaults: dict[Key, int] = {}
        """Default values of the file's PDO parameters and mappings."""
        if eds is None:
            return
        from canopen.objectdictionary import ODVariable, import_od  # noqa: PLC0415  rarely needed
        from canopen.objectdictionary.datatypes import SIGNED_TYPES  # noqa: PLC0415

        try:
            found = import_od(str(eds), node_id=None)
        except Exception as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise LogError(f"--eds {eds}: not a readable EDS file: {why}") from error
        for entry in found.values():
            alone = isinstance(entry, ODVariable)
            for each in [entry] if alone else entry.values():
                name = each.name if alone else f"{entry.name}: {each.name}"
                size = len(each) if each.data_type else 0
                kind = f"{'I' if each.data_type in SIGNED_TYPES else 'U'}{size}"
                self._known[each.index, each.subindex] = Object(
                    each.index, each.subindex, name, kind
                )
                if 0x1400 <= each.index < 0x1C00 and isinstance(each.default, int):
                    self.defaults[each.index, each.subindex] = each.default

    def __getitem__(self, key: Key) -> Object:
        """The object; one that nobody knows is called by its index."""
        return self._known.get(key) or Object(*key, "", "U0")


@cache
def _packaged() -> dict[Key, Object]:
    known = [Object(*each) for each in table()["standard"]]
    return {(each.index, each.sub): each for each in known} | dictionary.objects()


class Pdo(NamedTuple):
    """What a PDO carries.

    Attributes:
        node: Whose it is.
        name: ``TPDO1``, ``RPDO2``, ...
        entries: Its objects and their bits, in order.
        source: Where that is known from.
    """

    node: int
    name: str
    entries: tuple[tuple[Key, int], ...]
    source: str

    @property
    def bits(self) -> int:
        """Length of all entries."""
        return sum(bits for _, bits in self.entries)


@dataclass
class Node:
    """What a node did.

    Attributes:
        name: What it is called.
        frames: How many it sent, by kind.
        states: Its NMT states, in order.
        drive: The states of its power stage, in order.
        faults: What it reported, time in s and words.
        values: Objects as they were last written or read over SDO.
        transfers: SDO transfers by how they ended.
    """

    name: str
    frames: Counter[str] = field(default_factory=Counter)
    states: list[str] = field(default_factory=list)
    drive: list[str] = field(default_factory=list)
    faults: list[tuple[float, str]] = field(default_factory=list)
    values: dict[Key, int] = field(default_factory=dict)
    transfers: Counter[str] = field(default_factory=Counter)


class Series(NamedTuple):
    """Values of an object in the PDOs of a node: s since the first frame, whole counts."""

    time: array[float]
    counts: array[int]


@dataclass
class _Transfer:
    """An SDO transfer under way: since when, its object, whether it writes, what has come."""

    since: float
    key: Key
    writes: bool
    data: bytes = b""
    segmented: bool = False
    block: bool = False


class Conversation:
    """All that the frames of one channel say.

    Args:
        heard: The frames, in the order of their times.
        names: What objects are called.
        rig: Whose drives they are, for names, scales and mappings that the trace does not show.
    """

    def __init__(
        self,
        heard: Sequence[can.Message],
        names: Names | None = None,
        rig: AkdConfig | None = None,
    ) -> None:
        self.events: list[Event] = []
        """What was said, in order; of PDOs the changes."""
        self.nodes: dict[int, Node] = {}
        """Nodes that sent something, by number."""
        self.series: dict[tuple[int, Key], Series] = {}
        """What PDOs carried, by node and object."""
        self.begin = heard[0].timestamp
        """Time of the first frame, s, as the trace has it."""
        self.duration = heard[-1].timestamp - self.begin
        """Seconds from the first frame to the last."""
        self.strangers: Counter[int] = Counter()
        """Frames of no service of CANopen, by identifier."""
        self.pauses: dict[str, dict[str, Any]] = {}
        """Of what came regularly: its usual pause in s, its gaps and the longest."""
        self._names, self._rig = names or Names(), rig
        self._axes = {axis.node: axis for axis in rig.axes} if rig else {}
        self._times: defaultdict[str, array[float]] = defaultdict(lambda: array("d"))
        self._sdo: dict[int, _Transfer] = {}
        self._pdos: dict[int, Pdo | None] = {}
        self._last: dict[tuple[int, Key], str] = {}
        self._lengths: dict[str, int] = {}
        self._written: tuple[int, Key, str] | None = None
        for message in heard:
            self._take(message, message.timestamp - self.begin)
        for node, left in sorted(self._sdo.items()):
            self._unanswered(node, left)
        self._find_gaps()
        self.events.sort(key=lambda each: each.time)

    @property
    def sync(self) -> array[float]:
        """When SYNC was sent, s since the first frame."""
        return self._times["SYNC"]

    def called(self, node: int) -> str:
        """What a node is called."""
        axis = self._axes.get(node)
        return f"node {node}" + (f" ({axis.name})" if axis else "")

    def scale(self, node: int, key: Key) -> tuple[float, str]:
        """Factor and SI unit of an object of a node; 1 and nothing if they are not known."""
        axis, values = self._axes.get(node), self._node(node).values
        index = key[0]
        if axis is not None and key == axis.plate_object:
            return axis.plate.unit, "rad"
        if index in _POSITIONS:
            counts, turns = values.get((0x608F, 1)), values.get((0x608F, 2), 1)
            seen = TURN * turns / counts if counts else None
            unit = axis.position.unit if axis else seen
            return (unit, "rad") if unit else (1.0, "")
        if index in _VELOCITIES:
            if axis is not None:
                return axis.velocity.unit, "rad/s"
            if values.get((0x1018, 1)) == _AKD:
                return 0.001 * RPM, "rad/s"
        return 1.0, ""

    def words(self, node: int, key: Key, value: int) -> str:
        """A value of an object in words."""
        index, sub = key
        factor, unit = self.scale(node, key)
        said = f"{value}" if abs(value) < 1 << 16 else f"{value} ({value & 0xFFFFFFFF:X}h)"
        if index == STATUS:
            said = f"{cia402.status_words(value)} ({value:04X}h)"
        elif index == CONTROL:
            said = f"{cia402.control_words(value)} ({value:04X}h)"
        elif index in {0x6060, 0x6061}:
            said = cia402.MODES.get(value, f"mode {value}")
        elif index == 0x1016 and sub and value:
            said = f"node {value >> 16 & 0x7F} within {value & 0xFFFF} ms"
        elif _PDOS[0] <= index < _PDOS[1] and not index & 0x200 and sub == 1:
            said = f"{value & 0x7FF:03X}h{' off' if value & PDO_INVALID else ''}"
        elif _PDOS[0] <= index < _PDOS[1] and index & 0x200 and sub and value:
            said = f"{self._object((value >> 16, value >> 8 & 0xFF))}, {value & 0xFF} bits"
        elif index == 0x2001 and sub and value:
            said = frames.fault_words([value])
        elif unit:
            said = f"{value * factor:.6g} {unit}"
        return said

    def summary(self) -> dict[str, Any]:
        """What ``--json`` prints, but for the events."""
        found: dict[str, Any] = {"duration": self.duration, "begin": self.begin, "nodes": {}}
        for number, node in sorted(self.nodes.items()):
            signals = {}
            for (owner, key), series in self.series.items():
                if owner == number and key[0] not in _TOLD:
                    factor, unit = self.scale(owner, key)
                    ends = sorted(factor * each(series.counts) for each in (min, max))
                    signals[self._object(key)] = {"from": ends[0], "to": ends[1], "unit": unit}
            found["nodes"][str(number)] = {
                "name": node.name,
                "frames": dict(node.frames),
                "states": node.states,
                "drive": node.drive,
                "faults": [{"time": at, "text": text} for at, text in node.faults],
                "transfers": dict(node.transfers),
                "signals": signals,
            }
        found["pdos"] = {
            f"{cob_id:03X}h": {
                "node": pdo.node,
                "name": pdo.name,
                "carries": [self._object(key) for key, _ in pdo.entries],
                "source": pdo.source,
            }
            for cob_id, pdo in self._pdos.items()
            if pdo is not None
        }
        found["regular"] = self.pauses
        found["strangers"] = {f"{each:03X}h": n for each, n in self.strangers.items()}
        return found

    def _object(self, key: Key) -> str:
        name = self._names[key].name
        return f"{key[0]:04X}h{f':{key[1]}' if key[1] else ''}{f' {name}' if name else ''}"

    def _node(self, number: int) -> Node:
        return self.nodes.setdefault(number, Node(self.called(number)))

    def _say(self, at: float, who: str, kind: str, text: str) -> None:
        self.events.append(Event(at, who, kind, text))

    def _take(self, message: can.Message, at: float) -> None:
        identifier, data = message.arbitration_id, bytes(message.data)
        if message.is_error_frame:
            self._say(
                at, "adapter", "bus", f"error frame {identifier:03X}h {data.hex(' ')}".strip()
            )
        elif message.is_extended_id or identifier in _LSS or identifier == _TIME:
            self.strangers[identifier] += 1
        elif identifier == frames.NMT:
            self._nmt(at, data)
        elif identifier == frames.SYNC:
            self._times["SYNC"].append(at)
        elif not message.is_remote_frame:
            self._service(at, identifier, data)

    def _nmt(self, at: float, data: bytes) -> None:
        if len(data) == 2:
            whom = self.called(data[1]) if data[1] else "all nodes"
            command = frames.NMT_COMMANDS.get(data[0], f"command {data[0]}")
            self._say(at, HOST, "NMT", f"{command}: {whom}")

    def _service(self, at: float, identifier: int, data: bytes) -> None:
        number = identifier & frames.NODE_MASK
        service = identifier - number
        kind = _KINDS.get(service)
        pdo = self._pdo(identifier)
        if pdo is not None:
            self._exchange(at, pdo, data)
        elif kind is None or not number:
            self.strangers[identifier] += 1
        elif service == frames.SDO_REQUEST:
            self._request(at, number, data)
        else:
            self._node(number).frames[kind] += 1
            if service == frames.EMERGENCY:
                message = frames.decode_emergency(data)
                self._fault(at, number, "EMCY", message.words, real=bool(message.code))
            elif service == frames.SDO_RESPONSE:
                self._response(at, number, data)
            elif (state := frames.decode_nmt_state(data)) is not None:
                self._heartbeat(at, number, state)

    def _heartbeat(self, at: float, number: int, state: int) -> None:
        node, words = self._node(number), frames.nmt_words(state)
        if state:
            self._times[f"heartbeat of {node.name}"].append(at)
        if not state or node.states[-1:] != [words]:
            node.states.append(words)
            self._say(at, node.name, "heartbeat", words)

    def _fault(self, at: float, number: int, kind: str, words: str, *, real: bool) -> None:
        self._say(at, self.called(number), kind, words)
        if real:
            self._node(number).faults.append((at, words))

    def _power(self, at: float, number: int, status: int) -> None:
        """Note the state that a status word shows."""
        node, state = self._node(number), cia402.state(status)
        if node.drive[-1:] != [state.value]:
            node.drive.append(state.value)
            if state is DriveState.FAULT:
                node.faults.append((at, self.words(number, (STATUS, 0), status)))

    def _pdo(self, identifier: int) -> Pdo | None:
        """The PDO of an identifier; None if it is another service's."""
        if identifier not in self._pdos:
            number = identifier & frames.NODE_MASK
            place, receives = divmod(identifier - number - frames.TPDO1, 0x100)
            if number and 0 <= place < 4 and receives in {0, 0x80}:
                parameters = (0x1400 if receives else 0x1800) + place
                self._pdos[identifier] = self._assigned(number, parameters)
            else:
                self._pdos[identifier] = None
        return self._pdos[identifier]

    def _assigned(self, number: int, parameters: int) -> Pdo:
        """What a PDO of a node carries, from the best that is known of it."""
        first, mapping = 0x1800 if parameters >= 0x1800 else 0x1400, parameters + 0x200
        axis = self._axes.get(number)
        sources = {
            "trace": self._node(number).values,
            "rig file": _rig_values(axis.plate_object) if axis else {},
            "EDS": self._names.defaults,
            "CiA 402": _standard_values(),
        }
        source = next((each for each, its in sources.items() if (mapping, 0) in its), "nothing")
        known = sources.get(source, {(mapping, 0): 0})
        entries = [known.get((mapping, sub), 0) for sub in range(1, known[mapping, 0] + 1)]
        name = f"{'T' if first == 0x1800 else 'R'}PDO{parameters - first + 1}"
        carried = tuple(((e >> 16, e >> 8 & 0xFF), e & 0xFF) for e in entries)
        return Pdo(number, name, carried, source)

    def _exchange(self, at: float, pdo: Pdo, data: bytes) -> None:
        node = self._node(pdo.node)
        who = node.name if pdo.name[0] == "T" else HOST
        if who != HOST:
            node.frames["PDO"] += 1
        stream = f"{pdo.name} of {node.name}"
        self._times[stream].append(at)
        if 8 * len(data) != pdo.bits:
            if self._lengths.get(stream) != len(data):
                self._lengths[stream] = len(data)
                fits = f"{pdo.bits} bits by {pdo.source}: not decoded"
                self._say(at, who, "PDO", f"{stream}: {len(data)} bytes {data.hex(' ')}, {fits}")
            return
        packed = int.from_bytes(data, "little")
        for key, bits in pdo.entries:
            value, packed = packed & (1 << bits) - 1, packed >> bits
            if self._names[key].type[0] == "I" and value >> bits - 1:
                value -= 1 << bits
            series = self.series.get((pdo.node, key))
            if series is None:
                series = self.series[pdo.node, key] = Series(array("d"), array("q"))
            if key[0] in _TOLD and (not series.counts or series.counts[-1] != value):
                self._changed(at, who, pdo, key, value)
            series.time.append(at)
            series.counts.append(value)

    def _changed(self, at: float, who: str, pdo: Pdo, key: Key, value: int) -> None:
        """Tell what a PDO says that is not what it said before."""
        words = self.words(pdo.node, key, value)
        meaning = words.partition(" (")[0]
        if key[0] == STATUS:
            self._power(at, pdo.node, value)
        if self._last.get((pdo.node, key)) != meaning:
            self._last[pdo.node, key] = meaning
            to = "" if who != HOST else f" to {self.called(pdo.node)}"
            self._say(at, who, "PDO", f"{self._object(key)}{to}: {words}")

    def _request(self, at: float, number: int, data: bytes) -> None:
        """Take in what a client sends to a node: CiA 301's command specifier is in bits 5 to 7."""
        if len(data) != 8:
            return
        command, key = data[0] >> 5, (data[1] | data[2] << 8, data[3])
        under_way = self._sdo.get(number)
        if command == 0 and under_way is not None:
            under_way.data += data[1 : 8 - (data[0] >> 1 & 7)]
            under_way.segmented = not data[0] & 1
        elif command == 4:
            self._sdo.pop(number, None)
            self._abort(at, number, _Transfer(at, key, writes=False), data)
        elif command in {1, 2, 5, 6}:
            if under_way is not None:
                self._unanswered(number, under_way)
            made = self._sdo[number] = _Transfer(at, key, writes=command in {1, 6})
            made.block = command > 4
            if command == 1 and data[0] & 2:
                size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else self._names[key].bits // 8 or 4
                made.data = data[4 : 4 + size]
            made.segmented = command == 1 and not data[0] & 2

    def _response(self, at: float, number: int, data: bytes) -> None:
        transfer = self._sdo.get(number)
        if len(data) != 8 or transfer is None:
            return
        command = data[0] >> 5
        if command == 4:
            self._abort(at, number, self._sdo.pop(number), data)
        elif transfer.block:
            self._done(at, number, self._sdo.pop(number))
        elif command == 2 and data[0] & 2:
            size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
            transfer.data = data[4 : 4 + size]
            self._done(at, number, self._sdo.pop(number))
        elif command == 0:
            transfer.data += data[1 : 8 - (data[0] >> 1 & 7)]
            if data[0] & 1:
                self._done(at, number, self._sdo.pop(number))
        elif command in {1, 3} and not transfer.segmented:
            self._done(at, number, self._sdo.pop(number))

    def _done(self, at: float, number: int, transfer: _Transfer) -> None:
        node, key, known = self._node(number), transfer.key, self._names[transfer.key]
        node.transfers["writes" if transfer.writes else "reads"] += 1
        data = transfer.data
        if transfer.block:
            said = "a block, not decoded"
        elif not data or len(data) > 4 or (not known.bits and len(data.rstrip(b"\0")) > 4):
            said = data.rstrip(b"\0").decode("latin-1")
            said = f'"{said}"' if said.isprintable() else data.hex(" ")
        else:
            value = node.values[key] = known.decode(data)
            said = self.words(number, key, value)
            if _PDOS[0] <= key[0] < _PDOS[1]:
                self._assign(number, key[0] & ~0x200)
            elif key[0] == STATUS:
                self._power(at, number, value)
            elif key[0] == 0x2001 and key[1] and value:
                node.faults.append((at, said))
        verb, way = ("writes", "to") if transfer.writes else ("reads", "of")
        text = f"{verb} {self._object(key)} {way} {node.name}: {said}"
        written, self._written = self._written, (number, key, said) if transfer.writes else None
        if not transfer.writes and written == (number, key, said):
            last = self.events[-1]
            self.events[-1] = last._replace(text=f"{last.text}; read back")
        else:
            self._say(transfer.since, HOST, "SDO", text)

    def _assign(self, number: int, parameters: int) -> None:
        """Take note of the identifier and mapping of a PDO, as far as they are known now."""
        pdo = self._assigned(number, parameters)
        base = frames.RPDO1 if parameters < 0x1800 else frames.TPDO1
        usual = base + 0x100 * (parameters & 3) + number
        cob_id = self._node(number).values.get((parameters, 1), usual)
        if not cob_id & PDO_INVALID:
            self._pdos[cob_id & 0x7FF] = pdo

    def _abort(self, at: float, number: int, transfer: _Transfer, data: bytes) -> None:
        self._node(number).transfers["refused"] += 1
        verb = "writing" if transfer.writes else "reading"
        why = dictionary.abort_words(int.from_bytes(data[4:], "little"))
        text = f"{verb} {self._object(transfer.key)} refused: {why}"
        self._say(at, self.called(number), "SDO", text)

    def _unanswered(self, number: int, transfer: _Transfer) -> None:
        self._node(number).transfers["unanswered"] += 1
        verb = "writes" if transfer.writes else "reads"
        text = f"{verb} {self._object(transfer.key)} of {self.called(number)}: no answer"
        self._say(transfer.since, HOST, "SDO", text)

    def _find_gaps(self) -> None:
        """Find where what comes regularly did not; of PDOs only where SYNC came."""
        missing: list[tuple[float, float]] = []
        for stream in sorted(self._times, key=lambda each: each != "SYNC"):
            times = np.asarray(self._times[stream])
            if len(times) < _FEW:
                continue
            pauses = np.diff(times)
            usual = float(np.median(pauses))
            gaps = np.flatnonzero(pauses > _LONG * usual)
            if len(gaps) > _IRREGULAR * len(pauses):
                continue
            found = [(float(times[at]), float(times[at + 1])) for at in gaps]
            rest = self.duration - float(times[-1])
            longest = max((b - a for a, b in found), default=0.0)
            self.pauses[stream] = {"usual": usual, "gaps": len(found), "longest": longest}
            if stream == "SYNC":
                missing = found
            elif not stream.startswith("heartbeat"):
                found = [g for g in found if not any(a < g[1] and g[0] < b for a, b in missing)]
            for begin, end in sorted(found, key=lambda gap: gap[0] - gap[1])[:_MOST]:
                text = (
                    f"no {stream} for {1e3 * (end - begin):.3g} ms (usually {1e3 * usual:.3g} ms)"
                )
                self._say(begin, stream.partition(" of ")[2] or HOST, "gap", text)
            if rest > max(_ENDED * usual, _ENDED_FOR):
                text = f"no {stream} from here on (usually every {1e3 * usual:.3g} ms)"
                self._say(float(times[-1]), stream.partition(" of ")[2] or HOST, "gap", text)


@cache
def _rig_values(plate: Key) -> dict[Key, int]:
    """The mapping objects of a drive as the host sets them, with its plate encoder's object."""
    known, maps = dictionary.objects(), frames.pdo_maps(plate).items()
    return _values(
        {at: [i << 16 | s << 8 | known[i, s].bits for i, s in each] for at, each in maps}
    )


@cache
def _standard_values() -> dict[Key, int]:
    """The mapping objects of CiA 402's default PDOs."""
    return _values({int(key, 16): entries for key, entries in table()["defaults"].items()})


def _values(mappings: Mapping[int, Sequence[int]]) -> dict[Key, int]:
    """Mappings, by the index of the PDO's parameters, as the objects that hold them."""
    return {
        (parameters + 0x200, sub): value
        for parameters, entries in mappings.items()
        for sub, value in enumerate((len(entries), *entries))
    }
