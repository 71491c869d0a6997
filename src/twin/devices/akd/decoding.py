"""Decodes the frames of a trace: any CANopen devices, drives of CiA 402 in words.

What a PDO carries is taken from the trace itself, where its mapping is written or read; else from
the rig file, from an EDS or DCF file, or, where the length fits, from what CiA 402 has as default.
Values are decoded by the type of their object. Objects of a vendor have names only where the
vendor is known, and positions are angles only where the trace shows what a unit of them is.
"""

from __future__ import annotations

import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from twin.base.errors import plural
from twin.devices.akd import protocol
from twin.devices.akd.eds import DataSheet, read_data_sheet
from twin.devices.akd.observed import (
    BUS,
    Change,
    Command,
    EmergencyReport,
    ErrorFrame,
    Gap,
    Observed,
    Rhythm,
    StrayAnswer,
    StreamKey,
    Transfer,
)
from twin.devices.akd.protocol import RPM_RAD_S, TURN_RAD, Key, Object, mappings, table
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
    PRODUCT,
    PROFILE,
    VENDOR,
    decode_number,
    decode_value,
    error_words_of,
    find_identities,
    list_foreign,
    longest_bits,
    shown_mask,
    split_mapping,
)

if TYPE_CHECKING:
    from twin.devices.akd.config import AkdConfig
    from twin.devices.akd.trace_files.frames import BusFrame

CONTROL, STATUS, PLACE, SPEED, TARGET = 0x6040, 0x6041, 0x6064, 0x606C, 0x60FF
ERROR_CODE, FAULTS = 0x603F, 0x2001
_REPORTED_OBJECTS = {CONTROL, STATUS, 0x6060, 0x6061, ERROR_CODE, 0x1001, 0x60FD}
"""Objects of which every change in a PDO is reported."""
MODES = (0x6061, 0x6060)
"""The mode of operation, as it is displayed and as it is given."""
_POSITION_OBJECTS = (0x6062, PLACE, 0x607A, 0x60F4)
"""In units of the user; the feed (6092h) gives their number in a turn of the shaft."""
_ENCODER_OBJECTS = (0x6063, 0x60FC)
"""In increments of the encoder; its resolution (608Fh) gives their number in a turn."""
_VELOCITY_OBJECTS = (0x606B, SPEED, TARGET)
_DRIVE_PROFILES = {0, 402, 0xFFFF}
"""Profiles (low word of 1000h) of drives, of devices of several profiles, and of none (0)."""
_VENDORS_OBJECTS, _PROFILES_OBJECTS = range(0x2000, 0x6000), range(0x6000, 0xA000)
AXIS_OFFSET = 0x800
"""Objects from one axis of a drive to the next."""
_MIN_MAPPED_INDEX = 0x20
"""Lowest index of a mapped object: a lower one is a data type, used as padding."""
_FRAME_KINDS = {0x080: "EMCY", 0x580: "SDO", 0x600: "SDO", 0x700: "heartbeat"}
_IRREGULAR_SHARE = 0.05
"""Share of long pauses above which a sequence of frames is not regular."""
LONG_PAUSE = 1.6
"""Multiple of the usual pause above which a pause is a gap."""
_FEW, _MOST = 10, 20
"""Fewest frames in which a rhythm is seen; most gaps of one kind that are reported, the longest."""
_ENDED, _ENDED_FOR = 3, 0.05
"""Times the usual pause, and s, from which something has ended before the trace does."""
_NAMING_SPECIFIERS = (UPLOAD, DOWNLOAD_ANSWER, ABORT)
"""Command specifiers of answers that name their object."""
_SDO_BYTES, _MIN_SDO_BYTES = 8, 4
"""Length of every SDO frame by CiA 301, and the least that names an object."""
_FIRST_INDEX = 0x1000
"""Lowest index of an object that is no data type."""
_SYNC_IDENTIFIER, _EMERGENCY_IDENTIFIER, _SDO_SERVERS = 0x1005, 0x1014, range(0x1200, 0x1280)
"""Objects with the identifiers of SYNC, of emergencies, and of SDO requests (1) and answers (2)."""
_STORE_WORD, _STORE_KEYS = 0x6576_6173, ((0x1010, 1), (0x1010, 2))
"""The word "save", and the objects that store the settings of PDOs when it is written to them."""
_RESTORE_WORD, _RESTORE_KEYS = 0x6461_6F6C, ((0x1011, 1), (0x1011, 2))
"""The word "load", and the objects that let the next boot restore their defaults."""
_MAX_SHOWN_BYTES = 64
"""Bytes of a value that are shown; of a longer one their number is, too."""
_MAX_OPEN_TRANSFERS = 50
"""Transfers back in which the request of a late answer is looked for."""
_SHORT_S = 0.2
"""Time in s below which one is given in ms."""
HOST = "host"
"""Sender of frames that only a master sends."""


