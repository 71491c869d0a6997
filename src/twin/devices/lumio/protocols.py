"""Touch reports out of bytes: the protocols of a serial line, and the reports of a USB panel.

A panel is read after its own report descriptor, following Device Class Definition for HID 1.11,
section 6.2.2, and as the Linux kernel reads it where devices and definition differ. Written here
because the libraries that read descriptors leave out units, from which the size of a panel follows,
or have a licence that does not go with this one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Self

from twin.base.data_file import read_packaged
from twin.base.errors import TwinError
from twin.devices.lumio.scan_time import ScanTime


class Contact(NamedTuple):
    """Something on the screen.

    Attributes:
        x: Position along the screen's first axis, as a fraction 0..1 of the protocol's range.
        y: Position along its second axis, downwards, as a fraction 0..1.
        down: Whether it touches; False in the one report of the lift-off.
        id: Number that stays the same while it touches; always 1 in protocols that have none.
    """

    x: float
    y: float
    down: bool
    id: int = 1


class Report(tuple[Contact, ...]):
    """The contacts of one packet.

    Attributes:
        scan: When they were scanned; None in a protocol that does not say, and in the packets that
            go on with the contacts of one before.
    """

    scan: ScanTime | None = None


@dataclass(slots=True)
class DecoderStats:
    """Counts of the bytes and packets that a decoder has met so far.

    Attributes:
        bytes: Bytes fed.
        reports: Packets with contacts.
        skipped: Bytes that belong to no packet, from the first packet on.
        checksum: Packets with a wrong checksum.
        outside: Packets refused for a coordinate beyond the protocol's range.
    """

    bytes: int = 0
    reports: int = 0
    skipped: int = 0
    checksum: int = 0
    outside: int = 0


class Decoder(ABC):
    """Reports out of bytes; never raises, whatever the bytes."""

    name: ClassVar[str]
    """Name of the protocol in a rig file."""
    patience: ClassVar[float] = 0.05
    """Seconds of silence after which half a packet will not be completed any more."""

    def __init__(self) -> None:
        self.stats = DecoderStats()
        self.extent: tuple[float, float] | None = None
        """Sides of the sensing area along the screen's x and y, m, if the panel tells."""

    @abstractmethod
    def feed(self, data: bytes) -> list[Report]:
        """The reports that these bytes complete, oldest first."""

    @abstractmethod
    def reset(self) -> None:
        """Give up on what has begun and has not been completed."""


class StreamDecoder(Decoder):
    """Reports out of a stream of bytes in any portions.

    A subclass defines the form of a packet. Bytes that start none are skipped one by one, so
    decoding resumes at the next whole packet.
    """

    size: ClassVar[int]
    """Bytes of a packet with contacts."""

    def __init__(self) -> None:
        super().__init__()
        self._buffer = bytearray()
        self._joined = False

    def feed(self, data: bytes) -> list[Report]:
        """The reports that these bytes complete, oldest first."""
        self.stats.bytes += len(data)
        self._buffer += data
        reports = []
        at = 0
        while at < len(self._buffer):
            packet = self._buffer[at : at + self.size]
            if not self._fits(packet):
                self.stats.skipped += self._joined
                at += 1
                continue
            if len(packet) < self.size:
                break
            at += self.size
            self._joined = True
            if (report := self._report(packet)) is not None:
                self.stats.reports += 1
                reports.append(report)
        del self._buffer[:at]
        return reports

    def reset(self) -> None:
        """Skip half a packet, as after a pause."""
        self.stats.skipped += self._joined * len(self._buffer)
        self._buffer.clear()

    @abstractmethod
    def _fits(self, packet: bytearray) -> bool:
        """Whether bytes, up to ``size``, may be a packet or its beginning."""

    @abstractmethod
    def _report(self, packet: bytearray) -> Report | None:
        """The contacts of a whole packet, if it has any."""


_TABLET_TOP = 16383


class MicroTouchDecoder(StreamDecoder):
    """Decoder of Format Tablet (MicroTouch EX Serial Reference Guide, p. 27).

    Five bytes, the first marked by its highest bit. The origin is at the bottom left; y is turned
    here, so that it counts downwards as in the other protocols. There being no checksum, a damaged
    stream can yield false positions. Replies to commands cannot come: none is sent.
    """

    name = "microtouch"
    size = 5

    def _fits(self, packet: bytearray) -> bool:
        return packet[0] >= 0x80 and all(byte < 0x80 for byte in packet[1:])

    def _report(self, packet: bytearray) -> Report:
        x, y = packet[1] | packet[2] << 7, packet[3] | packet[4] << 7
        down = bool(packet[0] & 0x40)
        return Report((Contact(x / _TABLET_TOP, 1 - y / _TABLET_TOP, down),))


