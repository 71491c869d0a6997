"""Reads what the name of a column suggests: the time, the ball, a command or an angle, its axis."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from twin.base.data_file import read_toml
from twin.run.units import UNIT_SCALES, plain_unit

_WORDS = {
    kind: frozenset(words) for kind, words in read_toml(Path(__file__).with_suffix(".toml")).items()
}
"""Kind of words to the words in small letters, see the file."""
NUMBERINGS = ("012345", "123456", "abcdef", "uv")
"""Letters and digits that number columns: the first is along x, the second along y."""
WEAK_NAMES = {frozenset({word}): ("command", 0.4) for word in _WORDS["output"]} | {
    frozenset({"r"}): ("measured", 0.4),
    frozenset({"mv"}): ("command", 0.4),  # manipulated variable; elsewhere millivolts
}
"""Words that often mean something else: kind and weight of a column without any other word."""
CASE_CHANGE = re.compile(
    r"(?<=[a-zà-öø-ÿąćęłńśźżğış])(?=[A-Z])|(?<=[\u4e00-\u9fff])(?=[A-Za-z])"
    r"|(?<=[A-Za-z])(?=[\u4e00-\u9fff])"
)
"""Where a word ends without a sign between: before a capital, and next to a Chinese sign."""
SINGLE_NAMES = {
    "time": re.compile(r"x_value"),  # of LabVIEW
    "touched": re.compile(r"touch(ed)?|seen|visible|valid|detected"),
    "age": re.compile(r"age|latency"),
}
"""Kinds that whole names state."""

FILLER = "de"
"""The derivative of an error, but among other words that of some languages for ``of``."""
DRIVE_UNITS = frozenset({"us", "V", "mV", "counts", "count", "steps", "pwm"})
"""Units of commands other than angles."""
TIME_UNITS = frozenset({"s", "ms"})
"""Units in which a column is a time, whatever its name is."""
UNKNOWN_WEIGHT = 0.9
"""Weight of a position by its unit and axis alone."""
BALL_WEIGHT = 3.0
"""Weight of a name that says that it is of the ball."""

_KNOWN = frozenset().union(*_WORDS.values(), *WEAK_NAMES)
_JOINED_KINDS = (
    *("ball", "position", "drive", "angle", "measured", "reference", "processed", "plate"),
    "electric",
)
_JOINED_WITHOUT_SPACES = (*_JOINED_KINDS, "derived", "output", "neutral")
_PARTS = sorted(
    {word for kind in _JOINED_KINDS for word in _WORDS[kind] if len(word) > 2}
    | {
        word
        for kind in _JOINED_WITHOUT_SPACES
        for word in _WORDS[kind]
        if re.match(r"[\u4e00-\u9fff]", word)
    },
    key=len,
    reverse=True,
)
_JOINED = re.compile(rf"([xy]?)((?:{'|'.join(_PARTS)})*|[upc])([xy]?)")
"""Words without a sign between: an axis before or behind, as ``xpos`` and ``servoy``."""
_LETTERS = {"p": "position", "c": "position"}
"""Words that a letter next to an axis stands for: ``px`` is a position, ``cx`` a centre."""
_PART = re.compile("|".join(_PARTS) + "|[upc]")
SHORT_NAMES = {
    "xb": ("x", "ball"),
    "yb": ("y", "ball"),
    "xdata": ("x", "data"),
    "ydata": ("y", "data"),
    "udata": ("u", "data"),
}
"""Words of a few letters that mean something only together: balls, and what MATLAB draws."""


@dataclass(frozen=True)
class Suggestion:
    """What the name of a column suggests.

    Attributes:
        kind: ``time``, ``counter`` of rows, ``measured`` of the ball, ``command``, ``angle`` of a
            measured one, ``reference`` by the name alone, ``touched`` or ``age``.
        axis: ``x`` or ``y``; empty if the name states none.
        weight: The larger, the clearer.
        counts: Whether the numbers are in a unit of the rig's own.
    """

    kind: str
    axis: str
    weight: float
    counts: bool


COUNTER = Suggestion("counter", "", 1.6, counts=True)
"""What the name of a column that counts rows suggests."""


def suggest_kinds(names: Sequence[str], units: Sequence[str] = ()) -> list[Suggestion | None]:
    """What each name suggests with its unit; None of one that suggests nothing.

    Columns that are numbered belong together: ``servo_1`` is along x only next to ``servo_2``, and
    ``ball_u`` a position in a picture only next to ``ball_v``. Of a path ``GROUP/NAME`` or
    ``GROUP.NAME`` that suggests nothing the last name counts. A wish, as a setpoint, is a command
    in a unit of angles or drives that no position has, else nothing; a position in a unit of angles
    is a measured angle.

    Args:
        names: Without units.
        units: Of each, empty of one without; by default none has any.
    """
    last = _suggest_each([re.split(r"[/.]", name)[-1] for name in names])
    found = [
        each or (None if (set(_split(name)) - {FILLER}) & _WORDS["derived"] else other)
        for name, each, other in zip(names, _suggest_each(names), last, strict=True)
    ]
    known = [plain_unit(unit) for unit in units] or [""] * len(names)
    of_positions = {
        unit for unit, each in zip(known, found, strict=True) if each and each.kind == "measured"
    }
    return [
        _by_unit(each, unit, of_positions) if each else _by_length(name, unit)
        for name, each, unit in zip(names, found, known, strict=True)
    ]


def _by_unit(each: Suggestion, unit: str, of_positions: set[str]) -> Suggestion | None:
    """What a name suggests, corrected by its unit.

    Args:
        each: What it suggests by itself.
        unit: Its unit; empty without one.
        of_positions: Units of all positions.
    """
    if each.kind == "reference":
        of_drive = unit in UNIT_SCALES["rad"] or (unit in DRIVE_UNITS and unit not in of_positions)
        return replace(each, kind="command") if of_drive else None
    if each.kind == "measured" and unit in TIME_UNITS:
        return replace(each, kind="time", axis="")
    if each.kind == "measured" and unit in UNIT_SCALES["rad"] and each.weight < BALL_WEIGHT:
        return replace(each, kind="angle", weight=each.weight - 1.0)
    return each


def _by_length(name: str, unit: str) -> Suggestion | None:
    """A position along an axis in a unit of length, of a thing with an unknown name; else None."""
    words = set(_split(name))
    axis, others = words & {"x", "y"}, words - {"x", "y"}
    if unit not in UNIT_SCALES["m"] or len(axis) != 1 or others & _KNOWN - _WORDS["neutral"]:
        return None
    return Suggestion("measured", axis.pop(), UNKNOWN_WEIGHT, counts=False)


def _suggest_each(names: Sequence[str]) -> list[Suggestion | None]:
    """What each name suggests as it stands."""
    split = [_split(name) for name in names]
    axes = dict(_number(split))
    return [
        _suggest(name.casefold(), *axes.get(k, (words, "")))
        for k, (name, words) in enumerate(zip(names, split, strict=True))
    ]


def _split(name: str) -> tuple[str, ...]:
    """The words of a name in small letters, its axis and its number apart."""
    apart = CASE_CHANGE.sub(" ", name).casefold()
    found: list[str] = []
    for word in re.findall(r"[^\W\d_]+|\d+", apart):
        if word in SHORT_NAMES:
            found += SHORT_NAMES[word]
            continue
        joined = _JOINED.fullmatch(word)
        whole = word in _WORDS["ball"] and word != apart
        by_letter = joined and joined[2] in _LETTERS and not (joined[1] or joined[3])
        if joined and joined[2] and not whole and not by_letter:
            inner = (_LETTERS.get(part, part) for part in _PART.findall(joined[2]))
            parts = (joined[1], *inner, joined[3])
            found += filter(None, parts)
        else:
            found.append(word)
    return tuple(found)


def _number(split: Sequence[tuple[str, ...]]) -> Iterator[tuple[int, tuple[tuple[str, ...], str]]]:
    """Columns that are numbered: index, the words without the number, and the axis.

    The axis of the third of three positions is ``z``, and that of each of three or more drives,
    none of which tilts the plate along one axis.
    """
    groups: dict[tuple[str, ...], dict[str, int]] = {}
    for k, words in enumerate(split):
        if set(words[:-1]) - _WORDS["neutral"] - _WORDS["processed"]:
            groups.setdefault(words[:-1], {})[words[-1]] = k
    for words, members in groups.items():
        for numbering in NUMBERINGS:
            found = [members[each] for each in numbering if each in members]
            if len(found) < 2 or numbering[0] not in members:
                continue
            legs = len(found) > 2 and _WORDS["drive"] & set(words)
            axes = "z" * len(found) if legs else "xyz"
            if words == ("y",):  # y1 and y2 are outputs, x1 and x2 states
                yield from ((k, ((), axis)) for axis, k in zip(axes, found, strict=False))
            elif not {"x", "y"} & set(words):
                yield from ((k, (words, axis)) for axis, k in zip(axes, found, strict=False))
            break


def _suggest(name: str, words: tuple[str, ...], axis: str) -> Suggestion | None:
    """What a name suggests by its words, its axis known from its number or empty."""
    for kind, pattern in SINGLE_NAMES.items():
        if pattern.fullmatch(name):
            return Suggestion(kind, "", 1.0, counts=False)
    if axis == "z":
        return None
    every = set(words)
    if every - {"x", "y", FILLER} - _WORDS["neutral"]:
        every.discard(FILLER)
    if words and words[-1] in _WORDS["time"]:
        named = every & (_WORDS["derived"] | _WORDS["drive"])
        return None if named else Suggestion("time", "", 2.0 - 0.1 * len(words), counts=False)
    if (apart := {word for word in words if not word.isdigit()}) and apart <= _WORDS["counter"]:
        return COUNTER
    stated = every & {"x", "y"}
    axis = axis or ("".join(stated) if len(stated) == 1 else "")
    known = {word for word in every - _WORDS["neutral"] - stated if not word.isdigit()}
    kind, weight = _kind(known, axis)
    if not kind:
        return None
    if kind != "measured":
        axis = axis or next((way for word in words for way in "xy" if word in _WORDS[way]), "")
    weight -= bool(known & _WORDS["processed"]) + 0.2 * len(known - _KNOWN)
    counts = bool(every & (_WORDS["counts"] | _WORDS["pixels"]))
    return Suggestion(kind, axis, weight, counts)


def _kind(words: set[str], axis: str) -> tuple[str, float]:
    """Kind and weight of a column by its words without axis and number; empty without any."""
    drive, angle = words & _WORDS["drive"], words & _WORDS["angle"]
    sensor = words & _WORDS["angle_sensor"]
    sensed = sensor or words & _WORDS["measured"]
    wish, place = words & _WORDS["reference"], words & _WORDS["position"]
    found = "", 0.0
    if words & (_WORDS["derived"] | _WORDS["vehicle"]) or (drive and "current" in words):
        pass
    elif words & _WORDS["ball"]:
        if not drive and not wish and (axis or place or words in ({"ball"}, {"kugel"})):
            found = "measured", BALL_WEIGHT
    elif sensor or (sensed and (drive or angle)):
        found = "angle", 2.0
    elif (drive or angle) and not words & _WORDS["time"]:
        clear = words & {"cmd", "command", "u"}
        found = "command", 1.5 + 0.5 * bool(drive) + bool(clear) + 0.4 * bool(wish)
    elif frozenset(words) in WEAK_NAMES:
        found = WEAK_NAMES[frozenset(words)]
    elif wish:
        found = "reference", 1.9
    elif place or (axis and words <= _WORDS["measured"] | _WORDS["processed"]):
        found = "measured", 2.0 + 0.5 * bool(sensed)
    return found
