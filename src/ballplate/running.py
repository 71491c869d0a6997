"""One scenario run: on its plant, or a real or emulated rig, with the clean model as well."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import (
    AbstractContextManager,
    ExitStack,
    closing,
    contextmanager,
    nullcontext,
    suppress,
)
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from ballplate.changes import Changes, Settings, changes_of, scenario_of
from ballplate.rehearsing import rehearse
from ballplate.reporter import Reporter, default, writable
from twin.base.errors import LawError, RigError, ScenarioError, TwinError
from twin.base.shipped import find, shipped_in
from twin.base.writing import written_alone
from twin.run.files import STREAM_FILE, free

if TYPE_CHECKING:
    from ballplate.results import Result
    from twin.base.jobs import SecondProcess
    from twin.devices.rig import HardwareRig
    from twin.emulator.injection import PlannedFault
    from twin.emulator.serve import Emulator
    from twin.hal.interface import Condition
    from twin.hal.rig import Rig
    from twin.run.finished import Run
    from twin.run.record import Recorder
    from twin.scenario.rig import RigFile
    from twin.scenario.schema import Scenario
    from twin.view.live_process import LiveProcess


CLEAN_LABEL = "clean model"
"""The same controller on the frictionless equations (5.9) it was designed on."""
PYTHON_LABEL = "Python"
"""The run of the controller in Python, shown with that of a program."""
WORTH_PROCESS = 5.0
"""Simulated seconds from which a process of its own saves time."""
Attach = Callable[["Recorder"], None]
"""Called with the recorder before the run, to observe it."""


def run(
    scenario: str | Path,
    settings: Settings = (),
    *,
    beside: str | Path | Sequence[str | Path] = (),
    out: str | Path | None = None,
    on: str | None = None,
    reset: bool = False,
    faults: Sequence[str] = (),
    trace: str | Path | None = None,
    watch: Callable[[Scenario], AbstractContextManager[Attach]] | None = None,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Result:
    """Run a scenario, and the clean model as well if the scenario compares with it.

    If the controller is a program, ``board``, the one in Python is run as well, simulated.

    ``run("circle", controller={"kind": "lqr"}, duration=12)`` and ``ballplate run circle --set
    controller.kind=lqr --set duration=12`` give the same record, bit for bit. Ctrl-C ends the run
    in order: the result has what was recorded, with the outcome ``aborted``.

    Args:
        scenario: A shipped scenario, one of ``scenarios()``, or a TOML file.
        settings: Changes of it, by dotted keys or as texts ``KEY=VALUE``.
        beside: Scenarios to run as well, simulated and changed alike, for table and picture.
        out: Folder to save in; see ``Result.save`` for later. A run that is interrupted leaves one
            that is finished there, and one on a rig any; it goes to the next free folder of the
            name.
        on: Rig file, or ``emulated`` for the virtual rig; simulated by default. A scenario that is
            ``rehearsed`` must keep its ball on the twin first.
        reset: Whether faults found in the drives of a rig are reset when switching on.
        faults: Faults that the virtual rig does to itself, ``SECONDS LINE`` each, as ``3 unplug``;
            the lines are those of ``ballplate emulate``.
        trace: Where all frames of the CAN bus of a rig are kept, in a format of python-can
            by the file's ending; in the run's folder as ``trace.log`` by default.
        watch: Makes the context of the run, which is given the recorder to observe.
        reporter: Receives progress and warnings; a notebook has its own.
        changes: What is changed of it, by tables: ``plant={"friction": {"rolling_mm": 0}}``.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown, out of range or
            cannot be assembled: one line with what, where, and what is allowed.

    Examples:
        >>> import ballplate as bp
        >>> bp.run("circle", ["plant.kind=lagrange"], controller={"kind": "lqr"}, duration=4)
        <Result 'Circle ... (...controller.kind=lqr, duration=4)': finished, tracking error 53.4 %>
    """
    report = reporter or default()
    others = [beside] if isinstance(beside, str | Path) else beside
    for each in (scenario, *others):
        find(str(each))  # a wrong name is reported before anything heavy is imported
    changed = changes_of(settings, changes)
    chosen = scenario_of(scenario, changed)
    planned_faults(on, chosen, faults, report)  # a wrong name, too
    further = {Path(name).stem: scenario_of(name, changed) for name in others}
    if chosen.board is not None:
        further = {PYTHON_LABEL: chosen.model_copy(update={"board": None, "fault": ()})} | further
    from ballplate.results import Result, recorded
    from twin.base.jobs import SecondProcess, cores
    from twin.run.assemble import PLANTS
    from twin.run.finished import draw, holds_finished

    folder = writable(out, report)
    if folder is not None and on is not None:
        folder = free(folder)  # what was measured is not made again
    file = trace_file(trace, folder, on, report)
    keys = [each.key for each in changed]
    kind = "mujoco" if "parameters" in keys else chosen.plant.kind  # the twin of a foreign rig, too
    label = PLANTS[kind].label if on is None else rig_label(on)
    compared = chosen.baseline and kind == "mujoco"
    alone = nullcontext() if folder is None else written_alone(folder, report.name_of("out"))
    saves = chosen.duration >= WORTH_PROCESS and cores() > 1 and importable(chosen)
    parallel = SecondProcess(wanted=compared and on is None and saves)
    name, incomplete = Path(scenario).stem, list[str]()
    with alone, parallel as second, ExitStack() as written:
        attached = watch(chosen) if watch is not None else nullcontext(lambda _: None)
        with write_trace(file, report, bounded=trace is None, incomplete=incomplete) as heard:
            rig = open_rig(
                on,
                chosen,
                keys,
                report,
                reset=reset,
                faults=faults,
                hear=heard,
                try_first=partial(rehearse, scenario, changed, report),
            )
            with rig as (real, chosen), attached as attach:
                baseline = _begin_clean_run(chosen, second, report) if compared else None
                observed = attach
                if real is not None and folder is not None:
                    observed = written.enter_context(stream_record(chosen, folder, attach))
                done = one_run(chosen, label, report, observed, real)
                result = Result.from_run(done, name, label)
                # what is kept does not depend on anything that is done after the run
                if folder is not None:
                    if on is None and done.interrupted and holds_finished(folder):
                        folder = free(folder)  # what is finished is worth more than a beginning
                    recorded(result, folder)
        if incomplete and folder is not None:
            result.incomplete = tuple(incomplete)
            recorded(result, folder)
        if real is not None:
            tell_timing(real, report)
        if not done.interrupted:
            _run_others(result, baseline, further, report, real)
        if folder is not None:
            # a clean model that nobody waits for any more may keep the second process busy
            draw(result, folder, result.motions, second if result.finished else None)
        return result


def _run_others(
    result: Result,
    baseline: Callable[[Run], Run] | None,
    further: Mapping[str, Scenario],
    reporter: Reporter,
    rig: Rig | None,
) -> None:
    """Run the clean model, if there is one, and further scenarios for the picture of a run."""
    from ballplate.results import Result

    if baseline is not None:
        with suppress(KeyboardInterrupt), _keep_rig_outcome(reporter, rig):
            result.baseline = Result.from_run(baseline(result), result.name, CLEAN_LABEL)
    for name, its in further.items():
        with suppress(KeyboardInterrupt):
            result.beside[name] = Result.from_run(one_run(its, name, reporter), name)


@contextmanager
def _keep_rig_outcome(reporter: Reporter, rig: Rig | None) -> Iterator[None]:
    """Only report an error of a law: the record of the rig is kept."""
    try:
        yield
    except LawError as error:
        if rig is None:
            raise
        reporter.warn(f"{CLEAN_LABEL}: {error}")


TRACE_BUFFER_FRAMES = 1 << 18
"""Frames the buffer holds: more than a minute of two drives at 2 ms."""


def trace_file(
    trace: str | Path | None, folder: Path | None, on: str | None, reporter: Reporter
) -> Path | None:
    """Where the trace of a run goes; None for nowhere.

    Raises:
        TwinError: If one is asked for of a simulated rig, or in no format that is known.
    """
    if on is None:
        if trace is not None:
            what, needed = reporter.name_of("trace"), reporter.name_of("on")
            raise ScenarioError(f"{what}: a simulated rig has no bus; add {needed}")
        return None
    from twin.devices.akd import TRACE_FILE
    from twin.devices.akd.traces import check_ending

    if trace is None:
        with_bus = find_spec("can") is not None
        return folder / TRACE_FILE if folder is not None and with_bus else None
    check_ending(Path(trace))
    return Path(trace)


@contextmanager
def write_trace(
    file: Path | None,
    reporter: Reporter,
    *,
    bounded: bool,
    incomplete: list[str] | None = None,
) -> Iterator[Callable[[Any], None] | None]:
    """Have the frames of a bus written by a second process; handing one over never waits.

    The end of the context waits for that process for as long as it makes progress. An error of the
    run within knows where the trace lies.

    Args:
        file: Where; None for nowhere.
        reporter: Is warned if the trace is not whole.
        bounded: Whether only the beginning and the end of a long trace are kept.
        incomplete: Takes in the same line.
    """
    if file is None:
        yield None
        return
    from twin.devices.akd.recording import FRAME_COLUMNS, append_trace, to_row
    from twin.devices.akd.traces import PART_BYTES, seal
    from twin.view.live_process import EVIDENCE_PATIENCE, LiveProcess

    more = append_trace, file, PART_BYTES if bounded else None
    with closing(
        LiveProcess(_write, more, rows=TRACE_BUFFER_FRAMES, width=len(FRAME_COLUMNS))
    ) as live:
        put = live.take_rows(FRAME_COLUMNS)
        live.begun()
        try:
            yield lambda message: put(to_row(message))
        except TwinError as error:
            live.finish(EVIDENCE_PATIENCE)
            if live.written:
                error.args = (f"{error}; the frames of the bus: ballplate trace {file}",)
            raise
        ended = live.finish(EVIDENCE_PATIENCE)
        if not live.written:
            if not bounded:
                reporter.warn(f"{file}: not written: there was no frame on a CAN bus")
            return
        if live.missing or not ended:
            lost = "its last frames may be missing"
            if live.missing:
                lost = f"{live.missing} of {live.written} frames are missing"
            reporter.warn(f"{file}: {lost}: {_blame(live)}")
            if incomplete is not None:
                incomplete.append(f"{file.name}: {lost}: {_blame(live)}")
        if bounded:
            seal(file)


def _blame(live: LiveProcess) -> str:
    """Why a process has not written all that it was given."""
    if live.alive:
        return "the computer was too busy, or its disk too slow"
    if live.dropped:
        return "the computer was too busy"
    return "the process that writes it ended before; is the disk full?"


def one_run(
    scenario: Scenario,
    label: str,
    reporter: Reporter,
    attach: Attach = lambda _: None,
    rig: Rig | None = None,
    *,
    path: bool = True,
) -> Run:
    """Run a scenario with its warnings and its progress.

    Args:
        scenario: What to run.
        label: What the progress calls it.
        reporter: Receives progress and warnings.
        attach: Is given the recorder before the run.
        rig: A real rig; simulated by default.
        path: Whether to warn of a reference that the plate cannot give.

    Raises:
        TwinError: If the scenario cannot be assembled.
    """
    from twin.run import finished

    warn_of_dangers(scenario, reporter)
    if path:
        warn_of_path(scenario, reporter)
    with reporter.progress(label, scenario.duration) as advance:
        return finished.run(scenario, advance, attach, rig)


UNSTABLE_ADVICE = (
    "; with these gains the ball may be lost: `ballplate run cure{on}{more}` has a law that knows "
    "how late the plate is, and `ballplate tune {law}{on}` searches other gains"
)
LATER_WARNING = (
    "drives and dead time are {:.0f} ms later than rig.plate_lag and predictor.delay say",
    30,
)
EARLIER_WARNING = "the dead time is {:.0f} ms shorter than predictor.delay", 15
"""How a rig may differ from what the cure assumes, and from how many ms on its error may double."""


def warn_of_dangers(scenario: Scenario, reporter: Reporter, label: str = "") -> None:
    """Warn of an unstable loop, a slow observer, a dither or a delay that is too large.

    Args:
        scenario: What is to run.
        reporter: Receives progress and warnings.
        label: Which of several runs it is.
    """
    from controllers.analysis import instability, slow_observer
    from controllers.ballplate import LONGEST_LAG
    from twin.run.assemble import build_controller, own_errors

    with own_errors():
        controller = build_controller(scenario)
    (late, lag), knows = scenario.lateness, scenario.predictor
    assumed = scenario.rig.plate_lag
    unstable = instability(controller.law, controller.observer, dead_time=late, lag=lag)
    if unstable and (law := scenario.controller.kind) in shipped_in("tunes"):
        untold = lag > LONGEST_LAG and not assumed
        more = f" --set rig.plate_lag={lag:.2g}" if untold else ""
        unstable += UNSTABLE_ADVICE.format(law=law, on=_option_of_rig(scenario), more=more)
    dangers = [unstable]
    dangers.append(slow_observer(controller.law, controller.observer))
    dangers.append(weakened_dither(controller.law, scenario))
    dead = scenario.sensors.touch.dead_time - (knows.delay if knows else 0.0)
    encoders = getattr(scenario.observer, "plate", "") != "modelled"
    unknown = lag - assumed if assumed or not encoders else max(0.0, lag - LONGEST_LAG)
    drives = scenario.plant.servo.dead_time  # no assumed value contains it where there are encoders
    dead, unknown = (dead, unknown + drives) if encoders else (dead + drives, unknown)
    for (message, most), by in (
        (LATER_WARNING, 1000 * (dead + unknown)),
        (EARLIER_WARNING, -1000 * dead),
    ):
        if scenario.controller.kind == "stable_inversion" and by > most:
            dangers.append(f"{message.format(by)}: above {most} ms the cure may err twice as much")
    for danger in dangers:
        if danger:
            reporter.warn(f"{label}: {danger}" if label else danger)


def _option_of_rig(scenario: Scenario) -> str:
    """The option by which a command runs on the rig of a scenario; empty of the thesis's rig."""
    from twin.identify import logs
    from twin.scenario.schema import PlantTable

    plant, usual = (each.model_dump(mode="json") for each in (scenario.plant, PlantTable()))
    if name := logs.rig_of({"plant": plant}):
        return f" --on {name}"
    return "" if all(plant[key] == usual[key] for key in ("size", "axes")) else " --on RIG"