_SMARTSET_TOP = 4095
_LEAD, _TOUCH = ord("U"), ord("T")
_TOUCHING, _LIFTED = 0x03, 0x04


class EloDecoder(StreamDecoder):
    """Decoder of the 10-byte SmartSet packets (Elo SmartSet guide, p. A-53).

    A packet is ``U``, a letter, status, x, y, z (each little-endian) and the sum of all bytes
    before it plus 0xAA. Coordinates are 12 bit; which way y counts is left to the calibration.
    """

    name = "elo"
    size = 10

    def _fits(self, packet: bytearray) -> bool:
        if packet[0] != _LEAD or not b"A" <= (packet[1:2] or b"T") <= b"Z":
            return False
        right = len(packet) < self.size or (0xAA + sum(packet[:-1])) & 0xFF == packet[-1]
        self.stats.checksum += not right and packet[1] == _TOUCH
        return right

    def _report(self, packet: bytearray) -> Report | None:
        if packet[1] != _TOUCH:
            return None
        status, x, y = packet[2], packet[3] | packet[4] << 8, packet[5] | packet[6] << 8
        if x > _SMARTSET_TOP or y > _SMARTSET_TOP:
            self.stats.outside += 1
            return None
        down = bool(status & _TOUCHING) and not status & _LIFTED
        return Report((Contact(x / _SMARTSET_TOP, y / _SMARTSET_TOP, down),))


STREAM_DECODERS: dict[str, type[StreamDecoder]] = {
    decoder.name: decoder for decoder in (MicroTouchDecoder, EloDecoder)
}
"""The protocols of a serial line by the names a rig file gives them; listening tells them apart."""


class Detector:
    """Feeds the decoders of all serial protocols until one of them understands the stream.

    A protocol is taken when it has given several reports and these account for nearly all bytes of
    a stream long enough: a few packets of one protocol can look like several of a different one.
    After ``WINDOW`` bytes without a decision it starts afresh.
    """

    REPORTS = 3
    """Reports that a protocol must have given."""
    SHARE = 0.8
    """Share of the bytes that they must account for."""
    LEAST = 60
    """Bytes that must have been heard."""
    WINDOW = 1024

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Listen afresh."""
        self._decoders = [decoder() for decoder in STREAM_DECODERS.values()]

    def feed(self, data: bytes) -> tuple[StreamDecoder, list[Report]] | None:
        """The decoder and the reports of these bytes; None until the protocol is known."""
        for decoder in self._decoders:
            reports, stats = decoder.feed(data), decoder.stats
            enough = stats.bytes >= self.LEAST and stats.reports >= self.REPORTS
            if enough and decoder.size * stats.reports >= self.SHARE * stats.bytes:
                return decoder, reports
        if self._decoders[0].stats.bytes > self.WINDOW:
            self.restart()
        return None


MAX_REPORT_BITS = 8 * 16384
"""Bits of a report, as the kernel allows."""
TOUCH_SCREEN = 0x000D_0004
_TIP, _IDENTIFIER, _COUNT = 0x000D_0042, 0x000D_0051, 0x000D_0054
_SCAN_TIME = 0x000D_0056
_X, _Y = 0x0001_0030, 0x0001_0031
_OF_CONTACT = {_TIP, _IDENTIFIER, _X, _Y}

_MAIN, _GLOBAL, _LOCAL = range(3)
_INPUT, _COLLECTION, _END = 0x8, 0xA, 0xC
_CONSTANT, _VARIABLE = 1 << 0, 1 << 1
_PAGE, _LOW, _HIGH, _PHYSICAL_LOW, _PHYSICAL_HIGH = range(5)
_EXPONENT, _UNIT, _SIZE, _REPORT, _REPEAT = range(5, 10)
_PUSH, _POP = 0xA, 0xB
_USAGE_ITEM = 0x0
_LENGTH_UNITS_M = {0x11: 0.01, 0x13: 0.0254}
"""Units of length, centimetre and inch, in m."""
_TIME_UNITS = {0x1001, 0x1003}
"""Units of time."""
_SCAN_TICK = 1e-4
"""Time in s of one count of a scan time where the descriptor gives no unit of time."""


class DescriptorError(TwinError, ValueError):
    """Bytes that are no report descriptor."""


class ReportField(NamedTuple):
    """A number in an input report.

    Attributes:
        usage: Meaning of the field: page << 16 | identifier.
        offset: Its first bit, counted from the beginning of the report after its number.
        bits: Its length.
        low: Smallest value.
        high: Largest value.
        length: What its whole range stands for, m; 0 if that is no length.
        duration: The same, s; 0 if that is no time.
    """

    usage: int
    offset: int
    bits: int
    low: int
    high: int
    length: float
    duration: float = 0.0

    def value(self, report: int) -> int:
        """Its value in a report, given as one little-endian number without the report's number."""
        raw = report >> self.offset & (1 << self.bits) - 1
        return raw - (1 << self.bits) if self.low < 0 and raw >> self.bits - 1 else raw

    def share(self, report: int) -> float:
        """The same as a share of its range."""
        return (self.value(report) - self.low) / (self.high - self.low)


