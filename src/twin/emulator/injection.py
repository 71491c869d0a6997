"""Faults done to the virtual rig at given times of a run, and noted in its record."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from twin.devices.rig import HardwareRig
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.control import BusControl, ControlError, place_of_touch
from twin.emulator.drive import EmulatedDrive
from twin.emulator.fault_lines import CONTROL_COMMANDS, RIG_WORDS, PlannedFault
from twin.hal.interface import Condition, Severity
from twin.hal.rig import Entry
from twin.hal.supervisor import INJECTED_BEGIN, Note, State

INJECTED = Condition("fault injected", Severity.WARNING, 0.0, "noted", "run without it")
"""How an injected fault stands among the events of a run."""
RIG_NODES = (1, 2)
"""Nodes of its drives."""
LOOK_INTERVAL_S = 0.001
"""Time in s between two looks at the run's clock."""


def rehearse(line: str) -> None:
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
