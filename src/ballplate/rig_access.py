"""The rig of a run, real or emulated: opened, with planned faults, and its timing reported."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter
from twin.base.errors import RigError, ScenarioError

if TYPE_CHECKING:
    from twin.devices.rig import HardwareRig
    from twin.emulator.fault_lines import PlannedFault
    from twin.emulator.serve import Emulator
    from twin.hal.interface import Condition
    from twin.scenario.rig import RigFile
    from twin.scenario.schema import Scenario


def rig_label(on: str) -> str:
    """The title of a rig file in tables and pictures; its name where it has none.

    Raises:
        TwinError: If there is no such file, or it is wrong: before anything of a bus is imported.
    """
    from twin.scenario.rig import RigFile, read_rig

    default = RigFile.model_fields["title"].default
    title = default if on == EMULATED_RIG else read_rig(Path(on)).title
    return f"rig {Path(on).stem}" if title == default else title


EMULATED_RIG = "emulated"
"""The word for the virtual rig in place of a rig file."""
SIMULATION_ONLY = ("plant.", "sensors.", "disturbance.", "rig.cams", "rig.cam_")
"""Beginnings of the keys that describe a simulated rig and mean nothing to a real one."""


@contextmanager
def rig_of(
    on: str, scenario: Scenario, reporter: Reporter
) -> Iterator[tuple[RigFile, Emulator | None]]:
    """The file of a rig; of the virtual rig, which runs meanwhile, also who pushes it about.

    Args:
        on: Rig file or ``emulated``.
        scenario: What the virtual rig simulates.
        reporter: Receives by how much it lagged.

    Raises:
        TwinError: If there is no such rig, or its file is wrong.
    """
    from twin.scenario.rig import check_rig, read_rig

    if on != EMULATED_RIG:
        yield read_rig(Path(on)), None
        return
    from twin.emulator.serve import serve_rig

    with serve_rig(scenario) as virtual:
        yield check_rig(virtual.tables, EMULATED_RIG), virtual
        reporter.note(virtual.lag())


def plan_faults_of_run(
    on: str | None, scenario: Scenario, faults: Sequence[str], reporter: Reporter
) -> list[PlannedFault]:
    """Plan the faults that the virtual rig injects into itself in a run.

    Args:
        on: Rig file, ``emulated`` or None.
        scenario: What is to run, with faults of its own.
        faults: Further ones, ``SECONDS LINE`` each.
        reporter: Names options in messages.

    Raises:
        ScenarioError: If a fault is none, or the rig is not the virtual one.
    """
    texts = [*faults, *(f"{each.at:g} {each.name}" for each in scenario.fault)]
    if not texts:
        return []
    what = reporter.name_of("faults") if faults else "[[fault]]"
    from twin.emulator.fault_lines import plan_faults

    planned = plan_faults(texts, scenario.duration, what)  # a wrong name first
    if on != EMULATED_RIG:
        name = reporter.name_of("on")
        raise ScenarioError(
            f"{what}: only the virtual rig can inject faults; add {name} {EMULATED_RIG}"
        )
    return planned


@contextmanager
def open_rig(
    on: str | None,
    scenario: Scenario,
    keys: Sequence[str],
    reporter: Reporter,
    *,
    reset: bool,
    planned: Sequence[PlannedFault] = (),
    hear: Callable[[Any], None] | None = None,
    try_first: Callable[[str, RigFile], None] = lambda *_: None,
) -> Iterator[tuple[HardwareRig | None, Scenario]]:
    """The requested rig, not switched on, or None for the simulation; the scenario in its limits.

    Args:
        on: Rig file, ``emulated`` or None.
        scenario: What is to run on it.
        keys: What is changed of the scenario.
        reporter: Receives by how much the virtual rig lagged.
        reset: Whether faults found in the drives are reset.
        planned: Faults of the virtual rig.
        hear: Is given every frame on its CAN bus.
        try_first: Tries a scenario that is ``rehearsed`` on the twin of the rig of a file; is given
            what ``on`` names, and the file.

    Raises:
        TwinError: If there is no such rig, or its file is wrong.
    """
    name = reporter.name_of("on")
    if on is None:
        if reset:
            what = reporter.name_of("reset")
            raise ScenarioError(f"{what}: a simulated rig has no faults to reset; add {name}")
        yield None, scenario
        return
    from twin.run.connect import connect
    from twin.run.controller_building import build_reference
    from twin.run.plants import assumed_transmission

    if on == EMULATED_RIG:
        from twin.emulator.injection import inject
    if scenario.sensors.ideal:
        raise ScenarioError(
            f"{name}: a rig does not measure its full state; set sensors.ideal=false"
        )
    if scenario.change:
        raise ScenarioError(f"{name} {on}: [[change]] works on a simulated rig only; remove it")
    if on != EMULATED_RIG:
        for key in keys:
            if key.startswith(SIMULATION_ONLY):
                raise ScenarioError(
                    f"{name} {on}: {key} describes a simulated rig and has no effect on a real "
                    "one; leave it out, or set what the rig has in its file"
                )
    else:
        _judge_computer(f"{name} {on}", scenario, reporter)
    with rig_of(on, scenario, reporter) as (file, virtual):
        if virtual is None:
            if scenario.rehearsed:
                try_first(on, file)
            real = connect(scenario, file, reset=reset, hear=hear)
            build_reference(scenario, real.supervisor.limits.area)
            _judge_computer(f"{name} {on}", scenario, reporter)
            yield real, file.limited(scenario)
            return
        # what a virtual rig knows of its cams is part of its scenario
        known, paused = assumed_transmission(scenario), virtual.pauses.paused
        real = connect(scenario, file, reset=reset, transmission=known, paused=paused, hear=hear)
        with inject(planned, virtual.tell, real):
            yield real, scenario


def _judge_computer(where: str, scenario: Scenario, reporter: Reporter) -> None:
    """Say whether this computer is fast enough for a controller, before anything moves.

    Raises:
        RigError: It can keep no period.
    """
    from twin.run.connect import ComputingTime

    time = ComputingTime.measured(scenario)
    if time.never:
        raise RigError(f"{where}: {time.text}, so that no period can be kept; {time.advice}")
    if not time.enough:
        reporter.note(f"{time.text}: may be too late now and then; {time.advice}", weighty=True)


def tell_timing(rig: HardwareRig, reporter: Reporter) -> None:
    """Tell the timing of the real-time loop, and the conditions that were detected.

    If one of them ended the run while the computer was late, that comes first.
    """
    from twin.devices.realtime import describe_lateness
    from twin.hal.interface import Severity

    mild = Severity.WARNING
    stopped = any(entry.note.condition.severity is not mild for entry in rig.journal)
    if stopped and (line := describe_lateness(rig.clock.timing.as_dict())):
        reporter.note(line, weighty=True)
    for line in (*rig.scheduling, *rig.clock.timing.text()):
        reporter.note(line)
    for line in summarize_events([(at, note.condition, note.text) for at, note in rig.journal]):
        reporter.note(line, weighty=True)


def summarize_events(events: Sequence[tuple[float, Condition, str]]) -> list[str]:
    """A line for each event that levelled or stopped the rig, and for all warnings of one cause.

    Args:
        events: Time in s, condition and text of each, in the order of their times.
    """
    from twin.hal.interface import Severity

    lines: list[str] = []
    warnings: dict[tuple[str, str], list[tuple[float, str]]] = {}
    for at, condition, text in events:
        if condition.severity is not Severity.WARNING:
            lines.append(f"{at:.3f} s {condition.severity}: {text}")
            continue
        where = text.partition(f": {condition.name}")[0]
        warnings.setdefault((condition.name, where), []).append((at, text))
    for (name, where), found in warnings.items():
        first, text = found[0]
        if len(found) == 1:
            lines.append(f"{first:.3f} s warning: {text}")
        else:
            ends = dict.fromkeys(f"{at:.3f}" for at in (first, found[-1][0]))
            span = f"{' to '.join(ends)} s"
            seen = text.removeprefix(f"{where}: {name}: ")
            lines.append(f"{span} warning: {where}: {name}: {len(found)} reports; first: {seen}")
    return lines
