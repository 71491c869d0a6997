"""Touch reports out of bytes: the protocols of a serial line, and the reports of a USB panel.

A panel is read by what its own report descriptor says, after Device Class Definition for HID 1.11,
section 6.2.2, and as the Linux kernel reads it where devices and definition differ. Written here
because the libraries that read descriptors leave out units, from which the size of a panel follows,
or have a licence that does not go with this one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, NamedTuple, Self

from twin.data_file import packaged
from twin.errors import TwinError


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


Report = tuple[Contact, ...]
"""The contacts of one packet."""


@dataclass(slots=True)
class DecoderStats:
    """What a decoder has met so far.

    Attributes:
        bytes: Bytes fed.
        reports: Packets with contacts.
        cut: Bytes before the first packet that may end one whose beginning was not heard.
        skipped: Other bytes that belong to no packet.
        checksum: Packets whose checksum is wrong.
        outside: Packets refused for a coordinate beyond the protocol's range.
    """

    bytes: int = 0
    reports: int = 0
    cut: int = 0
    skipped: int = 0
    checksum: int = 0
    outside: int = 0


class Decoder(ABC):
    """Reports out of bytes; never raises, whatever the bytes."""

    name: ClassVar[str]
    """What a rig file calls the protocol."""
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

    A subclass says what a packet looks like. Bytes that start none are skipped one by one, so the
    stream is understood again at the next whole packet.
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
                self._leave_out()
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
        """Give up on the beginning of a packet that has not been completed."""
        for _ in self._buffer:
            self._leave_out()
        self._buffer.clear()

    def _leave_out(self) -> None:
        """Count a byte that belongs to no packet, or to one that began before the port was open."""
        if self._joined or self.stats.cut == self.size - 1:
            self.stats.skipped += 1
        else:
            self.stats.cut += 1

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
        return (Contact(x / _TABLET_TOP, 1 - y / _TABLET_TOP, bool(packet[0] & 0x40)),)


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
        return (Contact(x / _SMARTSET_TOP, y / _SMARTSET_TOP, down),)


STREAMS: dict[str, type[StreamDecoder]] = {
    decoder.name: decoder for decoder in (MicroTouchDecoder, EloDecoder)
}
"""The protocols of a serial line by the names a rig file gives them; listening tells them apart."""


class Detector:
    """Feeds the decoders of all serial protocols until one of them understands the stream.

    A protocol is taken when it has given several reports and these account for nearly all bytes of
    a stream long enough: a few packets of one can look like several of another.
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
        self._decoders = [decoder() for decoder in STREAMS.values()]

    def feed(self, data: bytes) -> tuple[StreamDecoder, list[Report]] | None:
        """The decoder of the protocol and what it makes of these bytes, once it is known."""
        found = []
        for decoder in self._decoders:
            reports = decoder.feed(data)
            heard, given = decoder.stats.bytes, decoder.stats.reports
            understood = decoder.size * given / max(1, heard)
            if heard >= self.LEAST and given >= self.REPORTS and understood >= self.SHARE:
                found.append((understood, decoder, reports))
        if found:
            _, decoder, reports = max(found, key=lambda entry: entry[0])
            return decoder, reports
        if self._decoders[0].stats.bytes > self.WINDOW:
            self.restart()
        return None


LARGEST = 8 * 16384
"""Bits of a report, and usages of one item, as the kernel allows."""

_MAIN, _GLOBAL, _LOCAL = range(3)
_INPUT, _COLLECTION, _END = 0x8, 0xA, 0xC
_CONSTANT, _VARIABLE = 1 << 0, 1 << 1
_PUSH, _POP = 0xA, 0xB
_USAGE, _FIRST, _LAST = range(3)
_METRES = {0x11: 0.01, 0x13: 0.0254}
"""Units of length, centimetre and inch, in m."""


class DescriptorError(TwinError, ValueError):
    """Bytes that are no report descriptor."""


_GLOBALS: tuple[str, ...] = "page", "logical_low", "logical_high", "physical_low", "physical_high"
_GLOBALS += "exponent", "unit", "size", "report", "count"
"""Settings that hold until they are changed, by the tag of the item that does so."""