def weakened_dither(law: Any, scenario: Scenario) -> str:
    """Whether a dither needs more than the commands' limits, as one line; empty if not.

    Drives with a lag T are commanded sqrt(1 + (w T)^2) times the circle of the plate.
    """
    law, limits = getattr(law, "law", law), scenario.rig.limits
    w = 2 * math.pi * getattr(law, "dither_hz", 0.0)
    swing = getattr(law, "dither_deg", 0.0) * math.hypot(1, w * scenario.rig.plate_lag)
    rate, acceleration = swing * w, math.radians(swing) * w**2
    if rate <= limits.rate_deg and acceleration <= limits.acceleration:
        return ""
    return (
        f"controller.dither_deg: needs {rate:.3g} deg/s and {acceleration:.3g} rad/s^2 at "
        f"dither_hz = {law.dither_hz:g}; rig.limits allows {limits.rate_deg:g} and "
        f"{limits.acceleration:g}, so the plate swings less"
    )


def warn_of_path(scenario: Scenario, reporter: Reporter, label: str = "") -> None:
    """Warn of a reference that the plate cannot give, or that is to leave it after the run.

    Args:
        scenario: What is to run.
        reporter: Receives progress and warnings.
        label: Which of several runs it is.
    """
    from twin.run.finished import beyond_area, out_of_reach

    for line in (beyond_area(scenario), out_of_reach(scenario)):
        if line:
            reporter.warn(f"{label}: {line}" if label else line)


