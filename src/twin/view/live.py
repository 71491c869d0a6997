"""A run shown live: another process sends its rows to a viewer."""

from __future__ import annotations

import os
import re
import socket
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial

import rerun as rr

from controllers.arrays import Array
from twin.errors import ScenarioError, ViewError
from twin.jobs import orphaned
from twin.scenario.schema import Scenario
from twin.view.live_process import Address, LiveProcess, SharedRingBuffer, step_back
from twin.view.recording import blueprint, new_stream, send
from twin.view.signals import explained
from twin.view.streams import TIMELINE, Batch, RunStream
from twin.view.twin_stream import TWIN_RANGES, TWIN_WORDS
from twin.view.viewer import environment

EVERY = 0.08
"""Seconds between two looks for new rows."""
MOST = 2000
"""Rows sent at a time, so that a view that is behind a fast run still moves."""
DROPPED = "/view/dropped_rows"


def show(
    scenario: Scenario,
    name: str,
    url: str,
    *,
    rigs: tuple[int, ...] = (0,),
    recording: str | None = None,
    twin: bool = False,
) -> LiveProcess:
    """Show a run live.

    Args:
        scenario: What is run.
        name: What the run is called.
        url: Address of the viewer, or of the server of a page.
        rigs: Which of N rigs are shown, over each other.
        recording: Identity of the recording, if another process adds to it.
        twin: Whether that is the run's twin, which then has plots.
    """
    names = (name,) if len(rigs) == 1 else tuple(f"{name}-rig-{rig}" for rig in rigs)
    return LiveProcess(work, (scenario, names, url, recording, twin), rigs)


def address(text: str) -> str:
    """The address of a viewer in the viewer's own form, from HOST:PORT or that form itself.

    Raises:
        ScenarioError: If the text is neither.
    """
    host = r"[\w.\-]+|\[[0-9a-fA-F:]+\]"
    found = re.fullmatch(rf"(?:rerun\+http://)?({host}):(\d{{1,5}})(?:/proxy)?", text)
    if found is None or not 0 < int(found[2]) < 65536:
        raise ScenarioError(f"--connect '{text}': write HOST:PORT, as in 127.0.0.1:9876")
    return f"rerun+http://{found[1]}:{found[2]}/proxy"


def reach(url: str) -> str:
    """The address itself, if somebody listens there.

    Raises:
        ViewError: If nobody does.
    """
    host, _, port = url.removeprefix("rerun+http://").removesuffix("/proxy").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=2.0).close()
    except OSError as error:
        raise ViewError(f"{host}:{port}: no viewer there ({error.strerror or error})") from error
    return url


def work(
    buffer: Address,
    scenario: Scenario,
    names: tuple[str, ...],
    url: str,
    recording: str | None,
    twin: bool,
) -> None:
    """Send rows until the writer has ended, or is gone; the body of the process."""
    step_back()
    os.environ.update(environment())
    with closing(SharedRingBuffer(*buffer)) as ring:
        sender = partial(_begin, url=url, twin=twin)
        _send_rows(ring, scenario, new_stream(names[0], recording), names, sender)


def _send_rows(
    ring: SharedRingBuffer,
    scenario: Scenario,
    stream: rr.RecordingStream,
    names: tuple[str, ...],
    begin: Callable[[rr.RecordingStream, list[RunStream], dict[str, Array]], None],
) -> None:
    together = len(names) > 1
    runs = [RunStream(name, scenario, i if together else None) for i, name in enumerate(names)]
    while not ring.columns:
        if ring.done or orphaned():
            return
        time.sleep(EVERY)
    width = (len(ring.columns) - 1) // len(names)
    columns = ring.columns[1 : 1 + width]
    started = False
    shown = -1
    while True:
        done = ring.done or orphaned()
        rows = ring.take(MOST)
        for i, each in enumerate(runs):
            own = rows[:, 1 + i * width : 1 + (i + 1) * width]
            block = {"time": rows[:, 0], **dict(zip(columns, own.T, strict=True))}
            if len(rows) and not started:
                begin(stream, runs, block)
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
    runs: list[RunStream],
    block: dict[str, Array],
    *,
    url: str,
    twin: bool,
) -> None:
    """Connect, and send what does not change."""
    names = [each.name for each in runs]
    plots = [each.plots(block) for each in runs]
    groups = {group: explained([plot[group] for plot in plots], names) for group in plots[0]}
    groups |= TWIN_WORDS if twin else {}
    ranges = TWIN_RANGES if twin else {}
    roots = [each.root for each in runs]
    plan = blueprint(roots, groups, TIMELINE, live=True, ranges=ranges)
    stream.connect_grpc(url, default_blueprint=plan)
    if twin:  # whose process may have come first, and the viewer made a plan of its own
        stream.send_blueprint(plan, make_active=True, make_default=True)
    for each in runs:
        for entity, shape in (*each.fixed(), *each.styles(block)):
            stream.log(entity, shape, static=True)