class _Parser:
    """What the items have said so far."""

    def __init__(self) -> None:
        self.settings = dict.fromkeys(_GLOBALS, 0)
        self.put_by: list[dict[str, int]] = []
        self.usages: list[int] = []
        self.first = 0
        self.within: list[tuple[int, int]] = []
        self.fields: list[ReportField] = []
        self.bits: dict[int, int] = {}
        self.applications: list[int] = []

    def main(self, tag: int, flags: int, at: int) -> None:
        if tag == _INPUT:
            self._input(flags, **self.settings)
        elif tag == _COLLECTION:
            usage = self._complete(self.usages[0]) if self.usages else 0
            if not self.within:
                self.applications.append(usage)
            self.within.append((usage, at))
        elif tag == _END and self.within:
            self.within.pop()
        self.usages = []

    def _input(self, flags: int, size: int, report: int, count: int, **now: int) -> None:
        begin = self.bits.get(report, 0)
        self.bits[report] = begin + size * count
        if self.bits[report] > LARGEST:
            raise DescriptorError(f"a report of more than {LARGEST} bits")
        if flags & _CONSTANT or not flags & _VARIABLE or not self.usages or not size:
            return
        logical = now["logical_low"], now["logical_high"]
        span = now["physical_high"] - now["physical_low"] or logical[1] - logical[0]
        unit = _METRES.get(now["unit"], 0.0) * 10.0 ** now["exponent"]
        # with fewer usages than fields, the last one holds for the rest
        for index in range(count):
            usage, at = self._complete(self.usages[: index + 1][-1]), begin + index * size
            self.fields.append(
                ReportField(report, at, size, usage, logical, unit * span, tuple(self.within))
            )

    def _complete(self, usage: int) -> int:
        """A usage with its page; one of four bytes brings it along."""
        return usage if usage >> 16 else self.settings["page"] << 16 | usage

    def change(self, tag: int, data: int, signed: int) -> None:
        """Change one of the settings, or put all by, or fetch them."""
        if tag == _PUSH:
            self.put_by.append(dict(self.settings))
        elif tag == _POP and self.put_by:
            self.settings = self.put_by.pop()
        elif tag < len(_GLOBALS):
            name = _GLOBALS[tag]
            if name == "exponent":
                # a byte with a sign, mostly written as half of one
                data = (data & 0xF ^ 8) - 8
            # 25 FF after a smallest value of 0 means 255 and not -1
            elif name.endswith("_low") or self.settings.get(name.replace("high", "low"), 0) < 0:
                data = signed
            self.settings[name] = data

    def use(self, tag: int, data: int) -> None:
        """Take in what the next fields mean."""
        if tag == _USAGE:
            self.usages.append(data)
        elif tag == _FIRST:
            self.first = data
        elif tag == _LAST:
            if data - self.first > LARGEST:
                raise DescriptorError(f"more than {LARGEST} usages of one field")
            self.usages += range(self.first, data + 1)


def parse(data: bytes) -> ReportDescriptor:
    """What a report descriptor says of the input reports.

    Linux has refused by then what no device can mean.

    Args:
        data: The descriptor.

    Raises:
        DescriptorError: It is cut short, or has a report of no possible length.
    """
    parser, at = _Parser(), 0
    while at < len(data):
        kind, tag, size = data[at] >> 2 & 3, data[at] >> 4, (0, 1, 2, 4)[data[at] & 3]
        body = data[at + 1 : at + 1 + size]
        if len(body) < size:
            raise DescriptorError(f"byte {at}: cut short")
        value = int.from_bytes(body, "little")
        if kind == _MAIN:
            parser.main(tag, value, at)
        elif kind == _GLOBAL:
            parser.change(tag, value, int.from_bytes(body, "little", signed=True))
        elif kind == _LOCAL:
            parser.use(tag, value)
        at += 1 + size
    return ReportDescriptor(tuple(parser.fields), parser.bits, tuple(parser.applications))


class ReportField(NamedTuple):
    """A number in an input report.

    Attributes:
        report: Number of the report that holds it; 0 in a device that numbers none.
        offset: Its first bit, counted from the beginning of the report after its number.
        bits: Its length.
        usage: What it means: page << 16 | identifier; 0 for padding.
        logical: Smallest and largest value.
        length: What its whole range stands for, m; 0 if that is no length.
        within: Usages of the collections around it, outermost first, and their positions in the
            descriptor: ``(usage, position)``.
    """

    report: int
    offset: int
    bits: int
    usage: int
    logical: tuple[int, int]
    length: float
    within: tuple[tuple[int, int], ...]

    def value(self, report: int) -> int:
        """Its value in a report, given as one little-endian number without the report's number."""
        raw = report >> self.offset & (1 << self.bits) - 1
        negative = self.logical[0] < 0 and raw >> self.bits - 1
        return raw - (1 << self.bits) if negative else raw


@dataclass(frozen=True)
class ReportDescriptor:
    """Everything in a report descriptor that concerns input.

    Attributes:
        fields: Of all input reports, padding left out.
        bits: Length of each input report by its number, without the number itself; 0 in a device
            that numbers none, whose reports do not begin with it.
        applications: Usages of the outermost collections: what the device is.
    """

    fields: tuple[ReportField, ...]
    bits: dict[int, int]
    applications: tuple[int, ...]

    @property
    def what(self) -> str:
        """What an interface that has it is, in words."""
        return ", ".join(map(application, self.applications)) or "without any use"


TOUCH_SCREEN = 0x000D_0004
_FINGER = 0x000D_0022
_TIP, _IDENTIFIER, _COUNT = 0x000D_0042, 0x000D_0051, 0x000D_0054
_X, _Y = 0x0001_0030, 0x0001_0031


