"""The input reports of a USB device: where in their bits a number lies, and what it stands for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class ReportField(NamedTuple):
    """A number in an input report.

    Attributes:
        report: Number of the report that holds it; 0 in a device that numbers none.
        offset: Its first bit, counted from the beginning of the report after its number.
        bits: Its length.
        usage: What it means: page << 16 | identifier; 0 for padding.
        logical: Smallest and largest value.
        physical: What these two stand for, in the unit.
        metres: The unit, if it is one of length, in m; else 0.
        within: Usages of the collections around it, outermost first, and their positions in the
            descriptor: ``(usage, position)``.
    """

    report: int
    offset: int
    bits: int
    usage: int
    logical: tuple[int, int]
    physical: tuple[int, int]
    metres: float
    within: tuple[tuple[int, int], ...]

    def value(self, report: int) -> int:
        """Its value in a report, given as one little-endian number without the report's number."""
        raw = report >> self.offset & (1 << self.bits) - 1
        negative = self.logical[0] < 0 and raw >> self.bits - 1
        return raw - (1 << self.bits) if negative else raw

    @property
    def length(self) -> float:
        """What its whole range stands for, m; 0 if that is no length."""
        return self.metres * (self.physical[1] - self.physical[0])


@dataclass(frozen=True)
class ReportDescriptor:
    """Everything in a report descriptor that concerns input.

    Attributes:
        fields: Of all input reports, padding left out.
        bits: Length of each input report by its number, without the number itself.
        numbered: Whether every report begins with its number.
        applications: Usages of the outermost collections: what the device is.
    """

    fields: tuple[ReportField, ...]
    bits: dict[int, int]
    numbered: bool
    applications: tuple[int, ...]
