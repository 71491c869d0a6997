"""Faults done to the virtual rig at given times of a run, and noted in its record."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from twin.base.data_file import read_packaged
from twin.base.errors import ScenarioError, nearest
from twin.devices.rig import HardwareRig
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.control import CONTROL_COMMANDS, BusControl, ControlError, place_of_touch
from twin.emulator.drive import EmulatedDrive
from twin.hal.interface import Condition, Severity
from twin.hal.rig import Entry
from twin.hal.supervisor import INJECTED_BEGIN, Note, State

INJECTED = Condition("fault injected", Severity.WARNING, 0.0, "noted", "run without it")
"""How an injected fault stands among the events of a run."""
RIG_WORDS = ("sto", "release", "lift", "put", "unplug", "plug")
"""Lines about the whole virtual rig."""
RIG_NODES = (1, 2)
"""Nodes of its drives."""
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
LOOK_INTERVAL_S = 0.001
"""Time in s between two looks at the run's clock."""


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
        try:
            _rehearse(line.strip())
        except ControlError as error:
            raise ScenarioError(f"{option} '{text:.60}': {error}") from None
        found.append(PlannedFault(time, line.strip(), named.strip()))
    return sorted(found, key=lambda each: each.time)


def _rehearse(line: str) -> None:
    """Obey a line with drives that nobody uses.

    Raises:
        ControlError: The virtual rig cannot obey it.
    """
    word = line.split(maxsplit=1)[0]
    if word == "touch":
        place_of_touch(line)
    elif (
        word in RIG_WORDS
        and word not in {each.split()[0] for each in CONTROL_COMMANDS}
        and line != word
    ):
        raise ControlError(f"how: {word}")
    elif line not in RIG_WORDS:
        drives = [EmulatedDrive(node) for node in RIG_NODES]
        BusControl(EmulatedBus(drives)).obey(line)


@contextmanager
def inject(
    faults: Sequence[PlannedFault], obey: Callable[[str], str], rig: HardwareRig
) -> Iterator[None]:
    """Do faults to a rig at their times while the context lasts; each is noted in its journal.

    A thread of its own hands them over, so that the control loop never waits for the virtual rig.

    Args:
        faults: In the order of their times.
        obey: Hands a line to the virtual rig and returns what was done.
        rig: The rig that runs; its clock and its state are only read.
    """
    ended = threading.Event()

    def work() -> None:
        waiting = list(faults)
        while waiting and not ended.wait(LOOK_INTERVAL_S):
            time = rig.clock.time
            if rig.supervisor.state[0] == State.RUNNING and time >= waiting[0].time:
                fault = waiting.pop(0)
                text = f"{fault.name}: {obey(fault.line)}"
                rig.journal.append(Entry(time, Note(0, INJECTED, f"{INJECTED_BEGIN}{text}")))

    thread = threading.Thread(target=work, name="faults", daemon=True)
    if faults:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if faults:
            thread.join()