def parse(data: bytes) -> dict[int, tuple[int, list[ReportField]]]:
    """The input reports by number, 0 in a device that numbers none: bits, and a touch's fields.

    Linux has refused by then what no device can mean.

    Args:
        data: The report descriptor.

    Raises:
        DescriptorError: It is cut short, or has a report of no possible length.
    """
    now, put_by = dict.fromkeys(range(10), 0), list[dict[int, int]]()
    usages, application, depth = list[int](), 0, 0
    found: dict[int, tuple[int, list[ReportField]]] = {}
    for kind, tag, value, signed in _items(data):
        if kind == _GLOBAL and tag == _PUSH:
            put_by.append(dict(now))
        elif kind == _GLOBAL and tag == _POP and put_by:
            now = put_by.pop()
        elif kind == _GLOBAL:
            # 25 FF after a smallest value of 0 means 255 and not -1
            of_range = tag in {_HIGH, _PHYSICAL_HIGH} and now[tag - 1] < 0
            now[tag] = signed if of_range or tag in {_LOW, _PHYSICAL_LOW} else value
        elif kind == _LOCAL and tag == _USAGE_ITEM:
            usages.append(value)
        elif kind == _MAIN:
            # a usage of four bytes brings its page along
            meant = [each if each >> 16 else now[_PAGE] << 16 | each for each in usages]
            usages = []
            if tag == _COLLECTION:
                application = application if depth else next(iter(meant), 0)
            depth += (tag == _COLLECTION) - (tag == _END)
            if tag == _INPUT:
                begin, fields = found.get(now[_REPORT], (0, []))
                end = begin + now[_SIZE] * now[_REPEAT]
                if end > MAX_REPORT_BITS:
                    raise DescriptorError(f"a report of more than {MAX_REPORT_BITS} bits")
                found[now[_REPORT]] = end, fields
                if application == TOUCH_SCREEN and value & (_CONSTANT | _VARIABLE) == _VARIABLE:
                    fields += _fields(begin, end, meant, now)
    return found


