"""The common part of all devices: ranges of settings, ports, and reports of faults.

Some ranges are those of safety nets, which a rig file may relax, with a warning; outside of its
range a net would have no effect. A port is for one program at a time.
"""

from __future__ import annotations

import errno
import math
import os
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from twin.base.data_file import read_packaged
from twin.base.errors import ScenarioError
from twin.hal.interface import NOMINAL_PERIOD, Condition, Fault, Severity

RELAXED = Condition(
    "safety net relaxed", Severity.WARNING, NOMINAL_PERIOD, "noted", "take it out of the rig file"
)
"""A rig file makes a safety net of any device wider than by default."""


def net(default: Any, low: float, high: float, *, sense: int = 1, **metadata: Any) -> Any:
    """A field that is a safety net.

    Args:
        default: Its default.
        low: Smallest value.
        high: Largest value.
        sense: 1 where larger values detect less or allow more, -1 where smaller ones do.
        metadata: Further metadata.
    """
    return field(default=default, metadata={"range": (low, high), "net": sense, **metadata})


def range_field(default: Any, low: float, high: float, **metadata: Any) -> Any:
    """A field with a range that is no net."""
    return field(default=default, metadata={"range": (low, high), **metadata})


@dataclass(frozen=True, kw_only=True)
class Ranged:
    """Settings that check their ranges when they are made.

    Raises:
        ScenarioError: Naming the key of a value that is no number of its range.
    """

    keys: ClassVar[str]
    """Beginning of their keys, as ``drives.watch.``."""

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        for each in fields(self):
            low, high = each.metadata.get("range", (None, None))
            value = getattr(self, each.name)
            if low is None or value is None:
                continue
            numbers = value if isinstance(value, tuple) else (value,)
            if not all(low <= number <= high for number in numbers):
                key = f"{self.keys.format(self)}{each.name}"
                raise ScenarioError(f"{key} = {value}: must be {low:g} to {high:g}")

    @property
    def relaxed(self) -> tuple[str, ...]:
        """Every net that is wider than by default, as a text: key, value and default."""
        return tuple(
            f"{self.keys}{each.name} = {_short(getattr(self, each.name))} (default {each.default})"
            for each in fields(self)
            if (sense := each.metadata.get("net"))
            and wider(getattr(self, each.name), each.default, sense)
        )


def _short(value: Any) -> Any:
    """A number with the digits that a person reads."""
    return float(f"{value:.4g}") if isinstance(value, float) else value


def wider(value: Any, default: Any, sense: int = 1) -> bool:
    """Whether a number, or one of a tuple, is on the relaxed side of its default."""
    if isinstance(default, tuple):
        return any(wider(*pair, sense) for pair in zip(value, default, strict=True))
    return bool(sense * (value - default) > 0)


def claim(path: str, flags: int) -> int:
    """Open a port so that other programs which ask for a lock are refused; its descriptor.

    Args:
        path: Path of the device.
        flags: How to open it, as ``os.O_RDWR``; reading and writing never wait.

    Raises:
        ImportError: This is no POSIX system.
        OSError: It cannot be opened, or a different program has claimed it.
    """
    import fcntl  # noqa: PLC0415  POSIX only

    handle = os.open(path, flags | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise OSError(errno.EBUSY, "port is locked") from error
    return handle


def in_words(device: str, number: int, **about: str) -> str | None:
    """The meaning of an error of the operating system, by ``ports.toml``; None if not listed.

    Args:
        device: ``bus`` or ``screen``.
        number: Number of the error.
        about: Values of the names in its text.
    """
    known = read_packaged("twin.devices", "ports.toml")[device].items()
    found = (words for name, words in known if getattr(errno, name, None) == number)
    words = next(found, None)
    return None if words is None else str(words.format(**about))


def error_number(error: BaseException | None) -> int:
    """The operating system's number of an error, wherever libraries have wrapped it; 0 for none."""
    while error is not None:
        candidates = getattr(error, "errno", None), getattr(error, "error_code", None), *error.args
        number = next((each for each in candidates if isinstance(each, int)), None)
        if number is not None:
            return number
        error = error.__cause__ or error.__context__
    return 0


class FaultReports:
    """Faults on their way to the supervisor: stops and levels are latched.

    Args:
        repeat: Shortest time in s between two reports of one warning.
    """

    def __init__(self, repeat: float) -> None:
        self._repeat = repeat
        self._new: list[Fault] = []
        self._latched: dict[tuple[str, str], Fault] = {}
        self._warned: dict[tuple[str, str], tuple[float, int]] = {}
        """Time in s of the last report of each warning, and how often it has been seen since."""

    def report(self, condition: Condition, where: str, detail: str, at: float) -> None:
        """Report a condition seen at a time in s: once; a warning again after ``repeat``."""
        key = condition.name, where
        if condition.severity is Severity.WARNING:
            last, held_back = self._warned.get(key, (-math.inf, 0))
            if at - last < self._repeat:
                self._warned[key] = last, held_back + 1
                return
            self._warned[key] = at, 0
            more = f" ({held_back} more before)" if held_back else ""
            self._new.append(Fault(condition, where, detail + more, at))
        elif key not in self._latched:
            self._latched[key] = fault = Fault(condition, where, detail, at)
            self._new.append(fault)

    def latched(self, condition: Condition, where: str) -> bool:
        """Whether a condition was reported; warnings are never latched."""
        return (condition.name, where) in self._latched

    @property
    def stopping(self) -> tuple[Fault, ...]:
        """Everything latched that forbids torque, oldest first."""
        every = self._latched.values()
        return tuple(each for each in every if each.condition.severity is Severity.STOP)

    def take(self) -> tuple[Fault, ...]:
        """Faults reported since the last call, oldest first."""
        new, self._new = tuple(self._new), []
        return new
