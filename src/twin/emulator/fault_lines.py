"""Faults of the virtual rig in words: their names, the lines that do them, and the plan of a run.

It imports neither a bus nor drives, so that a misspelt fault is reported at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from twin.base.data_file import read_packaged
from twin.base.errors import ScenarioError, TwinError, nearest

CONTROL_COMMANDS = (
    "state",
    "fault NODE NUMBER [lasting]",
    "sto NODE",
    "release NODE",
    "voltage NODE off|on",
    "reboot NODE",
    "power NODE SECONDS",
    "jam NODE",
    "free NODE",
    "torque NODE NM",
    "sdo NODE silent|answers",
    "abort NODE INDEX:SUB CODE",
    "restore NODE",
    "drop ID|all SECONDS",
    "delay ID|all BY SECONDS",
    "repeat ID|all SECONDS",
    "cut ID|all BYTES SECONDS",
    "clear",
)
"""Allowed lines; NUMBER, INDEX, CODE and ID are decimal, or hexadecimal with 0x."""
RIG_WORDS = ("sto", "release", "lift", "put", "unplug", "plug")
"""Lines about the whole virtual rig."""
_TABLE: Mapping[str, Mapping[str, str]] = read_packaged("twin.emulator", "faults.toml")
FAULTS: Mapping[str, str] = {name: about["line"] for name, about in _TABLE.items()}
"""Lines of `VirtualRig.control` by the names of the faults that they do."""
MATRIX_ROWS: Mapping[str, str] = {
    name: about["row"] for name, about in _TABLE.items() if "row" in about
}
"""Row of the fault matrix with the same fault, by name; not every one has a row."""
_NAMES = {
    text.casefold(): name
    for name, about in _TABLE.items()
    for text in (name, about.get("formerly", name))
}
"""Present names by all that are read, in small letters."""


def fault_name(text: str) -> str | None:
    """The fault that a text names, in any letters or by its former name; None if it names none."""
    return _NAMES.get(" ".join(text.split()).casefold())


class PlannedFault(NamedTuple):
    """A line that the virtual rig obeys at a time of the run.

    Attributes:
        time: Seconds since the run has begun.
        line: A line of `VirtualRig.control`.
        name: As it was given, the line or its name in ``FAULTS``.
    """

    time: float
    line: str
    name: str


def plan_faults(texts: Sequence[str], duration: float, option: str) -> list[PlannedFault]:
    """The faults that texts ``SECONDS LINE`` describe, in the order of their times.

    Args:
        texts: As ``3.0 unplug``, ``2 drop 0x080 0.1``, or by a name of ``FAULTS``, ``2 SYNC lost``.
        duration: Of the run, s.
        option: What the argument is called in messages.

    Raises:
        ScenarioError: If a time is none of the run, or the virtual rig cannot obey a line.
    """
    known = sorted({*FAULTS, *RIG_WORDS, "touch", *(each.split()[0] for each in CONTROL_COMMANDS)})
    found = []
    for text in texts:
        at, _, named = text.strip().partition(" ")
        named = fault_name(named) or named
        line = FAULTS.get(named, named)
        try:
            time = float(at)
        except ValueError:
            time = math.nan
        if not math.isnan(time) and not 0 <= time < duration:
            raise ScenarioError(
                f"{option} '{text:.60}': the time must be 0 to {duration:g} s, got {time:g}"
            )
        if math.isnan(time) or not named.strip():
            example = "'SECONDS LINE', as in '3.0 unplug'"
            raise ScenarioError(
                f"{option} '{text:.60}': write {example}, with 0 to {duration:g} seconds"
            )
        word = line.strip().partition(" ")[0]
        if word not in known:
            named = named.strip()
            raise ScenarioError(f"{option} '{text:.60}': no fault '{named}'{nearest(named, known)}")
        found.append(PlannedFault(time, line.strip(), named.strip()))
    from twin.emulator.injection import rehearse  # noqa: PLC0415  heavy: it has drives and a bus

    for text, planned in zip(texts, found, strict=True):
        try:
            rehearse(planned.line)
        except TwinError as error:
            raise ScenarioError(f"{option} '{text:.60}': {error}") from None
    return sorted(found, key=lambda each: each.time)
