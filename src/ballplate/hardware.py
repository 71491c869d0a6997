"""A real rig, or the emulated one, in place of the simulation."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter
from twin.errors import ScenarioError

if TYPE_CHECKING:
    from ballplate.running import Attach
    from twin.devices.rig import HardwareRig
    from twin.run.record import Recorder
    from twin.scenario.schema import Scenario

EMULATED = "emulated"
"""The word for the virtual rig in place of a rig file."""
EVERY = 0.25
"""Seconds from one writing of what has been recorded to the next."""
SIMULATION_ONLY = ("plant.", "sensors.", "disturbance.", "rig.cams", "rig.cam_")
"""Beginnings of the keys that describe a simulated rig and mean nothing to a real one."""


@contextmanager
def connected(
    on: str | None, scenario: Scenario, keys: Sequence[str], reporter: Reporter, *, reset: bool
) -> Iterator[HardwareRig | None]:
    """The requested rig, not switched on; None for the simulation.

    Args:
        on: Rig file, ``emulated`` or None.
        scenario: What is to run on it.
        keys: What is changed of the scenario.
        reporter: Is told how far the virtual rig lagged.
        reset: Whether faults found in the drives are reset.

    Raises:
        TwinError: If there is no such rig, or its file is wrong.
    """
    name = reporter.name_of("on")
    if on is None:
        if reset:
            what = reporter.name_of("reset")
            raise ScenarioError(f"{what}: a simulated rig has no faults to reset; it needs {name}")
        yield None
        return
    from twin.run.connect import connect
    from twin.scenario.rig import check_rig, read_rig

    if scenario.sensors.ideal:
        raise ScenarioError(f"{name}: no rig measures its full state; set sensors.ideal=false")
    if on != EMULATED:
        if scenario.change:
            raise ScenarioError(
                f"{name} {on}: [[change]] changes a simulated rig, never a real one; leave it out"
            )
        for key in keys:
            if key.startswith(SIMULATION_ONLY):
                raise ScenarioError(
                    f"{name} {on}: {key} describes a simulated rig and changes nothing of a real "
                    "one; leave it out, or set what the rig has in its file"
                )
        yield connect(scenario, read_rig(Path(on)), reset=reset)
        return
    from twin.emulator.process import emulated
    from twin.emulator.serve import follow_changes
    from twin.run.plants import believed

    # what a virtual rig knows of its cams is part of its scenario
    known = believed(scenario)
    with emulated(scenario) as virtual:
        tables = check_rig(virtual.tables, EMULATED)
        host = connect(scenario, tables, reset=reset, transmission=known)
        follow_changes(host, scenario, known, virtual.begin)
        yield host
        reporter.note(virtual.lag())


def tell_timing(rig: HardwareRig, reporter: Reporter) -> None:
    """Tell the timing of the real-time loop, and the conditions that were detected.

    If one of them ended the run while the computer was late, that comes first.
    """
    from twin.hal.interface import Severity

    mild = Severity.WARNING
    stopped = any(entry.note.condition.severity is not mild for entry in rig.journal)
    if stopped and (line := rig.clock.timing.blame()):
        reporter.note(line, weighty=True)
    for line in (*rig.scheduling, *rig.clock.timing.text()):
        reporter.note(line)
    for at, note in rig.journal:
        reporter.note(f"{at:.3f} s {note.condition.severity}: {note.text}", weighty=True)


@contextmanager
def streamed(scenario: Scenario, folder: Path, attach: Attach) -> Iterator[Attach]:
    """Have what a run records written by another process while it lasts.

    Where the run is killed, or cannot be kept, that remains; else it is gone.

    Args:
        scenario: What is run.
        folder: Holds no run.
        attach: What else is given the recorder before the run.
    """
    from twin.run.files import STREAM
    from twin.run.finished import described
    from twin.view.live_process import LiveProcess

    file = folder / STREAM
    with ExitStack() as end:

        def both(recorder: Recorder) -> None:
            attach(recorder)
            live = LiveProcess(_stream, (file, recorder.units, described(scenario)))
            end.callback(live.close)
            end.callback(live.finish)
            live.begun()
            live.watch(recorder)

        yield both
    file.unlink(missing_ok=True)
    with suppress(OSError):  # there is none, or it holds more
        folder.rmdir()


def _stream(
    buffer: tuple[int, int, str], file: Path, units: Mapping[str, str], metadata: Mapping[str, Any]
) -> None:
    """Write what is recorded until the run has ended, or its process is gone."""
    from twin.jobs import orphaned
    from twin.run.record import stream
    from twin.view.live_process import SharedRingBuffer, step_back

    step_back()
    with closing(SharedRingBuffer(*buffer)) as ring, ExitStack() as end:
        append = None
        while True:
            done = ring.done or orphaned()
            if ring.columns and len(rows := ring.take()):
                append = append or end.enter_context(stream(file, ring.columns, units, metadata))
                append(rows)
            if done:
                return
            time.sleep(EVERY)