def sync_period(frames: Sequence[BusFrame]) -> float:
    """The period in s, in whole ms, of the SYNCs of a trace; the nominal one if there are few."""
    times = [each.timestamp for each in frames if each.arbitration_id == protocol.SYNC]
    if len(times) <= _FEW:
        from twin.hal.interface import NOMINAL_PERIOD  # noqa: PLC0415  loads numpy

        return NOMINAL_PERIOD
    return max(1, round(1e3 * median(after - before for before, after in pairwise(times)))) / 1e3


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
        if key[0] not in _PROFILES_OBJECTS:
            return self._known.get(key, blank)
        base, axis = axis_of(key[0])
        known = self._known.get((base, key[1])) if drive else None
        if known is None:
            return blank
        return Object(*key, known.name + (f" of axis {axis}" if axis > 1 else ""), known.type)


def axis_of(index: int) -> tuple[int, int]:
    """The object of the first axis that an object is like, and its axis, 1 for the first."""
    if index not in _PROFILES_OBJECTS:
        return index, 1
    axis, offset = divmod(index - _PROFILES_OBJECTS.start, AXIS_OFFSET)
    return _PROFILES_OBJECTS.start + offset, axis + 1


def key_of_axis(index: int, axis: int) -> Key:
    """The object of an axis, 1 for the first, that is like an object of the first axis."""
    return index + (axis - 1) * AXIS_OFFSET, 0


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


class Series(NamedTuple):
    """Values of an object in the PDOs of a node: s since the first frame, and as they were sent.

    They are whole counts, or of an object of IEEE 754 its numbers.
    """

    time: array[float]
    counts: array[Any]


class _Entry(NamedTuple):
    """An object in a PDO: its key, type, first bit, bits, and whether changes are reported."""

    key: Key
    type: str
    first: int
    bits: int
    reports_changes: bool
    series: Series


@dataclass
class _Settings:
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

    def keep(self, number: int, key: Key, value: int, before: int | None, *, writes: bool) -> None:
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
        if of_pdo or index in _PROFILES_OBJECTS:
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


