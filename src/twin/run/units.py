"""Units in the headers and cells of logs, their factors to SI, and other words for them."""

from __future__ import annotations

import math
import re

UNIT_SCALES = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": 0.0254, "inch": 0.0254},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.radians(1)},
    "1": {"1": 1.0, "": 1.0},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": math.radians(1)},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": math.radians(1)},
}
"""SI unit to the units that a header may give instead, and their factors."""
UNIT_WORDS = {
    "s": ("sec", "secs", "second", "seconds", "sekunde", "sekunden", "seconde", "secondes"),
    "ms": ("msec", "msecs", "millisecond", "milliseconds"),
    "us": ("usec", "usecs", "microsecond", "microseconds"),
    "ns": ("nsec", "nsecs", "nanosecond", "nanoseconds"),
    "m": ("meter", "meters", "metre", "metres"),
    "mm": ("millimeter", "millimeters", "millimetre", "millimetres"),
    "cm": ("centimeter", "centimeters", "centimetre", "centimetres"),
    "deg": ("degree", "degrees", "grad", "°"),
    "rad": ("radian", "radians"),
    "V": ("volt", "volts"),
    "mV": ("millivolt", "millivolts"),
    "A": ("ampere", "amperes", "amp", "amps"),
}
"""Unit to the words that stand for it, in small letters."""
OTHER_UNITS = frozenset({"V", "mV", "A", "mA", "%", "-", "px", "counts", "Hz", "N", "g"})
"""Units of columns that have no role, or one only with a factor."""
_UNITS_BY_WORD = {word: unit for unit, words in UNIT_WORDS.items() for word in words}
_UNIT_SIGNS = str.maketrans({"µ": "u", "μ": "u", "²": "^2"})


INDEXED = re.compile(r".*\w[\[(]\d+[\])]")
"""A name with a number in brackets."""
DIVIDED = re.compile(r"([^/]+?)(?: / |(?<=^.)/|(?<=^..)/)([^\s/]+)")
"""A name by its unit, as physics writes it; without blanks only a letter or two, no path."""


def plain_unit(unit: str) -> str:
    """A unit as ``UNIT_SCALES`` has it, where it is known by another word or sign."""
    plain = unit.strip().translate(_UNIT_SIGNS)
    found = _UNITS_BY_WORD.get(plain.casefold(), plain)
    return found.replace("°", "deg")


def is_unit(word: str) -> bool:
    """Whether a word is a unit of ``UNIT_SCALES`` or of ``OTHER_UNITS``."""
    plain = plain_unit(word)
    known = any(plain in units for units in UNIT_SCALES.values())
    return bool(plain) and (known or plain in OTHER_UNITS)


def with_unit(name: str, unit: str | None) -> str:
    """A column's name as a header has it, with its unit if it has one; see ``split_unit``."""
    return f"{name} [{unit}]" if unit else name


def split_unit(header: str) -> tuple[str, str | None]:
    """Name and unit of a header such as ``measured_x [mm]`` or ``X (mm)``; None without a unit.

    The unit may be behind a stroke, ``Position / mm`` or ``x/mm``. A number in brackets next to the
    name, as ``servo[0]``, belongs to it.
    """
    text = header.strip()
    if INDEXED.fullmatch(text):
        return text, None
    if (divided := DIVIDED.fullmatch(text)) and is_unit(divided[2]):
        return divided[1], divided[2]
    if text.endswith(("]", ")")):
        since = max(text.rfind(bracket, 0, -1) for bracket in "])") + 1
        begins = [at for bracket in "[(" if (at := text.find(bracket, since)) >= 0]
        if begins:
            return text[: min(begins)].strip(), text[min(begins) + 1 : -1].strip()
    return text, None
