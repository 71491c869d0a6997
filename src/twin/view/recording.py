"""Recorded runs as an ``.rrd`` file, sent to a viewer, or as a picture of the view."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import rerun as rr
from PIL import Image
from rerun.experimental import ViewerClient

from twin.errors import ViewError
from twin.run.finished import Run
from twin.view.layout import blueprint
from twin.view.saved_twin import saved_twin
from twin.view.signals import explained, shown_range
from twin.view.streams import TIMELINE, Batch, RunStream
from twin.view.twin_stream import TWIN_RANGES, TWIN_WORDS, Scores, TwinStream
from twin.view.viewer import headless
from twin.writing import write_whole

APPLICATION = "ballplate"
SETTLE = 9.0
"""Seconds after which the viewer has loaded everything and its notices have faded."""

MENU = 36
"""Height of the viewer's own menu, which is cut off."""


def new_stream(name: str, recording: str | None = None) -> rr.RecordingStream:
    """A stream of our application; what it is connected to is the caller's choice.

    Args:
        name: What the recording is called.
        recording: Its identity, if several processes add to it.
    """
    stream = rr.RecordingStream(APPLICATION, recording_id=recording)
    stream.send_recording_name(name)
    return stream


def send(stream: rr.RecordingStream, batch: Batch) -> None:
    """Send a batch of columns."""
    time = rr.TimeColumn(TIMELINE, duration=batch.time)
    rr.send_columns(batch.entity, indexes=[time], columns=batch.columns, recording=stream)


def begin_twin(stream: rr.RecordingStream, twin: TwinStream) -> None:
    """Send what does not change of a run's twin."""
    for entity, shape in twin.fixed():
        stream.log(entity, shape, static=True)


def add_twin(
    stream: rr.RecordingStream,
    twin: TwinStream,
    scores: Scores | None,
    events: Sequence[tuple[float, str]],
) -> None:
    """Send what the twin says: scores, and times in s and texts of what happened."""
    for batch in twin.batches(scores, events):
        send(stream, batch)


def write(path: Path, runs: Sequence[Run]) -> None:
    """Write runs side by side on one time line into an ``.rrd`` file.

    Raises:
        RecordError: If the file cannot be written.
        TwinError: If a run's scenario cannot be assembled, or what is saved of its twin is damaged.
    """
    content = encoded(runs)
    write_whole(path, lambda target: target.write_bytes(content))


def encoded(runs: Sequence[Run]) -> bytes:
    """The content of an ``.rrd`` file of runs side by side.

    Made in memory, because the library's own file writer only logs that a disk is full.
    """
    stream = new_stream(runs[0].name)
    memory = stream.memory_recording()
    _send_all(stream, runs)
    stream.flush()
    content: bytes = memory.drain_as_bytes()
    stream.disconnect()
    return content


def forward(url: str, runs: Sequence[Run]) -> None:
    """Send runs to the viewer that listens at an address.

    Raises:
        ViewError: If it does not take them.
    """
    stream = new_stream("view")
    stream.connect_grpc(url, default_blueprint=None)
    try:
        _send_all(stream, runs)
        stream.flush(timeout_sec=30.0)
    except (RuntimeError, ValueError) as error:
        raise ViewError(f"the viewer at {url} does not answer: {error}") from error


def _send_all(stream: rr.RecordingStream, runs: Sequence[Run]) -> None:
    together = len(runs) > 1
    streams = [
        RunStream(run.name, run.scenario, i if together else None, run.followed)
        for i, run in enumerate(runs)
    ]
    plots = [each.plots(run.rows) for each, run in zip(streams, runs, strict=True)]
    names = [run.name for run in runs]
    entities = {group for plot in plots for group in plot}
    shown = {group: [plot[group] for plot in plots if group in plot] for group in entities}
    groups = {group: explained(lines, names) for group, lines in shown.items()}
    ranges = {group: shown_range(lines) for group, lines in shown.items()}
    twins = [saved_twin(run) for run in runs]
    if any(twins):
        groups, ranges = groups | TWIN_WORDS, ranges | TWIN_RANGES
    plan = blueprint([each.root for each in streams], groups, TIMELINE, ranges=ranges)
    stream.send_blueprint(plan, make_active=True, make_default=True)
    for each, run in zip(streams, runs, strict=True):
        for entity, shape in (*each.fixed(), *each.styles(run.rows)):
            stream.log(entity, shape, static=True)
        for batch in each.batches(run.rows):
            send(stream, batch)
    for run, said in zip(runs, twins, strict=True):
        if said is not None:
            twin = TwinStream(run.name, run.scenario)
            begin_twin(stream, twin)
            add_twin(stream, twin, *said)


def screenshot(
    recording: Path, picture: Path, at: float, size: tuple[int, int] = (1600, 900)
) -> None:
    """Save what the viewer shows of a recording.

    Args:
        recording: The ``.rrd`` file.
        picture: The PNG file to write.
        at: Simulated time in s to show.
        size: Width and height in points.

    Raises:
        ViewError: If the viewer does not start.
        RecordError: If the picture cannot be written.
    """
    with headless(recording, size) as viewer:
        viewer.set_time(TIMELINE, duration=at, play_state="paused")
        time.sleep(SETTLE)
        write_whole(picture, lambda target: _take(viewer, target, size))


def _take(viewer: ViewerClient, target: Path, size: tuple[int, int]) -> None:
    """Save the viewer's window without its menu."""
    viewer.save_screenshot(str(target.resolve()))
    with Image.open(target) as large:
        scale = large.width // size[0]
        page = large.crop((0, scale * MENU, large.width, large.height)).convert("RGB")
        small = page.resize((size[0], size[1] - MENU), Image.Resampling.LANCZOS)
    small.save(target, optimize=True)
