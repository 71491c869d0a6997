"""Runs sent to a Rerun stream: a file, a viewer, or whoever connects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import rerun as rr

from twin.errors import ViewError
from twin.run.record import write_whole
from twin.run.replay import Replay
from twin.view.layout import Layout, blueprint
from twin.view.streams import TIMELINE, Batch, Stream

APPLICATION = "ballplate"


def new_stream(name: str) -> rr.RecordingStream:
    """A stream of our application; what it is connected to is the caller's choice."""
    stream = rr.RecordingStream(APPLICATION)
    stream.send_recording_name(name)
    return stream


def send(stream: rr.RecordingStream, batch: Batch) -> None:
    """Send a batch of columns."""
    time = rr.TimeColumn(TIMELINE, duration=batch.time)
    rr.send_columns(batch.entity, indexes=[time], columns=batch.columns, recording=stream)


def write(path: Path, runs: Sequence[Replay], layout: Layout = "showing") -> None:
    """Write runs side by side on one time line into an ``.rrd`` file.

    Raises:
        RecordError: If the file cannot be written.
        TwinError: If a run's scenario cannot be assembled.
    """
    content = encoded(runs, layout)
    write_whole(path, lambda target: target.write_bytes(content))


def encoded(runs: Sequence[Replay], layout: Layout = "showing") -> bytes:
    """The content of an ``.rrd`` file of runs side by side.

    It is made in memory, because the library's own file writer only logs that a disk is full.
    """
    stream = new_stream(runs[0].name)
    memory = stream.memory_recording()
    _send_all(stream, runs, layout)
    stream.flush()
    content: bytes = memory.drain_as_bytes()
    stream.disconnect()
    return content


def forward(url: str, runs: Sequence[Replay], layout: Layout = "showing") -> None:
    """Send runs to the viewer that listens at an address.

    Raises:
        ViewError: If it does not take them.
    """
    stream = new_stream("view")
    stream.connect_grpc(url, default_blueprint=None)
    try:
        _send_all(stream, runs, layout)
        stream.flush(timeout_sec=30.0)
    except (RuntimeError, ValueError) as error:
        raise ViewError(f"the viewer at {url} does not answer: {error}") from error


def _send_all(stream: rr.RecordingStream, runs: Sequence[Replay], layout: Layout) -> None:
    together = len(runs) > 1
    streams = [
        Stream(run.name, run.scenario, i if together else None) for i, run in enumerate(runs)
    ]
    groups = {
        group for each, run in zip(streams, runs, strict=True) for group in each.plots(run.rows)
    }
    plan = blueprint([each.root for each in streams], groups, TIMELINE, layout)
    stream.send_blueprint(plan, make_active=True, make_default=True)
    for each, run in zip(streams, runs, strict=True):
        for entity, shape in (*each.fixed(), *each.styles(run.rows)):
            stream.log(entity, shape, static=True)
        for batch in each.batches(run.rows):
            send(stream, batch)