def _items(data: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Type, tag, and value without and with sign."""
    at = 0
    while at < len(data):
        size = (0, 1, 2, 4)[data[at] & 3]
        body = data[at + 1 : at + 1 + size]
        if len(body) < size:
            raise DescriptorError(f"byte {at}: cut short")
        yield (
            data[at] >> 2 & 3,
            data[at] >> 4,
            int.from_bytes(body, "little"),
            int.from_bytes(body, "little", signed=True),
        )
        at += 1 + size


def _fields(begin: int, end: int, usages: list[int], now: dict[int, int]) -> Iterator[ReportField]:
    """The fields of one item; with fewer usages than fields, the last one holds for the rest."""
    low, high = now[_LOW], now[_HIGH]
    span = now[_PHYSICAL_HIGH] - now[_PHYSICAL_LOW] or high - low
    exponent = (now[_EXPONENT] & 0xF ^ 8) - 8  # half a byte with a sign
    length = span * _LENGTH_UNITS_M.get(now[_UNIT], 0.0) * 10.0**exponent
    duration = span * 10.0**exponent if now[_UNIT] in _TIME_UNITS else 0.0
    for index, at in enumerate(range(begin, end, now[_SIZE] or MAX_REPORT_BITS)):
        for usage in usages[: index + 1][-1:]:
            yield ReportField(usage, at, now[_SIZE], low, high, length, duration)


class ContactFields(NamedTuple):
    """Where in a report the numbers of one contact are."""

    tip: ReportField
    x: ReportField
    y: ReportField
    identifier: ReportField | None


@dataclass(frozen=True)
class TouchLayout:
    """Where everything is in the report of a touch screen.

    Attributes:
        report: Its number; 0 if the device numbers none.
        size: Its bytes, the number included.
        contacts: The places for contacts.
        count: How many of them hold one; None where a report does not say.
        scan: When they were scanned; None where a report does not say.
    """

    report: int
    size: int
    contacts: tuple[ContactFields, ...]
    count: ReportField | None
    scan: ReportField | None = None

    @classmethod
    def of(cls, descriptor: bytes) -> Self | None:
        """The layout that a report descriptor gives, or None if it is no touch screen's.

        A number that a contact has already is the next one's.

        Raises:
            DescriptorError: If it is none.
        """
        for report, (bits, fields) in parse(descriptor).items():
            places: list[dict[int, ReportField]] = [{}]
            for field in (each for each in fields if each.usage in _OF_CONTACT):
                if field.usage in places[-1]:
                    places.append({})
                places[-1][field.usage] = field
            contacts = tuple(
                ContactFields(place[_TIP], place[_X], place[_Y], place.get(_IDENTIFIER))
                for place in places
                if {_TIP, _X, _Y} <= place.keys()
                and all(place[each].low < place[each].high for each in (_X, _Y))
            )
            if contacts:
                count, scan = (
                    next((field for field in fields if field.usage == usage), None)
                    for usage in (_COUNT, _SCAN_TIME)
                )
                return cls(report, -(-bits // 8) + (report > 0), contacts, count, scan)
        return None

    @property
    def extent(self) -> tuple[float, float] | None:
        """Sides of the sensing area along the screen's x and y, m, if the panel tells."""
        first = self.contacts[0]
        x, y = first.x.length, first.y.length
        return (x, y) if x > 0 and y > 0 else None


class HidDecoder(Decoder):
    """Decoder of the reports of one panel, one or more whole ones at a time.

    A contact touches if its tip switch is set. The bits "in range" and "confidence" (that it is a
    finger) are ignored: the ball is no finger. Padding may be anything, and so
    may places beyond the number of contacts. Identifiers are taken as they are: panels declare a
    range for them that they do not keep.

    Args:
        layout: Of its report.
    """

    name = "hid"

    def __init__(self, layout: TouchLayout) -> None:
        super().__init__()
        self.layout, self.extent = layout, layout.extent
        self._left = 0

    def feed(self, data: bytes) -> list[Report]:
        """The reports in these bytes, oldest first."""
        self.stats.bytes += len(data)
        layout, reports = self.layout, []
        for at in range(0, len(data), layout.size):
            report = data[at : at + layout.size]
            if layout.report and report[0] != layout.report:
                break  # a report of a different part of the same interface, of any length
            if len(report) < layout.size:
                self.stats.skipped += len(report)
                break
            number = int.from_bytes(report[1:] if layout.report else report, "little")
            contacts = self._contacts(number)
            if contacts:
                self.stats.reports += 1
                reports.append(contacts)
        return reports

    def reset(self) -> None:
        """Forget that a first report announced further ones."""
        self._left = 0

    def _contacts(self, report: int) -> Report | None:
        goes_on = self._left > 0
        used = self._used(report)
        contacts = []
        for place in used:
            x, y = place.x.share(report), place.y.share(report)
            if not (0 <= x <= 1 and 0 <= y <= 1):
                self.stats.outside += 1
                return None
            name = 1 if place.identifier is None else place.identifier.value(report)
            contacts.append(Contact(x, y, bool(place.tip.value(report)), name))
        found = Report(contacts)
        if not goes_on:
            found.scan = self._scanned(report)
        return found

    def _scanned(self, report: int) -> ScanTime | None:
        """When the contacts of a report were scanned."""
        field = self.layout.scan
        if field is None or field.low >= field.high:
            return None
        whole = field.duration or _SCAN_TICK * (field.high - field.low)
        tick = whole / (field.high - field.low)
        return ScanTime((field.value(report) - field.low) * tick, whole + tick)

    def _used(self, report: int) -> tuple[ContactFields, ...]:
        """The places that hold a contact.

        Where there are more contacts than places, the rest follow in reports with count 0.
        """
        places = self.layout.contacts
        if self.layout.count is not None:
            number = self.layout.count.value(report) or self._left
            self._left = max(0, number - len(places))
            return places[:number]
        if len(places) == 1:
            return places
        return tuple(place for place in places if place.tip.value(report))


def decoder_of(protocol: str) -> Decoder:
    """A decoder of a protocol, by the name a rig file gives it."""
    if protocol in STREAM_DECODERS:
        return STREAM_DECODERS[protocol]()
    known = read_packaged("twin.devices.lumio", "panels.toml")["descriptors"][protocol]
    layout = TouchLayout.of(bytes.fromhex(known))
    assert layout is not None
    return HidDecoder(layout)
