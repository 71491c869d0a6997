"""The process that sends a running experiment to a viewer: it may hang, die or fall behind."""

from __future__ import annotations

import os
import time
from contextlib import closing

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from twin.scenario.schema import Scenario
from twin.view.layout import Layout, blueprint
from twin.view.recording import new_stream, send
from twin.view.ring import Ring
from twin.view.streams import TIMELINE, Batch, Stream
from twin.view.tap import Address, step_back
from twin.view.viewer import environment

EVERY = 0.08
"""Seconds between two looks for new rows."""
MOST = 2000
"""Rows sent at a time, so that one behind a fast run is seen to go on."""
DROPPED = "/view/dropped_rows"


def work(
    ring_address: Address,
    scenario: Scenario,
    names: tuple[str, ...],
    url: str,
    layout: Layout,
) -> None:
    """Send rows until the writer has ended, or is gone; the body of the process."""
    step_back()
    os.environ.update(environment())
    parent = os.getppid()
    with closing(Ring(*ring_address)) as ring:
        _send_rows(ring, scenario, names, url, layout, parent)


def _send_rows(
    ring: Ring,
    scenario: Scenario,
    names: tuple[str, ...],
    url: str,
    layout: Layout,
    parent: int,
) -> None:
    stream = new_stream(names[0])
    together = len(names) > 1
    streams = [Stream(name, scenario, i if together else None) for i, name in enumerate(names)]
    while not ring.columns:
        if ring.done or os.getppid() != parent:
            return
        time.sleep(EVERY)
    width = (len(ring.columns) - 1) // len(names)
    columns = ring.columns[1 : 1 + width]
    started = False
    shown = -1
    while True:
        done = ring.done or os.getppid() != parent
        rows = ring.take(MOST)
        for i, each in enumerate(streams):
            own = rows[:, 1 + i * width : 1 + (i + 1) * width]
            block = {"time": rows[:, 0], **dict(zip(columns, own.T, strict=True))}
            if len(rows) and not started:
                _begin(stream, streams, block, url, layout)
                started = True
            for batch in each.batches(block):
                send(stream, batch)
        if len(rows) and ring.dropped != shown:
            shown = ring.dropped
            send(stream, Batch(DROPPED, rows[-1:, 0], rr.Scalars.columns(scalars=[shown])))
        if len(rows):
            stream.flush()
        elif done:
            return
        if len(rows) < MOST:
            time.sleep(EVERY)


def _begin(
    stream: rr.RecordingStream,
    streams: list[Stream],
    block: dict[str, NDArray[np.floating]],
    url: str,
    layout: Layout,
) -> None:
    """Connect, and send what does not change."""
    groups = set(streams[0].plots(block))
    plan = blueprint([each.root for each in streams], groups, TIMELINE, layout, live=True)
    stream.connect_grpc(url, default_blueprint=plan)
    for each in streams:
        for entity, shape in (*each.fixed(), *each.styles(block)):
            stream.log(entity, shape, static=True)