class _Held(dict[int, dict[Key, int]]):
    """Values of objects of nodes: at first those that are known without the trace."""

    def __init__(self, known: Callable[[int], dict[Key, int]]) -> None:
        super().__init__()
        self._known = known

    def __missing__(self, node: int) -> dict[Key, int]:
        return self.setdefault(node, self._known(node))


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
        self.series: dict[tuple[int, Key], Series] = {}
        """What PDOs carried, by node and object."""
        self.begin = heard[0].timestamp - (0.0 if timed else 1.0)  # frames are numbered from 1
        """Time of the first frame, s, as the trace has it."""
        self.duration = heard[-1].timestamp - self.begin
        """Seconds from the first frame to the last."""
        self.strangers: Counter[int] = Counter()
        """Frames of no service of CANopen, by identifier."""
        self._long: Counter[int] = Counter()
        self.errors: Counter[str] = Counter()
        """Error frames by what they say."""
        foreign, echoes = list_foreign(heard)
        self.observed = Observed(foreign=foreign)
        """The observations in the frames, as data."""
        self.echoes = len(echoes)
        """Frames that the adapter handed back to its host; they are left out."""
        self.timed = timed
        """Whether the frames have times, or their numbers instead."""
        self._names = names or Names()
        self._axes = {axis.node: axis for axis in rig.axes} if rig else {}
        self._frame = 0
        self._sdo: dict[int, OpenTransfer] = {}
        self.pdos: dict[int, Pdo] = {}
        """PDOs by their identifier, as the trace has them at its end."""
        self._receivers: defaultdict[int, dict[tuple[int, str], Pdo]] = defaultdict(dict)
        self._layouts: dict[tuple[int, str], tuple[int, list[_Entry]]] = {}
        self._no_pdo: set[int] = set()
        self._settings = _Settings()
        self._asked: set[int] = set()  # for their life (node guarding), and have not answered
        self._identified: set[tuple[int, int]] = set()
        self._last: dict[object, object] = {}
        self._served: defaultdict[tuple[int, int], int] = defaultdict(int)
        self._objects: dict[tuple[int, Key], Object] = {}
        self._requests: Counter[bool] = Counter()
        self._there, self._identities = find_identities(heard)
        self.bitrate: int | None = rig.bus.bitrate if rig else None
        """Bit rate of the bus in bit/s; None if it is not known."""
        self.values = _Held(self._known_of)
        """Values of objects of nodes at its end, as far as they were read or written."""
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
            or self._names.sheet.objects
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

    def _known_of(self, node: int) -> dict[Key, int]:
        """What the trace does not show: by the standard, by the maker's file, by the rig's."""
        known = dict[Key, int]()
        if self.is_drive(node):
            known |= mappings({int(at, 16): each for at, each in table()["defaults"].items()})
        if self._is_of_sheet(node):
            known |= self._names.sheet.held_by(node)
        if node in self._axes:
            known |= mappings(protocol.pdo_maps(self._axes[node].plate_object))
        return known

    def _is_of_sheet(self, node: int) -> bool:
        """Whether the EDS file may describe a node: not if the trace shows a different vendor."""
        vendor = self._identities.get((node, VENDOR))
        return vendor is None or self._names.sheet.vendor in (None, vendor)

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
        default = self._names.sheet.defaults.get(PROFILE) if self._is_of_sheet(node) else None
        profile = self._identities.get((node, PROFILE), default.number if default else None)
        return node in self._axes or profile is None or profile & 0xFFFF in _DRIVE_PROFILES

    def _object(self, node: int, key: Key) -> Object:
        """An object of a node: its name and type."""
        found = self._objects.get((node, key))
        if found is None:
            found = self._objects[node, key] = self._names.describe(
                key,
                akd=self.is_akd(node),
                drive=self.is_drive(node),
                sheet=self._is_of_sheet(node),
            )
        return found

    def _reports_changes(self, node: int, key: Key) -> bool:
        """Whether every change of an object is reported."""
        index = axis_of(key[0])[0]
        if index == FAULTS:
            return self.is_akd(node)
        return index in _REPORTED_OBJECTS and (
            index < _PROFILES_OBJECTS.start or self.is_drive(node)
        )

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
            return f"{seconds:.0f} frames"
        return f"{1e3 * seconds:.3g} ms" if seconds < _SHORT_S else f"{seconds:.3g} s"

    def end_of(self, end: float | None) -> float:
        """When something was over, s; what has no such time stands to the end of the trace."""
        return self.duration if end is None else end

    def lasting(self, begin: float, end: float | None) -> str:
        """How long a state lasts between two times in s, in words; None as in `end_of`."""
        when = "to the end of the trace, " if end is None else ""
        return f"{when}for {self.span(self.end_of(end) - begin)}"

    def plate_object(self, node: int) -> Key | None:
        """The object of the plate's encoder in a node; None if no rig file names it."""
        return self._axes[node].plate_object if node in self._axes else None

    def mode(self, node: int, axis: int, time: float = math.inf) -> int | None:
        """The mode of operation of an axis at a time in s; None if the trace does not show it.

        The mode that the drive displays counts, else the one that it is given.
        """
        for index in MODES:
            changes = self.observed.changes.get((node, key_of_axis(index, axis)), ())
            shown = (each.value for each in reversed(changes) if each.time <= time)
            if (mode := next(shown, None)) is not None:
                return mode
        return None

    def has_axes(self, node: int) -> bool:
        """Whether a drive has several axes."""
        return node in self.nodes and bool(self.nodes[node].axes)

    def scale(self, node: int, key: Key) -> tuple[float, str]:
        """Factor and SI unit of an object of a node; 1 and nothing if they are not known.

        Positions are in units of the user, so many of which (6092h:1) make so many turns (6092h:2)
        of the driven shaft. Where the trace does not show these, the gear (6091h) and the encoder's
        resolution (608Fh), they stay counts. An AKD counts by 608Fh alone unless bit 4 of its
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
        units = self._units_a_turn(node, index, (number - 1) * AXIS_OFFSET)
        return (TURN_RAD / units, "rad") if units else (1.0, "")

    def _units_a_turn(self, node: int, index: int, offset: int) -> float | None:
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
            seen = self._served[node, key[0]]
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
            text = f"{self.object_name(node, carried)}, {bits} bits"
        elif index == FAULTS and sub and value and self.is_akd(node):
            text = protocol.fault_words([value])
        elif unit:
            text = f"{value * factor:.6g} {unit}"
        return text

    def summary(self) -> dict[str, Any]:
        """The output of ``--json``, without the events."""
        nodes = {f"{each}": {**vars(node), "signals": {}} for each, node in self.nodes.items()}
        for (number, key), series in self.series.items():
            known = [value for value in series.counts if math.isfinite(value)]
            if known and not self._reports_changes(number, key):
                factor, unit = self.scale(number, key)
                ends = [each(known) * (factor if unit else 1) for each in (min, max)]
                low, high = sorted(ends)
                its = {"from": low, "to": high, "unit": unit}
                nodes[f"{number}"]["signals"][self.object_name(number, key)] = its
        pdos = {
            f"{cob_id:03X}h": pdo._asdict()
            | {"entries": [self.object_name(pdo.node, k) for k, _ in pdo.entries]}
            for cob_id, pdo in self.pdos.items()
        }
        strangers = {f"{each:03X}h": count for each, count in self.strangers.items()}
        return {"begin": self.begin, "duration": self.duration, "nodes": nodes, "pdos": pdos} | {
            "regular": {
                self.label(stream): rhythm.summary()
                for stream, rhythm in self.observed.rhythms.items()
            },
            "strangers": strangers,
            "errors": dict(self.errors),
        }

    def remarks(self) -> list[str]:
        """Facts reported nowhere else: frames that are left out, a file of a different vendor."""
        remarks = []
        if self.echoes:
            remarks.append(f"left out: {plural(self.echoes, 'frame')} that the adapter handed back")
        others = self.strangers - self._long
        kinds = {"with 29-bit identifiers, no CANopen": self._long, "of no known service": others}
        for kind, counts in kinds.items():
            if counts:
                some = [f"{each:X}h" for each in counts][:3] + ["..."] * (len(counts) > 3)
                shown = ", ".join(some)
                remarks.append(f"not decoded: {plural(counts.total(), 'frame')} {kind} ({shown})")
        for node in sorted({node for node, _ in self.series} - self._settings.described):
            known = node in self._axes or (node, PROFILE) in self._identities or self.is_akd(node)
            if not known and not (self._names.sheet.objects and self._is_of_sheet(node)):
                remarks.append(
                    f"{self.called(node)}: the trace does not show what its PDOs carry: decoded by "
                    "the defaults of CiA 402, as if it was a drive"
                )
        for node in sorted(self.nodes) if self._names.sheet.objects else ():
            if not self._is_of_sheet(node):
                vendors = self._names.sheet.vendor or 0, self._identities[node, VENDOR]
                remarks.append(
                    f"{self.called(node)}: the EDS file is not used: it is of vendor "
                    f"{vendors[0]:X}h, the node of {vendors[1]:X}h"
                )
        return remarks

    def object_name(self, node: int, key: Key) -> str:
        """Name of an object of a node."""
        name = self._object(node, key).name
        return f"{key[0]:04X}h{f':{key[1]}' if key[1] else ''}{f' {name}' if name else ''}"

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
            self._long[identifier] += 1
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
        pdo = None if moved else self.pdos.get(identifier) or self._usual(identifier)
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
                words = message.in_words(akd=self.is_akd(number))
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
            self._forget_settings(number)

    def _forget_settings(self, number: int) -> None:
        """Take back the settings of PDOs that a node has no more as it boots.

        These are the ones that it was given and did not store, all if it was to restore defaults.
        """
        before, values = self._settings.unstored.pop(number, {}), self.values[number]
        if number in self._settings.restored:
            self._settings.restored.remove(number)
            known = self._known_of(number)
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

    def _power(self, at: float, number: int, key: Key, status: int) -> None:
        """Note the state that a status word shows."""
        node, state, axis = self._node(number), protocol.state(status), axis_of(key[0])[1]
        self._served[number, key[0]] |= status
        states = node.drive if axis == 1 else node.axes.setdefault(axis, [])
        if states[-1:] != [state.value]:
            states.append(state.value)
            if state is protocol.DriveState.FAULT:
                words = self.words(number, key, status)
                text = words if axis == 1 else f"axis {axis}: {words}"
                node.faults.append({"time": at, "text": text})

    def _usual(self, identifier: int) -> Pdo | None:
        """The PDO that an identifier is by what is known without the trace; None if it is none.

        Those that are sent come before those that are received.
        """
        if identifier in self._no_pdo:
            return None
        nodes = {identifier & protocol.NODE_MASK, self._names.sheet.node or 0} - {0}
        for parameters in self._pdo_parameters(nodes):
            for number in nodes:
                if self._cob_id(number, parameters) == identifier:
                    found = self.pdos[identifier] = self._assigned(number, parameters)
                    return found
        self._no_pdo.add(identifier)
        return None

    def _pdo_parameters(self, nodes: Iterable[int]) -> list[int]:
        """The parameters of PDOs that nodes may have, those that they send first."""
        known = {i for number in nodes for i, sub in self.values[number] if sub == 1}
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
        value = self.values[number].get((parameters, 1))
        if value is None:
            return usual
        if (number, parameters) not in self._identified:  # frames of it show that it is on
            return value & 0x7FF or usual
        return None if value & protocol.PDO_INVALID else value & 0x7FF

    def _assigned(self, number: int, parameters: int) -> Pdo:
        """What a PDO of a node carries, as far as it is known now."""
        mapping, values = parameters + 0x200, self.values[number]
        count = values.get((mapping, 0), 0) & 0xFF
        entries = [split_mapping(values.get((mapping, sub), 0)) for sub in range(1, count + 1)]
        name = f"{'T' if parameters >= 0x1800 else 'R'}PDO{(parameters & 0x1FF) + 1}"
        return Pdo(number, name, tuple(entries))

    def _exchange(self, at: float, identifier: int, pdo: Pdo, data: bytes) -> None:
        node = self._node(pdo.node)
        who = node.name if pdo.name[0] == "T" else HOST
        if who != HOST:
            node.frames["PDO"] += 1
            self.observed.sent_by[pdo.node].append(at, self._frame)
        key, stream = StreamKey(pdo.node, pdo.name), f"{pdo.name} of {node.name}"
        self.observed.streams[key].append(at, self._frame)
        fits = self._unpack(at, who, pdo, data)
        for other in self._receivers.get(identifier, {}).values():
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
        length, entries = self._layouts.get(pdo[:2]) or (sum(bits for _, bits in pdo.entries), None)
        if 8 * len(data) != length:
            return False
        entries = self._laid_out(pdo) if entries is None else entries
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

    def _laid_out(self, pdo: Pdo) -> list[_Entry]:
        """The objects of a PDO with their types; not what stands for nothing."""
        found, first = list[_Entry](), 0
        for key, bits in pdo.entries:
            if 0 < bits <= 64 and key[0] >= _MIN_MAPPED_INDEX:
                kind = self._object(pdo.node, key).type
                real = kind[0] == "F" and kind[1:] == f"{bits}"
                code = "d" if real else "q" if kind[0] == "I" else "Q"
                series = self.series.setdefault((pdo.node, key), Series(array("d"), array(code)))
                reports = self._reports_changes(pdo.node, key)
                if (
                    series.counts.typecode == code
                ):  # otherwise mapped with a different length before
                    found.append(_Entry(key, kind, first, bits, reports, series))
            first += bits
        self._layouts[pdo[:2]] = first, found
        return found

    def _changed(self, at: float, who: str, pdo: Pdo, key: Key, value: int) -> None:
        """Report a value of a PDO that differs from the one before."""
        self._note(at, pdo.node, key, value)
        index, axis = axis_of(key[0])
        if index == STATUS:
            self._power(at, pdo.node, key, value)
        words = meaning = self.words(pdo.node, key, value)
        if index == STATUS:
            passing = protocol.passing_bits(self.mode(pdo.node, axis))
            meaning = self.words(pdo.node, key, value & ~passing)
        meaning = meaning.partition(" (")[0]
        if self._new((pdo.node, key), meaning):
            to = "" if who == self.called(pdo.node) else f" to {self.called(pdo.node)}"
            self._say(at, who, "PDO", f"{self.object_name(pdo.node, key)}{to}: {words}")

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
        size = (self._object(number, transfer.key).bits + 7) // 8 or 4
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
        value = decode_value(self._object(number, key).type, data)
        kept = value if isinstance(value, int) and not transfer.missed else None
        if transfer.missed:
            value_text = "a block, of which the trace lacks a part"
        elif isinstance(value, str):
            value_text = f'"{value}"'
        elif isinstance(value, bytes):
            more = f" ... ({len(value)} bytes)" if len(value) > _MAX_SHOWN_BYTES else ""
            value_text = value[:_MAX_SHOWN_BYTES].hex(" ") + more or "nothing"
        elif isinstance(value, float):
            value_text = self.words(number, key, value)
        else:
            index = axis_of(key[0])[0]
            held = self.values[number]
            self._settings.keep(number, key, value, held.get(key), writes=transfer.writes)
            held[key] = value
            if self._reports_changes(number, key):
                self._note(at, number, key, value)
            if index == STATUS and self.is_drive(number):
                self._power(at, number, key, value)
            value_text = self.words(number, key, value)
            if index in protocol.PDO_PARAMETER_INDICES:
                if not index & 0x200 and key[1] == 1:
                    self._identified.add((number, index))
                self._assign(number, index & ~0x200)
            elif index == FAULTS and key[1] and value and self.is_akd(number):
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
        node, what = self._node(number), self.object_name(number, transfer.key)
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
        for other, pdo in list(self.pdos.items()):
            if pdo[:2] == its[:2] and other != cob_id:
                del self.pdos[other]
        for others in self._receivers.values():
            others.pop(its[:2], None)
        there = self.pdos.get(cob_id) or self._sender(cob_id, number)
        if there is None or there[:2] == its[:2]:
            self.pdos[cob_id] = its
        elif its.name[0] == "R":
            self._receivers[cob_id][its[:2]], self.pdos[cob_id] = its, there
        else:
            self._receivers[cob_id][there[:2]], self.pdos[cob_id] = there, its

    def _sender(self, cob_id: int, number: int) -> Pdo | None:
        """The PDO that a different node, which is there, sends by an identifier."""
        other = cob_id & protocol.NODE_MASK
        if other == number or other not in self._there:
            return None
        sent = (each for each in self._pdo_parameters([other]) if each >= 0x1800)
        found = next((each for each in sent if self._cob_id(other, each) == cob_id), None)
        return self._assigned(other, found) if found is not None else None

    def label(self, stream: StreamKey) -> str:
        """Name of a stream."""
        return f"{stream.name} of {self.called(stream.node)}" if stream.node else stream.name

    def _find_gaps(self) -> None:
        """Find where what comes regularly did not; of PDOs only where SYNC came."""
        missing: list[Gap] = []
        for stream in sorted(self.observed.streams, key=lambda each: each.node != BUS):
            times, frames = self.observed.streams[stream]
            if len(times) < _FEW:
                continue
            pauses = [after - before for before, after in pairwise(times)]
            usual, last = median(pauses), times[-1]
            long = [k for k, pause in enumerate(pauses) if pause > LONG_PAUSE * usual]
            if len(long) > _IRREGULAR_SHARE * len(pauses):
                continue
            gaps = [Gap(times[k], times[k + 1], frames[k]) for k in long]
            if self.duration - last > max(_ENDED * usual, _ENDED_FOR):
                gaps.append(Gap(last, None, frames[-1]))
            self.observed.rhythms[stream] = Rhythm(usual, max(pauses), gaps)
            if stream.node == BUS:
                missing = gaps
            elif stream.name != "heartbeat":
                gaps = [each for each in gaps if not any(_overlap(each, gap) for gap in missing)]
            self._say_gaps(stream, usual, gaps)

    def _say_gaps(self, stream: StreamKey, usual: float, gaps: list[Gap]) -> None:
        """Report the longest gaps of a stream."""
        name, often = self.label(stream), f"usually every {1e3 * usual:.3g} ms"
        who = self.called(stream.node) if stream.node else HOST
        lengths = {gap: gap.end - gap.begin for gap in gaps if gap.end is not None}
        for gap in sorted(lengths, key=lambda each: -lengths[each])[:_MOST]:
            text = f"no {name} for {1e3 * lengths[gap]:.3g} ms ({often})"
            self.events.append(TracedEvent(gap.begin, who, "gap", text, gap.frame))
        for gap in gaps:
            if gap.end is None:
                text = f"no {name} from here on ({often})"
                self.events.append(TracedEvent(gap.begin, who, "gap", text, gap.frame))


def _overlap(one: Gap, other: Gap) -> bool:
    """Whether two gaps that are over lie at the same time."""
    if one.end is None or other.end is None:
        return False
    return one.begin < other.end and other.begin < one.end
