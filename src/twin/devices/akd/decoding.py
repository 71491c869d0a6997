"""What the frames of a trace say: any CANopen devices, drives of CiA 402 in words.

What a PDO carries is taken from the trace itself, where its mapping is written or read; else from
the rig file, from an EDS file, or, where the length fits, from what CiA 402 has as default.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np

from twin.base.errors import LogError
from twin.devices.akd import protocol
from twin.devices.akd.config import RPM, TURN, AkdConfig
from twin.devices.akd.protocol import Key, Object, mappings, table
from twin.devices.common import one_line
from twin.hal.interface import NOMINAL_PERIOD

CONTROL, STATUS, PLACE, SPEED, TARGET = 0x6040, 0x6041, 0x6064, 0x606C, 0x60FF
_TOLD = {CONTROL, STATUS, 0x6060, 0x6061, 0x603F, 0x1001, 0x60FD, 0x2001}
"""Objects whose every change in a PDO is told."""
_POSITIONS = (0x6062, 0x6063, PLACE, 0x607A, 0x60F4)
_VELOCITIES = (0x606B, SPEED, TARGET)
AKD = 0x6A
"""Vendor whose drives count velocities in 0.001 rpm."""
_KINDS = {0x080: "EMCY", 0x580: "SDO", 0x600: "SDO", 0x700: "heartbeat"}
_IRREGULAR = 0.05
"""Share of long pauses from which a sequence of frames is no regular one."""
_LONG = 1.6
"""Times the usual pause from which one is a gap."""
_FEW, _MOST = 10, 20
"""Fewest frames in which a rhythm is seen; most gaps of one kind that are told, the longest."""
_ENDED, _ENDED_FOR = 5, 0.05
"""Times the usual pause, and s, from which something has ended before the trace does."""
_SEGMENT, _DOWNLOAD, _UPLOAD, _ABORT, _BLOCK_UPLOAD, _BLOCK_DOWNLOAD = 0, 1, 2, 4, 5, 6
"""Command specifiers of SDO: reading is an upload, writing a download."""
_SIZED, _EXPEDITED = 1, 2
"""Bits of the specifier that begins a transfer: its size is told; all data are in this frame."""
_BLOCKS, _WRITING = (_BLOCK_UPLOAD, _BLOCK_DOWNLOAD), (_DOWNLOAD, _BLOCK_DOWNLOAD)
_UNANSWERED = "unanswered", "no answer"
_WORDS = {STATUS: protocol.status_words, CONTROL: protocol.control_words}
HOST = "host"
"""Who sends what only a master sends."""


def sync_period(frames: Sequence[can.Message]) -> float:
    """The period in s, in whole ms, of the SYNCs of a trace; the nominal one if there are few."""
    times = [each.timestamp for each in frames if each.arbitration_id == protocol.SYNC]
    if len(times) <= _FEW:
        return NOMINAL_PERIOD
    return max(1, round(1e3 * float(np.median(np.diff(times))))) / 1e3


class TracedEvent(NamedTuple):
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


class Pdo(NamedTuple):
    """What a PDO carries.

    Attributes:
        node: Whose it is.
        name: ``TPDO1``, ``RPDO2``, ...
        entries: Its objects and their bits, in order.
    """

    node: int
    name: str
    entries: tuple[tuple[Key, int], ...]


class Names(dict[Key, Object]):
    """What objects are called: by an EDS file, else as the standards and an AKD have them.

    One that nobody knows is called by its index.

    Args:
        eds: The file, EDS or DCF.

    Raises:
        LogError: If it cannot be read.
    """

    def __init__(self, eds: Path | None = None) -> None:
        standard = [Object(*each) for each in table()["standard"]]
        super().__init__({(each.index, each.sub): each for each in standard} | protocol.objects())
        self.defaults: dict[Key, int] = {}
        """Default values that the file gives for mappings of PDOs."""
        if eds is None:
            return
        from canopen.objectdictionary import ODVariable, datatypes, import_od  # noqa: PLC0415

        try:
            found = import_od(str(eds), node_id=None).values()
        except Exception as error:
            raise LogError(f"--eds {eds}: not a readable EDS file: {one_line(error)}") from error
        for one in found:
            for each in [one] if isinstance(one, ODVariable) else one.values():
                key = each.index, each.subindex
                sign = "I" if each.data_type in datatypes.SIGNED_TYPES else "U"
                self[key] = Object(*key, each.qualname.replace(".", ": "), f"{sign}{len(each)}")
                if key[0] in protocol.PDOS and key[0] & 0x200 and isinstance(each.default, int):
                    self.defaults[key] = each.default

    def __missing__(self, key: Key) -> Object:
        return Object(*key, "", "U0")


@dataclass
class Node:
    """What a node did.

    Attributes:
        name: What it is called.
        frames: How many it sent, by kind.
        states: Its NMT states, in order.
        drive: The states of its power stage, in order.
        faults: What it reported: ``time`` in s and ``text``.
        transfers: SDO transfers by how they ended.
    """

    name: str
    frames: Counter[str] = field(default_factory=Counter)
    states: list[str] = field(default_factory=list)
    drive: list[str] = field(default_factory=list)
    faults: list[dict[str, Any]] = field(default_factory=list)
    transfers: Counter[str] = field(default_factory=Counter)


class Series(NamedTuple):
    """Values of an object in the PDOs of a node: s since the first frame, whole counts."""

    time: array[float]
    counts: array[int]


@dataclass
class _Transfer:
    """An SDO transfer under way: since when, its object, whether it writes, what has come.

    ``more`` says that data are still to come.
    """

    since: float
    key: Key
    writes: bool
    block: bool
    data: bytes = b""
    more: bool = True


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
        self.events: list[TracedEvent] = []
        """What was said, in order; of PDOs the changes."""
        self.nodes: dict[int, Node] = {}
        """Nodes that sent something, by number."""
        self.series = defaultdict[tuple[int, Key], Series](lambda: Series(array("d"), array("q")))
        """What PDOs carried, by node and object."""
        self.begin = heard[0].timestamp
        """Time of the first frame, s, as the trace has it."""
        self.duration = heard[-1].timestamp - self.begin
        """Seconds from the first frame to the last."""
        self.strangers: Counter[int] = Counter()
        """Frames of no service of CANopen, by identifier."""
        self.pauses: dict[str, dict[str, Any]] = {}
        """Of what came regularly: its usual pause in s, its gaps and the longest."""
        self._names = names or Names()
        self._axes = {axis.node: axis for axis in rig.axes} if rig else {}
        self._times: defaultdict[str, array[float]] = defaultdict(lambda: array("d"))
        self._sdo: dict[int, _Transfer] = {}
        self.pdos: dict[int, Pdo] = {}
        """PDOs by their identifier, as the trace has them at its end."""
        self._last: dict[object, object] = {}
        # what the trace does not show: the standard, the maker's file, the rig's
        known = (
            mappings({int(at, 16): each for at, each in table()["defaults"].items()})
            | self._names.defaults
        )
        self.values = defaultdict[int, dict[Key, int]](known.copy)
        """What objects of nodes hold at its end, as far as it was read or written."""
        for axis in self._axes.values():
            self.values[axis.node] |= mappings(protocol.pdo_maps(axis.plate_object))
        for message in heard:
            self._take(message, message.timestamp - self.begin)
        for node, left in sorted(self._sdo.items()):
            self._ended(node, left, *_UNANSWERED)
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
        axis, values, index = self._axes.get(node), self.values[node], key[0]
        turn = values.get((0x608F, 1))
        if axis is not None and key == axis.plate_object:
            return axis.plate, "rad"
        if index in _POSITIONS and axis is not None:
            return axis.position, "rad"
        if index in _POSITIONS and turn:
            return TURN * values.get((0x608F, 2), 1) / turn, "rad"
        if index in _VELOCITIES and (axis or values.get((0x1018, 1)) == AKD):
            return axis.velocity if axis else 0.001 * RPM, "rad/s"
        return 1.0, ""

    def words(self, node: int, key: Key, value: int) -> str:
        """A value of an object in words."""
        index, sub = key
        factor, unit = self.scale(node, key)
        of_pdo, maps = index in protocol.PDOS, bool(index & 0x200)
        said = f"{value}" if abs(value) < 1 << 16 else f"{value} ({value & 0xFFFFFFFF:X}h)"
        if index in _WORDS:
            said = f"{_WORDS[index](value)} ({value:04X}h)"
        elif index in {0x6060, 0x6061}:
            said = table()["modes"].get(f"{value}", f"mode {value}")
        elif index == 0x1016 and sub and value:
            said = f"node {value >> 16 & 0x7F} within {value & 0xFFFF} ms"
        elif of_pdo and not maps and sub == 1:
            said = f"{value & 0x7FF:03X}h{' off' if value & protocol.PDO_INVALID else ''}"
        elif of_pdo and maps and sub and value:
            carried, bits = _mapped(value)
            said = f"{self.object_name(carried)}, {bits} bits"
        elif index == 0x2001 and sub and value:
            said = protocol.fault_words([value])
        elif unit:
            said = f"{value * factor:.6g} {unit}"
        return said

    def summary(self) -> dict[str, Any]:
        """What ``--json`` prints, but for the events."""
        nodes = {f"{each}": {**vars(node), "signals": {}} for each, node in self.nodes.items()}
        for (number, key), series in self.series.items():
            if key[0] not in _TOLD:
                factor, unit = self.scale(number, key)
                ends = sorted(factor * each(series.counts) for each in (min, max))
                its = {"from": ends[0], "to": ends[1], "unit": unit}
                nodes[f"{number}"]["signals"][self.object_name(key)] = its
        pdos = {
            f"{cob_id:03X}h": pdo._asdict()
            | {"entries": [self.object_name(k) for k, _ in pdo.entries]}
            for cob_id, pdo in self.pdos.items()
        }
        strangers = {f"{each:03X}h": count for each, count in self.strangers.items()}
        return {"begin": self.begin, "duration": self.duration, "nodes": nodes, "pdos": pdos} | {
            "regular": self.pauses,
            "strangers": strangers,
        }

    def object_name(self, key: Key) -> str:
        """What an object is called."""
        name = self._names[key].name
        return f"{key[0]:04X}h{f':{key[1]}' if key[1] else ''}{f' {name}' if name else ''}"

    def _node(self, number: int) -> Node:
        return self.nodes.setdefault(number, Node(self.called(number)))

    def _new(self, what: object, value: object) -> bool:
        """Whether something is not as it was when this was asked last."""
        before, self._last[what] = self._last.get(what), value
        return value != before

    def _say(self, at: float, who: str, kind: str, text: str) -> None:
        self.events.append(TracedEvent(at, who, kind, text))

    def _take(self, message: can.Message, at: float) -> None:
        identifier, data = message.arbitration_id, bytes(message.data)
        if message.is_error_frame:
            self._say(at, "adapter", "bus", f"error frame {identifier:03X}h {data.hex(' ')}")
        elif message.is_extended_id:
            self.strangers[identifier] += 1
        elif identifier == protocol.NMT and len(data) == 2:
            whom = self.called(data[1]) if data[1] else "all nodes"
            command = table()["nmt_commands"].get(f"{data[0]}", f"command {data[0]}")
            self._say(at, HOST, "NMT", f"{command}: {whom}")
        elif identifier == protocol.SYNC:
            self._times["SYNC"].append(at)
        elif not message.is_remote_frame:
            self._service(at, identifier, data)

    def _service(self, at: float, identifier: int, data: bytes) -> None:
        number = identifier & protocol.NODE_MASK
        service = identifier - number
        kind = _KINDS.get(service)
        pdo = self._pdo(identifier)
        if pdo is not None:
            self._exchange(at, pdo, data)
        elif kind is None or not number:
            self.strangers[identifier] += 1
        elif service == protocol.SDO_REQUEST:
            self._transfer(at, number, data, asks=True)
        else:
            node = self._node(number)
            node.frames[kind] += 1
            if service == protocol.EMERGENCY:
                message = protocol.decode_emergency(data)
                self._say(at, node.name, kind, message.words)
                if message.code:
                    node.faults.append({"time": at, "text": message.words})
            elif service == protocol.SDO_RESPONSE:
                self._transfer(at, number, data, asks=False)
            elif (state := protocol.decode_nmt_state(data)) is not None:
                self._heartbeat(at, node, state)

    def _heartbeat(self, at: float, node: Node, state: int) -> None:
        words = protocol.nmt_words(state)
        if state:
            self._times[f"heartbeat of {node.name}"].append(at)
        if not state or node.states[-1:] != [words]:
            node.states.append(words)
            self._say(at, node.name, "heartbeat", words)

    def _power(self, at: float, number: int, status: int) -> None:
        """Note the state that a status word shows."""
        node, state = self._node(number), protocol.state(status)
        if node.drive[-1:] != [state.value]:
            node.drive.append(state.value)
            if state is protocol.DriveState.FAULT:
                node.faults.append({"time": at, "text": self.words(number, (STATUS, 0), status)})

    def _pdo(self, identifier: int) -> Pdo | None:
        """The PDO of an identifier; None if it is another service's."""
        number = identifier & protocol.NODE_MASK
        first, last = protocol.TPDO1, protocol.SDO_RESPONSE
        if identifier not in self.pdos and number and first <= identifier < last:
            place, receives = divmod(identifier - number - first, 0x100)
            parameters = (0x1400 if receives else 0x1800) + place
            self.pdos[identifier] = self._assigned(number, parameters)
        return self.pdos.get(identifier)

    def _assigned(self, number: int, parameters: int) -> Pdo:
        """What a PDO of a node carries, as far as it is known now."""
        mapping, values = parameters + 0x200, self.values[number]
        count = values.get((mapping, 0), 0) & 0xFF
        entries = [_mapped(values.get((mapping, sub), 0)) for sub in range(1, count + 1)]
        name = f"{'T' if parameters >= 0x1800 else 'R'}PDO{(parameters & 0x1FF) + 1}"
        return Pdo(number, name, tuple(entries))

    def _exchange(self, at: float, pdo: Pdo, data: bytes) -> None:
        node = self._node(pdo.node)
        who = node.name if pdo.name[0] == "T" else HOST
        if who != HOST:
            node.frames["PDO"] += 1
        stream = f"{pdo.name} of {node.name}"
        self._times[stream].append(at)
        mapped = sum(bits for _, bits in pdo.entries)
        if 8 * len(data) != mapped:
            if self._new(stream, len(data)):
                known = f"{mapped} bits are known: not decoded"
                self._say(at, who, "PDO", f"{stream}: {len(data)} bytes {data.hex(' ')}, {known}")
            return
        packed = int.from_bytes(data, "little")
        for key, bits in pdo.entries:
            value, packed = packed & (1 << bits) - 1, packed >> bits
            if self._names[key].type[0] == "I" and value >> bits - 1:
                value -= 1 << bits
            series = self.series[pdo.node, key]
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
        if self._new((pdo.node, key), meaning):
            to = "" if who != HOST else f" to {self.called(pdo.node)}"
            self._say(at, who, "PDO", f"{self.object_name(key)}{to}: {words}")

    def _transfer(self, at: float, number: int, data: bytes, *, asks: bool) -> None:
        """Take in what a client asks of a node, or what that answers.

        CiA 301 has the command specifier in bits 5 to 7 of the first byte.
        """
        if len(data) != 8:
            return
        command, transfer = data[0] >> 5, self._sdo.get(number)
        writes, block = command in _WRITING, command in _BLOCKS
        if asks and (writes or block or command == _UPLOAD):
            if transfer is not None:
                self._ended(number, transfer, *_UNANSWERED)
            key = data[1] | data[2] << 8, data[3]
            transfer = self._sdo[number] = _Transfer(at, key, writes, block)
        if transfer is None:
            return
        if command == _ABORT:
            why = protocol.abort_words(int.from_bytes(data[4:], "little"))
            self._ended(number, self._sdo.pop(number), "refused", f"refused, {why}")
            return
        if command == _SEGMENT:
            transfer.data += data[1 : 8 - (data[0] >> 1 & 7)]
            transfer.more = not data[0] & 1
        elif command == (_DOWNLOAD if asks else _UPLOAD) and data[0] & _EXPEDITED:
            size = self._names[transfer.key].bits // 8 or 4
            transfer.data = (
                data[4 : 8 - (data[0] >> 2 & 3)] if data[0] & _SIZED else data[4:][:size]
            )
            transfer.more = False
        if not asks and (transfer.block or not transfer.more):
            self._done(at, number, self._sdo.pop(number))

    def _done(self, at: float, number: int, transfer: _Transfer) -> None:
        key, known, data = transfer.key, self._names[transfer.key], transfer.data
        bare = data.rstrip(b"\0")
        if transfer.block:
            said = "a block, not decoded"
        elif not data or len(data) > 4 or (not known.bits and len(bare) > 4):
            text = bare.decode("latin-1")
            said = f'"{text}"' if text.isprintable() else data.hex(" ")
        else:
            value = self.values[number][key] = known.decode(data)
            said = self.words(number, key, value)
            if key[0] in protocol.PDOS:
                self._assign(number, key[0] & ~0x200)
            elif key[0] == STATUS:
                self._power(at, number, value)
            elif key[0] == 0x2001 and key[1] and value:
                self._node(number).faults.append({"time": at, "text": said})
        self._ended(number, transfer, "writes" if transfer.writes else "reads", said)

    def _ended(self, number: int, transfer: _Transfer, how: str, said: str) -> None:
        """Tell a transfer; what is read back as it was just written is part of that."""
        node, what = self._node(number), self.object_name(transfer.key)
        node.transfers[how] += 1
        written = f"writes {what} to {node.name}: {said}"
        text = written if transfer.writes else f"reads {what} of {node.name}: {said}"
        if how == "reads" and self.events and self.events[-1].text == written:
            self.events[-1] = self.events[-1]._replace(text=f"{written}; read back")
        else:
            self._say(transfer.since, HOST, "SDO", text)

    def _assign(self, number: int, parameters: int) -> None:
        """Take note of the identifier and mapping of a PDO, as far as they are known now."""
        base = protocol.RPDO1 if parameters < 0x1800 else protocol.TPDO1
        place = parameters & 0x1FF
        usual = base + 0x100 * place + number if place < 4 else protocol.PDO_INVALID
        cob_id = self.values[number].get((parameters, 1), usual)
        if not cob_id & protocol.PDO_INVALID:
            self.pdos[cob_id & 0x7FF] = self._assigned(number, parameters)

    def _find_gaps(self) -> None:
        """Find where what comes regularly did not; of PDOs only where SYNC came."""
        missing: list[tuple[float, float]] = []
        for stream in sorted(self._times, key=lambda each: each != "SYNC"):
            times = np.asarray(self._times[stream])
            if len(times) < _FEW:
                continue
            pauses = np.diff(times)
            usual, last = float(np.median(pauses)), float(times[-1])
            gaps = np.flatnonzero(pauses > _LONG * usual)
            if len(gaps) > _IRREGULAR * len(pauses):
                continue
            longest = float(pauses[gaps].max(initial=0.0))
            self.pauses[stream] = {"usual": usual, "gaps": len(gaps), "longest": longest}
            found = list(zip(times[gaps].tolist(), times[gaps + 1].tolist(), strict=True))
            if stream == "SYNC":
                missing = found
            elif not stream.startswith("heartbeat"):
                found = [g for g in found if not any(a < g[1] and g[0] < b for a, b in missing)]
            who = stream.partition(" of ")[2] or HOST
            often = f"usually every {1e3 * usual:.3g} ms"
            for begin, end in sorted(found, key=lambda gap: gap[0] - gap[1])[:_MOST]:
                text = f"no {stream} for {1e3 * (end - begin):.3g} ms ({often})"
                self._say(begin, who, "gap", text)
            if self.duration - last > max(_ENDED * usual, _ENDED_FOR):
                self._say(last, who, "gap", f"no {stream} from here on ({often})")


def _mapped(entry: int) -> tuple[Key, int]:
    """The object that an entry of a mapping names, and its bits."""
    return (entry >> 16, entry >> 8 & 0xFF), entry & 0xFF
