"""What a USB input device says of its own reports: the items of a HID report descriptor.

After Device Class Definition for HID 1.11, section 6.2.2, and as the Linux kernel reads it where
devices and definition differ. Written here because the libraries that read descriptors leave out
units, from which the size of a panel follows, or have a licence that does not go with this one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from twin.devices.lumio.hid_report import ReportDescriptor, ReportField
from twin.errors import TwinError

LONGEST = 4096
"""Bytes of a descriptor, as the kernel allows."""
LARGEST = 8 * 16384
"""Bits of a report, as the kernel allows."""
WIDEST = 64
"""Bits of a field."""
MOST = 12288
"""Fields of a device, and usages of one item, as the kernel allows."""
DEEPEST = 64
"""Levels of collections, and of settings put by."""

_MAIN, _GLOBAL, _LOCAL = 0, 1, 2
_LONG_ITEM = 0xFE
_INPUT, _COLLECTION, _END = 0x8, 0xA, 0xC
_CONSTANT, _VARIABLE = 1 << 0, 1 << 1
_PUSH, _POP = 0xA, 0xB


class DescriptorError(TwinError, ValueError):
    """Bytes that are no report descriptor."""


@dataclass(frozen=True)
class _Globals:
    """The settings that hold until they are changed."""

    page: int = 0
    logical: tuple[int, int] = (0, 0)
    physical: tuple[int, int] = (0, 0)
    exponent: int = 0
    unit: int = 0
    size: int = 0
    count: int = 0
    report: int = 0


@dataclass
class _Parser:
    settings: _Globals = _Globals()
    put_by: list[_Globals] = field(default_factory=list)
    usages: list[int] = field(default_factory=list)
    first: int = 0
    within: list[tuple[int, int]] = field(default_factory=list)
    fields: list[ReportField] = field(default_factory=list)
    bits: dict[int, int] = field(default_factory=dict)
    numbered: bool = False
    applications: list[int] = field(default_factory=list)

    def main(self, tag: int, data: int, at: int) -> None:
        if tag == _INPUT:
            self._input(data)
        elif tag == _COLLECTION:
            usage = self._complete(self.usages[0]) if self.usages else 0
            if not self.within:
                self.applications.append(usage)
            self.within.append((usage, at))
            if len(self.within) > DEEPEST:
                raise DescriptorError(f"more than {DEEPEST} levels of collections")
        elif tag == _END:
            if not self.within:
                raise DescriptorError(f"byte {at}: ends a collection that has not begun")
            self.within.pop()
        self.usages, self.first = [], 0

    def _input(self, flags: int) -> None:
        now = self.settings
        begin = self.bits.get(now.report, 0)
        if not (0 < now.size <= WIDEST or flags & _CONSTANT):
            raise DescriptorError(f"a field of {now.size} bits; 1 to {WIDEST} are possible")
        if begin + now.size * now.count > LARGEST:
            raise DescriptorError(f"a report of more than {LARGEST} bits")
        self.bits[now.report] = begin + now.size * now.count
        if flags & _CONSTANT or not flags & _VARIABLE or not self.usages:
            return
        if len(self.fields) + now.count > MOST:
            raise DescriptorError(f"more than {MOST} fields")
        # with fewer usages than fields, the last one holds for the rest
        for index in range(now.count):
            usage = self._complete(self.usages[min(index, len(self.usages) - 1)])
            self.fields.append(
                ReportField(
                    now.report,
                    begin + index * now.size,
                    now.size,
                    usage,
                    now.logical,
                    now.logical if now.physical == (0, 0) else now.physical,
                    _metres(now.unit, now.exponent),
                    tuple(self.within),
                )
            )

    def _complete(self, usage: int) -> int:
        """A usage with its page; one of four bytes brings it along."""
        return usage if usage >> 16 else self.settings.page << 16 | usage

    def globals(self, tag: int, data: int, size: int) -> None:
        if tag == _PUSH:
            self.put_by.append(self.settings)
            if len(self.put_by) > DEEPEST:
                raise DescriptorError(f"more than {DEEPEST} settings put by")
        elif tag == _POP:
            if not self.put_by:
                raise DescriptorError("settings fetched that were not put by")
            self.settings = self.put_by.pop()
        else:
            self.settings = self._changed(tag, data, size)

    def _changed(self, tag: int, data: int, size: int) -> _Globals:
        now, signed = self.settings, _signed(data, 8 * size)
        match tag:
            case 0x0:
                now = replace(now, page=data & 0xFFFF)
            case 0x1:
                now = replace(now, logical=(signed, now.logical[1]))
            case 0x2:
                # 25 FF after a smallest value of 0 means 255 and not -1
                top = signed if now.logical[0] < 0 else data
                now = replace(now, logical=(now.logical[0], top))
            case 0x3:
                now = replace(now, physical=(signed, now.physical[1]))
            case 0x4:
                top = signed if now.physical[0] < 0 else data
                now = replace(now, physical=(now.physical[0], top))
            case 0x5:
                # meant as a byte with a sign, mostly written as half of one
                now = replace(now, exponent=_signed(data, 4) if 0 <= signed < 16 else signed)
            case 0x6:
                now = replace(now, unit=data)
            case 0x7:
                now = replace(now, size=data)
            case 0x8:
                if not 0 < data <= 0xFF:
                    raise DescriptorError(f"report number {data}; 1 to 255 are possible")
                self.numbered = True
                now = replace(now, report=data)
            case 0x9:
                now = replace(now, count=data)
        return now

    def local(self, tag: int, data: int) -> None:
        if tag == 0x0:
            self.usages.append(data)
        elif tag == 0x1:
            self.first = data
        elif tag == 0x2:
            if data - self.first >= MOST or len(self.usages) >= MOST:
                raise DescriptorError(f"more than {MOST} usages of one field")
            self.usages += range(self.first, data + 1)


def parse(data: bytes) -> ReportDescriptor:
    """What a report descriptor says of the input reports.

    Args:
        data: The descriptor.

    Raises:
        DescriptorError: It is cut short, or says what no device can mean.
    """
    if len(data) > LONGEST:
        raise DescriptorError(f"{len(data)} bytes; at most {LONGEST} are possible")
    parser = _Parser()
    for at, kind, tag, value, size in _items(data):
        if kind == _MAIN:
            parser.main(tag, value, at)
        elif kind == _GLOBAL:
            parser.globals(tag, value, size)
        elif kind == _LOCAL:
            parser.local(tag, value)
    if parser.within:
        raise DescriptorError("it ends within a collection")
    return ReportDescriptor(
        tuple(parser.fields), parser.bits, parser.numbered, tuple(parser.applications)
    )


def _items(data: bytes) -> Iterator[tuple[int, int, int, int, int]]:
    """Position, type, tag, value and size of the short items; long ones mean nothing yet."""
    at = 0
    while at < len(data):
        head = data[at]
        if head == _LONG_ITEM:
            at += 3 + (data[at + 1] if at + 1 < len(data) else 0)
            continue
        size = (0, 1, 2, 4)[head & 3]
        body = data[at + 1 : at + 1 + size]
        if len(body) < size:
            raise DescriptorError(f"byte {at}: cut short")
        yield at, head >> 2 & 3, head >> 4, int.from_bytes(body, "little"), size
        at += 1 + size


def _signed(value: int, bits: int) -> int:
    """A number of so many bits in two's complement."""
    return value - (1 << bits) if bits and value >> bits - 1 & 1 else value


_CENTIMETRE, _INCH = 0x11, 0x13


def _metres(unit: int, exponent: int) -> float:
    """A unit of length in m, 0 for any other; 10 to its exponent of them (6.2.2.7)."""
    base = {_CENTIMETRE: 0.01, _INCH: 0.0254}.get(unit, 0.0)
    return base * 10.0**exponent if -32 < exponent < 32 else 0.0
