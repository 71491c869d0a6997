"""The record and the bus trace of a run, written by other processes while it lasts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter
from twin.base.errors import ScenarioError, TwinError, plural
from twin.run.files import STREAM_FILE

if TYPE_CHECKING:
    from twin.run.record import Recorder
    from twin.scenario.schema import Scenario
    from twin.view.live_process import LiveProcess


Attach = Callable[["Recorder"], None]
"""Called with the recorder before the run, to observe it."""
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
                lost = f"{live.missing} of {plural(live.written, 'frame')} missing"
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


WRITE_INTERVAL_S = 0.25
"""Seconds from one writing of what has been recorded to the next."""
ROWS_AT_A_TIME = 2000
"""Rows written at a time, so that one sees a writer that is behind go on."""


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