def importable(scenario: Scenario) -> bool:
    """Whether a second process knows the scenario's law, observer and reference, too."""
    from controllers.catalog import registered_names

    kinds = (scenario.controller.kind, scenario.observer.kind, scenario.reference.kind)
    return registered_names().isdisjoint(kinds)


def _begin_clean_run(
    scenario: Scenario, helper: SecondProcess, reporter: Reporter
) -> Callable[[Run], Run]:
    """Begin the run of the clean model in the second process, if there is one.

    What is returned gives its run, for as long as the run that it is given lasted.
    """
    import scipy.linalg  # noqa: F401  both processes need it: once, where the second is a fork

    from twin.run import finished
    from twin.scenario.load import clean, cut_short

    model = clean(scenario)
    if helper.there:
        result = helper.begin(finished.run, model)
        helper.begin(finished.load_drawing)

    def ended(done: Run) -> Run:
        if done.outcome != "finished":
            return one_run(cut_short(model, done.end), CLEAN_LABEL, reporter, path=False)
        if not helper.there:
            return one_run(model, CLEAN_LABEL, reporter, path=False)
        warn_of_dangers(model, reporter)
        with reporter.progress(CLEAN_LABEL, model.duration):
            return result()

    return ended


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
WRITE_INTERVAL_S = 0.25
"""Seconds from one writing of what has been recorded to the next."""
ROWS_AT_A_TIME = 2000
"""Rows written at a time, so that one sees a writer that is behind go on."""
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


