"""Decodes the frames of a trace, of any CANopen devices: events in words, and observations as data.

Each frame belongs to a service: NMT, SYNC, PDO, SDO, emergency or heartbeat. What a PDO carries is
known from the mappings in the trace, else from the rig file, from an EDS or DCF file, or, where the
length fits, from the defaults of CiA 402 (`pdo_table`). Values are decoded by the types of their
objects (`object_dictionaries`).
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from twin.base.errors import plural
from twin.devices.akd import protocol
from twin.devices.akd.node_settings import NodeSettings
from twin.devices.akd.object_dictionaries import ObjectDictionaries
from twin.devices.akd.object_names import FAULTS, STATUS, Names, axis_of
from twin.devices.akd.observed import (
    BUS,
    Change,
    Command,
    EmergencyReport,
    ErrorFrame,
    Gap,
    Observed,
    StrayAnswer,
    StreamKey,
    Transfer,
)
from twin.devices.akd.pdo_table import Pdo, PdoTable
from twin.devices.akd.protocol import Key, table
from twin.devices.akd.rhythms import find_rhythms, without_missing_sync
from twin.devices.akd.sdo_transfers import (
    ABORT,
    BLOCK_DOWNLOAD,
    DOWNLOAD,
    DOWNLOAD_ANSWER,
    FIRST_BYTES,
    UPLOAD,
    OpenTransfer,
    begins_block,
)
from twin.devices.akd.wire_values import (
    decode_number,
    decode_value,
    error_words_of,
    find_identities,
    list_foreign,
    longest_bits,
)

if TYPE_CHECKING:
    from twin.devices.akd.config import AkdConfig
    from twin.devices.akd.trace_files.frames import BusFrame

_FRAME_KINDS = {0x080: "EMCY", 0x580: "SDO", 0x600: "SDO", 0x700: "heartbeat"}
"""Service to the kind of its frames in events and counts."""
_MAX_REPORTED_GAPS = 20
"""Most gaps of one stream that are reported, the longest."""
_NAMING_SPECIFIERS = (UPLOAD, DOWNLOAD_ANSWER, ABORT)
"""Command specifiers of answers that name their object."""
_SDO_BYTES, _MIN_SDO_BYTES = 8, 4
"""Length of every SDO frame by CiA 301, and the least that names an object."""
_FIRST_INDEX = 0x1000
"""Lowest index of an object that is no data type."""
_MAX_SHOWN_BYTES = 64
"""Bytes of a value that are shown; of a longer one their number is, too."""
_MAX_OPEN_TRANSFERS = 50
"""Transfers back in which the request of a late answer is looked for."""
_SHORT_S = 0.2
"""Time in s below which one is given in ms."""
HOST = "host"
"""Sender of frames that only a master sends."""


class TracedEvent(NamedTuple):
    """An event on the bus.

    Attributes:
        time: Seconds since the first frame.
        who: The sender.
        kind: NMT, SDO, PDO, EMCY, heartbeat, SYNC or bus.
        text: What, in words.
        frame: Number of the frame, from 1.
    """

    time: float
    who: str
    kind: str
    text: str
    frame: int = 0


@dataclass
class Node:
    """A node, and the counts of its frames and services.

    Attributes:
        name: Its name.
        frames: How many it sent, by kind.
        states: Its NMT states, in order.
        drive: The states of its power stage, in order; of a drive of several axes the first's.
        axes: Those of its further axes, by their number.
        faults: The faults it reported: ``time`` in s and ``text``.
        transfers: SDO transfers by how they ended.
    """

    name: str
    frames: Counter[str] = field(default_factory=Counter)
    states: list[str] = field(default_factory=list)
    drive: list[str] = field(default_factory=list)
    axes: dict[int, list[str]] = field(default_factory=dict)
    faults: list[dict[str, Any]] = field(default_factory=list)
    transfers: Counter[str] = field(default_factory=Counter)


class Conversation:
    """All that the frames of one channel say.

    Args:
        heard: The frames, in the order of their times.
        names: What objects are called.
        rig: The owner of the drives, for names, scales and mappings that the trace does not show.
        timed: Whether the frames have times; where they have none, nothing is late or missing.
    """

    def __init__(
        self,
        heard: Sequence[BusFrame],
        names: Names | None = None,
        rig: AkdConfig | None = None,
        *,
        timed: bool = True,
    ) -> None:
        self.events: list[TracedEvent] = []
        """The events, in order; of PDOs the changes."""
        self.nodes: dict[int, Node] = {}
        """Nodes that sent something, by number."""
        self.begin = heard[0].timestamp - (0.0 if timed else 1.0)  # frames are numbered from 1
        """Time of the first frame, s, as the trace has it."""
        self.duration = heard[-1].timestamp - self.begin
        """Seconds from the first frame to the last."""
        self.strangers: Counter[int] = Counter()
        """Frames of no service of CANopen, by identifier."""
        self.long_identifiers: Counter[int] = Counter()
        """Those of 29 bits among them."""
        self.errors: Counter[str] = Counter()
        """Error frames by what they say."""
        foreign, echoes = list_foreign(heard)
        self.observed = Observed(foreign=foreign)
        """The observations in the frames, as data."""
        self.echoes = len(echoes)
        """Frames that the adapter handed back to its host; they are left out."""
        self.timed = timed
        """Whether the frames have times, or their numbers instead."""
        self.names = names or Names()
        """What objects are called."""
        self._axes = {axis.node: axis for axis in rig.axes} if rig else {}
        self._frame = 0
        self._sdo: dict[int, OpenTransfer] = {}
        self._settings = NodeSettings()
        self._asked: set[int] = set()  # for their life (node guarding), and have not answered
        self._last: dict[object, object] = {}
        self._requests: Counter[bool] = Counter()
        self.bitrate: int | None = rig.bus.bitrate if rig else None
        """Bit rate of the bus in bit/s; None if it is not known."""
        there, identities = find_identities(heard)
        self.objects = ObjectDictionaries(self.names, rig, identities, self.observed.changes)
        """What the nodes' objects are, and hold at its end."""
        node_of_sheet = self.names.sheet.node or 0
        self._table = PdoTable(self.objects, self._settings, there, node_of_sheet)
        self.pdos = self._table.by_identifier
        """PDOs by their identifier, as the trace has them at its end."""
        self.series = self._table.series
        """What PDOs carried, by node and object."""
        for self._frame, message in enumerate(heard, 1):
            is_echo, at = self._frame in echoes, message.timestamp - self.begin
            self.observed.times.append(at)
            self.observed.bits.append(0 if is_echo else longest_bits(message))
            if not is_echo:
                self._take(message, at)
        self._conclude(heard)

    @property
    def is_canopen(self) -> bool:
        """Whether the bus is one of CANopen.

        PDOs and emergencies alone are no sign of it, as frames of any protocol may have their
        identifiers: it is one if no frame has an identifier or a length that CANopen does not have.
        """
        seen = self.observed
        answered = any(each.end is not None for each in seen.transfers)
        return bool(
            self._axes
            or self.names.sheet.objects
            or seen.life
            or seen.guards
            or seen.commands
            or StreamKey(BUS, "SYNC") in seen.streams
            or answered
            or self._requests[True] > self._requests[False]
            or not self.strangers
        )

    def _conclude(self, heard: Sequence[BusFrame]) -> None:
        """Take in what only the end of the trace shows."""
        for node, left in sorted(self._sdo.items()):
            self._left(node, left)
        if not self.is_canopen:
            self._leave_alone(heard)
        if self.timed:
            self._find_gaps()
        self.events.sort(key=lambda each: each.time)

    def _leave_alone(self, heard: Sequence[BusFrame]) -> None:
        """Forget what frames of a different protocol would mean; keep errors and counts."""
        self.nodes.clear()
        self.series.clear()
        self.events = [each for each in self.events if each.kind == "bus"]
        self.observed.streams.clear()
        self.strangers = Counter(each.arbitration_id for each in heard if not each.is_error_frame)

    @property
    def described(self) -> set[int]:
        """Nodes whose settings of PDOs the trace shows."""
        return self._settings.described

    @property
    def sync(self) -> array[float]:
        """When SYNC was sent, s since the first frame."""
        return self.observed.streams[StreamKey(BUS, "SYNC")].time

    def called(self, node: int) -> str:
        """Name of a node."""
        axis = self._axes.get(node)
        return f"node {node}" + (f" ({axis.name})" if axis else "")

    def span(self, seconds: float) -> str:
        """A time in words; without times, the frames that have their place."""
        if not self.timed:
            return plural(round(seconds), "frame")
        return f"{1e3 * seconds:.3g} ms" if seconds < _SHORT_S else f"{seconds:.3g} s"

    def end_of(self, end: float | None) -> float:
        """When something was over, s; what has no such time stands to the end of the trace."""
        return self.duration if end is None else end

    def lasting(self, begin: float, end: float | None) -> str:
        """How long a state lasts between two times in s, in words; None as in `end_of`."""
        when = "to the end of the trace, " if end is None else ""
        return f"{when}for {self.span(self.end_of(end) - begin)}"

    def has_axes(self, node: int) -> bool:
        """Whether a drive has several axes."""
        return node in self.nodes and bool(self.nodes[node].axes)

    def _node(self, number: int) -> Node:
        node = self.nodes.get(number)
        if node is None:
            node = self.nodes[number] = Node(self.called(number))
        return node

    def _new(self, what: object, value: object) -> bool:
        """Whether something is not as it was when this was asked last."""
        before, self._last[what] = self._last.get(what), value
        return value != before

    def _say(self, at: float, who: str, kind: str, text: str) -> None:
        self.events.append(TracedEvent(at, who, kind, text, self._frame))

    def _note(self, at: float, node: int, key: Key, value: int) -> None:
        """Keep a value of an object where it changes."""
        changes = self.observed.changes[node, key]
        if not changes or changes[-1].value != value:
            changes.append(Change(at, self._frame, value))

    def _take(self, message: BusFrame, at: float) -> None:
        identifier, data = message.arbitration_id, bytes(message.data)
        if message.is_error_frame:
            what = error_words_of(identifier, data)
            self.errors[what] += 1
            self.observed.error_frames.append(ErrorFrame(at, self._frame, identifier, what))
            self._say(at, "adapter", "bus", f"error frame: {what}")
        elif message.is_extended_id:
            self.strangers[identifier] += 1
            self.long_identifiers[identifier] += 1
        elif message.is_remote_frame:  # asks for a frame, and carries nothing
            node = identifier - protocol.HEARTBEAT
            if 0 < node <= protocol.NODE_MASK:
                self.observed.guards[node].append(at, self._frame)
                self._asked.add(node)
        elif identifier == protocol.NMT and len(data) == 2 and data[1] <= protocol.NODE_MASK:
            whom = self.called(data[1]) if data[1] else "all nodes"
            command = table()["nmt_commands"].get(f"{data[0]}", f"command {data[0]}")
            self._say(at, HOST, "NMT", f"{command}: {whom}")
            self.observed.commands.append(Command(at, self._frame, data[0], data[1]))
        elif identifier in self._settings.syncs and len(data) <= 1:
            self.observed.streams[StreamKey(BUS, "SYNC")].append(at, self._frame)
        else:
            self._service(at, identifier, data)

    def _service(self, at: float, identifier: int, data: bytes) -> None:
        number = identifier & protocol.NODE_MASK
        service, number = self._settings.moved.get(identifier, (identifier - number, number))
        kind = _FRAME_KINDS.get(service)
        moved = identifier in self._settings.moved
        pdo = None if moved else self._table.find(identifier)
        if pdo is not None:
            self._exchange(at, identifier, pdo, data)
        elif identifier == protocol.TIME and len(data) == protocol.TIME_BYTES:
            if self._new("TIME", True):
                self._say(at, HOST, "TIME", protocol.time_words(data))
        elif identifier in protocol.LSS and len(data) == protocol.LSS_BYTES:
            who = HOST if identifier == protocol.LSS[0] else "a device"
            self._say(at, who, "LSS", protocol.lss_words(data))
        elif kind is None or not number:
            self.strangers[identifier] += 1
        elif service == protocol.SDO_REQUEST:
            self._transfer(at, number, data, asks=True)
        else:
            node = self._node(number)
            guarded = service == protocol.HEARTBEAT and number in self._asked
            node.frames["guard answer" if guarded else kind] += 1
            self.observed.sent_by[number].append(at, self._frame)
            if service == protocol.EMERGENCY:
                message = protocol.decode_emergency(data)
                words = message.in_words(akd=self.objects.is_akd(number))
                self._say(at, node.name, kind, words)
                report = EmergencyReport(at, self._frame, number, message.code, words)
                self.observed.emergencies.append(report)
                if message.code:
                    node.faults.append({"time": at, "text": words})
            elif service == protocol.SDO_RESPONSE:
                self._transfer(at, number, data, asks=False)
            elif (state := protocol.decode_nmt_state(data)) is not None:
                self.observed.life[number].append(Change(at, self._frame, data[0]))
                self._heartbeat(at, number, state)

    def _heartbeat(self, at: float, number: int, state: int) -> None:
        node, words = self._node(number), protocol.nmt_words(state)
        if state and number not in self._asked:  # what is asked for is regular only as the asking
            self.observed.streams[StreamKey(number, "heartbeat")].append(at, self._frame)
        self._asked.discard(number)
        if not state or node.states[-1:] != [words]:
            node.states.append(words)
            self.observed.network[number].append(Change(at, self._frame, state))
            self._say(at, node.name, "heartbeat", words)
        if not state:
            self._table.forget(number)

    def _power(self, at: float, number: int, key: Key, status: int) -> None:
        """Note the state that a status word shows."""
        node, state, axis = self._node(number), protocol.state(status), axis_of(key[0])[1]
        self.objects.note_status(number, key[0], status)
        states = node.drive if axis == 1 else node.axes.setdefault(axis, [])
        if states[-1:] != [state.value]:
            states.append(state.value)
            if state is protocol.DriveState.FAULT:
                words = self.objects.words(number, key, status)
                text = words if axis == 1 else f"axis {axis}: {words}"
                node.faults.append({"time": at, "text": text})

    def _exchange(self, at: float, identifier: int, pdo: Pdo, data: bytes) -> None:
        node = self._node(pdo.node)
        who = node.name if pdo.name[0] == "T" else HOST
        if who != HOST:
            node.frames["PDO"] += 1
            self.observed.sent_by[pdo.node].append(at, self._frame)
        key, stream = StreamKey(pdo.node, pdo.name), f"{pdo.name} of {node.name}"
        self.observed.streams[key].append(at, self._frame)
        fits = self._unpack(at, who, pdo, data)
        for other in self._table.receivers(identifier):
            fits |= self._unpack(at, who, other, data)
        if not fits:
            self.observed.misfits[key].append(at, self._frame)
        if not fits and self._new(stream, len(data)):
            known = f"{sum(bits for _, bits in pdo.entries)} bits are known: not decoded"
            self._say(
                at, who, "PDO", f"{stream}: {plural(len(data), 'byte')} {data.hex(' ')}, {known}"
            )

    def _unpack(self, at: float, who: str, pdo: Pdo, data: bytes) -> bool:
        """Take in the values of a PDO; False if its length is different."""
        entries = self._table.layout(pdo, 8 * len(data))
        if entries is None:
            return False
        packed = int.from_bytes(data, "little")
        for entry in entries:
            raw = packed >> entry.first & (1 << entry.bits) - 1
            value = decode_number(entry.type, raw, entry.bits)
            counts = entry.series.counts
            if entry.reports_changes and (not counts or counts[-1] != value):
                self._changed(at, who, pdo, entry.key, int(value))
            entry.series.time.append(at)
            counts.append(value)
        return True

    def _changed(self, at: float, who: str, pdo: Pdo, key: Key, value: int) -> None:
        """Report a value of a PDO that differs from the one before."""
        self._note(at, pdo.node, key, value)
        index, axis = axis_of(key[0])
        if index == STATUS:
            self._power(at, pdo.node, key, value)
        words = meaning = self.objects.words(pdo.node, key, value)
        if index == STATUS:
            passing = protocol.passing_bits(self.objects.mode(pdo.node, axis))
            meaning = self.objects.words(pdo.node, key, value & ~passing)
        meaning = meaning.partition(" (")[0]
        if self._new((pdo.node, key), meaning):
            to = "" if who == self.called(pdo.node) else f" to {self.called(pdo.node)}"
            self._say(at, who, "PDO", f"{self.objects.name(pdo.node, key)}{to}: {words}")

    def _transfer(self, at: float, number: int, data: bytes, *, asks: bool) -> None:
        """Take in what a client asks of a node, or what that answers.

        CiA 301 has the command specifier in bits 5 to 7 of the first byte. A shorter frame that
        names its object is taken as if zeros followed.
        """
        if len(data) != _SDO_BYTES:
            self.observed.short_transfers[number].append(at, self._frame)
            if len(data) < _MIN_SDO_BYTES:
                return
            data = data.ljust(_SDO_BYTES, b"\0")
        command, transfer = data[0] >> 5, self._sdo.get(number)
        if transfer is not None and transfer.take_block(data, asks=asks):
            if not transfer.more:
                self._done(at, number, self._sdo.pop(number))
            return
        block = asks and begins_block(data)
        writes = block if command == BLOCK_DOWNLOAD else command == DOWNLOAD
        if asks and (block or transfer is None):
            index = data[1] | data[2] << 8
            self._requests[(block or data[0] in FIRST_BYTES) and index >= _FIRST_INDEX] += 1
        if asks and (writes or block or command == UPLOAD):
            if transfer is not None:
                self._left(number, transfer)
            key = data[1] | data[2] << 8, data[3]
            transfer = self._sdo[number] = OpenTransfer(at, self._frame, key, writes, block)
        elif not asks and command in _NAMING_SPECIFIERS:
            key = data[1] | data[2] << 8, data[3]
            if transfer is None or key != transfer.key:
                self._answer_late(at, number, key)
                return
            transfer.block &= command != UPLOAD  # the device may answer without blocks
        if transfer is None:
            return
        transfer.answered |= not asks
        if command == ABORT:
            code = int.from_bytes(data[4:], "little")
            how = "given up" if asks else "refused"
            why = f"{how}{' by the host' if asks else ''}, {protocol.abort_words(code)}"
            self._ended(number, self._sdo.pop(number), how, why, at, abort=code, given_up=asks)
            return
        size = (self.objects.find(number, transfer.key).bits + 7) // 8 or 4
        transfer.take(data, size, asks=asks)
        if not asks and not transfer.more:
            self._done(at, number, self._sdo.pop(number))

    def _answer_late(self, at: float, number: int, key: Key) -> None:
        """Assign an answer to an earlier request of that object that had none."""
        transfers = self.observed.transfers
        for k in range(len(transfers) - 1, max(len(transfers) - _MAX_OPEN_TRANSFERS, 0) - 1, -1):
            each = transfers[k]
            if each.node == number and each.key == key and each.end is None:
                frames = (*each.frames, self._frame)
                transfers[k] = each._replace(end=at, frames=frames, overlapped=True)
                return
        self.observed.strays.append(StrayAnswer(at, self._frame, number, key))

    def _done(self, at: float, number: int, transfer: OpenTransfer) -> None:
        key, data = transfer.key, transfer.data
        value = decode_value(self.objects.find(number, key).type, data)
        kept = value if isinstance(value, int) and not transfer.missed else None
        if transfer.missed:
            value_text = "a block, of which the trace lacks a part"
        elif isinstance(value, str):
            value_text = f'"{value}"'
        elif isinstance(value, bytes):
            more = f" ... ({len(value)} bytes)" if len(value) > _MAX_SHOWN_BYTES else ""
            value_text = value[:_MAX_SHOWN_BYTES].hex(" ") + more or "nothing"
        elif isinstance(value, float):
            value_text = self.objects.words(number, key, value)
        else:
            index = axis_of(key[0])[0]
            held = self.objects.values[number]
            self._settings.take(number, key, value, held.get(key), writes=transfer.writes)
            held[key] = value
            if self.objects.reports_changes(number, key):
                self._note(at, number, key, value)
            if index == STATUS and self.objects.is_drive(number):
                self._power(at, number, key, value)
            value_text = self.objects.words(number, key, value)
            if index in protocol.PDO_PARAMETER_INDICES:
                self._table.take(number, key)
            elif index == FAULTS and key[1] and value and self.objects.is_akd(number):
                self._node(number).faults.append({"time": at, "text": value_text})
        how = "writes" if transfer.writes else "reads"
        self._ended(number, transfer, how, value_text, at, value=kept)

    def _left(self, number: int, transfer: OpenTransfer) -> None:
        """Report a transfer that has no end."""
        if transfer.answered:
            self._ended(number, transfer, "unfinished", "begun and not finished")
        else:
            self._ended(number, transfer, "unanswered", "no answer")

    def _ended(
        self,
        number: int,
        transfer: OpenTransfer,
        how: str,
        value_text: str,
        at: float | None = None,
        *,
        abort: int | None = None,
        value: int | None = None,
        given_up: bool = False,
    ) -> None:
        """Report a transfer; what is read back as it was just written is part of that."""
        node, what = self._node(number), self.objects.name(number, transfer.key)
        node.transfers[how] += 1
        frames = (transfer.frame,) if at is None else (transfer.frame, self._frame)
        self.observed.transfers.append(
            Transfer(
                transfer.since,
                at,
                frames,
                number,
                transfer.key,
                transfer.writes,
                abort,
                value,
                unfinished=at is None and transfer.answered,
                given_up=given_up,
            )
        )
        written = f"writes {what} to {node.name}: {value_text}"
        text = written if transfer.writes else f"reads {what} of {node.name}: {value_text}"
        if how == "reads" and self.events and self.events[-1].text == written:
            self.events[-1] = self.events[-1]._replace(text=f"{written}; read back")
        else:
            self._say(transfer.since, HOST, "SDO", text)

    def label(self, stream: StreamKey) -> str:
        """Name of a stream."""
        return f"{stream.name} of {self.called(stream.node)}" if stream.node else stream.name

    def _find_gaps(self) -> None:
        """Find where what comes regularly did not; of PDOs only where SYNC came."""
        missing_sync: list[Gap] = []
        for stream, rhythm in find_rhythms(self.observed.streams, self.duration):
            self.observed.rhythms[stream] = rhythm
            if stream.node == BUS:
                missing_sync = rhythm.gaps
            gaps = without_missing_sync(stream, rhythm.gaps, missing_sync)
            self._say_gaps(stream, rhythm.usual, gaps)

    def _say_gaps(self, stream: StreamKey, usual: float, gaps: list[Gap]) -> None:
        """Report the longest gaps of a stream."""
        name, often = self.label(stream), f"usually every {1e3 * usual:.3g} ms"
        who = self.called(stream.node) if stream.node else HOST
        lengths = {gap: gap.end - gap.begin for gap in gaps if gap.end is not None}
        for gap in sorted(lengths, key=lambda each: -lengths[each])[:_MAX_REPORTED_GAPS]:
            text = f"no {name} for {1e3 * lengths[gap]:.3g} ms ({often})"
            self.events.append(TracedEvent(gap.begin, who, "gap", text, gap.frame))
        for gap in gaps:
            if gap.end is None:
                text = f"no {name} from here on ({often})"
                self.events.append(TracedEvent(gap.begin, who, "gap", text, gap.frame))
