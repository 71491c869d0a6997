"""Touch reports read by what the panel's own report descriptor says of them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple, Self

from twin.devices.lumio.decoder import Contact, Decoder, Report
from twin.devices.lumio.hid_report import ReportDescriptor, ReportField

TOUCH_SCREEN = 0x000D_0004
_FINGER = 0x000D_0022
_TIP, _IDENTIFIER, _COUNT = 0x000D_0042, 0x000D_0051, 0x000D_0054
_X, _Y = 0x0001_0030, 0x0001_0031

APPLICATIONS = {
    0x0001_0001: "pointer",
    0x0001_0002: "mouse",
    0x0001_0006: "keyboard",
    0x000C_0001: "consumer control",
    TOUCH_SCREEN: "touch screen",
    0x000D_0005: "touch pad",
    0x000D_000E: "device configuration",
}
"""What an interface can be, by the usage of its outermost collection."""


def application(usage: int) -> str:
    """What an interface of a usage is, in words."""
    page, identifier = usage >> 16, usage & 0xFFFF
    return APPLICATIONS.get(usage, f"usage {page:04x}:{identifier:04x}")


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
        for field in descriptor.fields:
            if not field.within or field.within[0][0] != TOUCH_SCREEN:
                continue
            if field.usage == _COUNT:
                counts.setdefault(field.report, field)
            fingers[field.report, _place(field)].setdefault(field.usage, field)
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
            -(-descriptor.bits[report] // 8) + descriptor.numbered,
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
        self.layout = layout
        self._left = 0
        self._down: set[int] = set()

    @property
    def extent(self) -> tuple[float, float] | None:
        """Sides of the sensing area along the screen's x and y, m, if the panel tells."""
        return self.layout.extent

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