def planned_faults(
    on: str | None, scenario: Scenario, faults: Sequence[str], reporter: Reporter
) -> list[PlannedFault]:
    """What the virtual rig is to do to itself in a run.

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
    from twin.emulator.injection import plan_faults

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
    faults: Sequence[str] = (),
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
        faults: Faults of the virtual rig, ``SECONDS LINE`` each.
        hear: Is given every frame on its CAN bus.
        try_first: Tries a scenario that is ``rehearsed`` on the twin of the rig of a file; is given
            what ``on`` names, and the file.

    Raises:
        TwinError: If there is no such rig, or its file is wrong.
    """
    name = reporter.name_of("on")
    planned = planned_faults(on, scenario, faults, reporter)
    if on is None:
        if reset:
            what = reporter.name_of("reset")
            raise ScenarioError(f"{what}: a simulated rig has no faults to reset; add {name}")
        yield None, scenario
        return
    from twin.run.assemble import assumed_transmission, build_reference
    from twin.run.connect import connect

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


@contextmanager
def stream_record(scenario: Scenario, folder: Path, attach: Attach) -> Iterator[Attach]:
    """Have what a run records written by a second process while it lasts.

    Where the run is killed, or cannot be kept, that remains; else it is removed.

    Args:
        scenario: What is run.
        folder: Holds no run.
        attach: What else is given the recorder before the run.
    """
    import pyarrow  # noqa: F401  a rig without record does not move

    from twin.run.finished import run_metadata
    from twin.run.record import stream
    from twin.view.live_process import EVIDENCE_PATIENCE, LiveProcess

    file = folder / STREAM_FILE
    with ExitStack() as end:
        writers: list[LiveProcess] = []

        def both(recorder: Recorder) -> None:
            attach(recorder)
            more = stream, file, recorder.units, run_metadata(scenario)
            live = LiveProcess(_write, more)
            end.callback(live.close)
            writers.append(live)
            live.begun()
            live.watch(recorder)

        try:
            yield both
        except BaseException:
            for live in writers:  # what they write is all there is
                live.finish(EVIDENCE_PATIENCE)
            raise
    file.unlink(missing_ok=True)
    with suppress(OSError):  # there is none, or it holds more
        folder.rmdir()


def _write(buffer: tuple[int, int, str], into: Callable[..., Any], *more: Any) -> None:
    """Write what is handed over until the run has ended, or its process has ended.

    Args:
        buffer: Where it is handed over.
        into: Makes the context in which columns are appended, of their names and ``more``.
        more: What that needs.
    """
    from twin.view.live_process import EVIDENCE_NICENESS, SharedRingBuffer, step_back

    step_back(EVIDENCE_NICENESS)
    with closing(SharedRingBuffer(*buffer)) as ring, ExitStack() as end:
        append = None
        for block in ring.blocks(WRITE_INTERVAL_S, ROWS_AT_A_TIME):
            if block and len(block["time"]):
                append = append or end.enter_context(into([*block], *more))
                append(block)