def application(usage: int) -> str:
    """What an interface can be, in words, by the usage of its outermost collection."""
    key = f"{usage >> 16:04x}:{usage & 0xFFFF:04x}"
    return str(_panels()["applications"].get(key, f"usage {key}"))


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
    """

    report: int
    size: int
    contacts: tuple[ContactFields, ...]
    count: ReportField | None

    @classmethod
    def of(cls, descriptor: ReportDescriptor) -> Self | None:
        """The layout that a descriptor gives, or None if it is no touch screen's."""
        fingers: dict[tuple[int, int], dict[int, ReportField]] = defaultdict(dict)
        counts: dict[int, ReportField] = {}
        for each in descriptor.fields:
            if not each.within or each.within[0][0] != TOUCH_SCREEN:
                continue
            if each.usage == _COUNT:
                counts.setdefault(each.report, each)
            fingers[each.report, _place(each)].setdefault(each.usage, each)
        found = [
            (report, ContactFields(known[_TIP], known[_X], known[_Y], known.get(_IDENTIFIER)))
            for (report, _), known in fingers.items()
            if {_TIP, _X, _Y} <= known.keys() and _spans(known[_X]) and _spans(known[_Y])
        ]
        if not found:
            return None
        report = found[0][0]
        return cls(
            report,
            -(-descriptor.bits[report] // 8) + (report > 0),
            tuple(contact for number, contact in found if number == report),
            counts.get(report),
        )

    @property
    def extent(self) -> tuple[float, float] | None:
        """Sides of the sensing area along the screen's x and y, m, if the panel tells."""
        first = self.contacts[0]
        x, y = first.x.length, first.y.length
        return (x, y) if x > 0 and y > 0 else None


def _place(field: ReportField) -> int:
    """What tells the numbers of one contact from those of another: the collection around them.

    That is the one called a finger. Product 202E:0006 calls only the first of its four so, and
    devices with a single contact may have none.
    """
    named = [position for usage, position in field.within if usage == _FINGER]
    return named[-1] if named else field.within[:2][-1][1]


def _spans(field: ReportField) -> bool:
    return field.logical[1] > field.logical[0]


class HidDecoder(Decoder):
    """Decoder of the reports of one panel, one or more whole ones at a time.

    A contact touches if its tip switch says so. Whether it is in range and whether the panel is
    confident that it is a finger is not asked: the ball is none. Padding may be anything, and so
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
        self._down: set[int] = set()

    def feed(self, data: bytes) -> list[Report]:
        """The reports in these bytes, oldest first."""
        self.stats.bytes += len(data)
        layout, reports = self.layout, []
        for at in range(0, len(data), layout.size):
            report = data[at : at + layout.size]
            if layout.report and report[0] != layout.report:
                break  # of another part of the same interface, of whatever length
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
        """Forget what a first report said of a second."""
        self._left = 0

    def _contacts(self, report: int) -> Report | None:
        used = self._used(report)
        contacts = []
        for place in used:
            x, y = _share(place.x, report), _share(place.y, report)
            if not (0 <= x <= 1 and 0 <= y <= 1):
                self.stats.outside += 1
                return None
            contacts.append(Contact(x, y, bool(place.tip.value(report)), _name(place, report)))
        for contact in contacts:
            (self._down.add if contact.down else self._down.discard)(contact.id)
        return tuple(contacts)

    def _used(self, report: int) -> tuple[ContactFields, ...]:
        """The places that hold a contact.

        Where there are more contacts than places, the rest follow in reports whose count is 0.
        """
        places = self.layout.contacts
        if self.layout.count is not None:
            number = self.layout.count.value(report) or self._left
            self._left = max(0, number - len(places))
            return places[:number]
        if len(places) == 1:
            return places
        return tuple(
            place
            for place in places
            if place.tip.value(report) or _name(place, report) in self._down
        )


def _share(field: ReportField, report: int) -> float:
    """A coordinate as a share of its range."""
    low, high = field.logical
    return (field.value(report) - low) / (high - low)


def _name(place: ContactFields, report: int) -> int:
    return place.identifier.value(report) if place.identifier is not None else 1


@cache
def _panels() -> dict[str, dict[str, str]]:
    return packaged("twin.devices.lumio", "panels.toml")


@cache
def _known_layouts() -> dict[str, TouchLayout]:
    """Layouts of the products in ``panels.toml``."""
    known = _panels()["descriptors"].items()
    found = {name: TouchLayout.of(parse(bytes.fromhex(data))) for name, data in known}
    return {name: layout for name, layout in found.items() if layout is not None}


def decoder_of(protocol: str) -> Decoder:
    """A decoder of a protocol, by the name a rig file gives it."""
    stream = STREAMS.get(protocol)
    return stream() if stream is not None else HidDecoder(_known_layouts()[protocol])
