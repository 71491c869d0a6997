"""Runs in the viewer: recorded ones as an ``.rrd`` file, live ones row by row."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from controllers.arrays import Array
from twin.base.writing import write_whole
from twin.hal.interface import SCREEN_SIZE_M
from twin.run.finished import Run
from twin.scenario.schema import Scenario
from twin.view.live_process import Address, SharedRingBuffer, step_back
from twin.view.streams import (
    LANES_GROUP,
    PLOT_TABLES,
    TIMELINE_NAME,
    TWIN_PLOTS,
    TWIN_RANGE,
    Batch,
    RunStream,
    event_texts,
)
from twin.view.viewer import environment

PLOT_GROUND, MECHANISM_GROUND = (16, 18, 22), (30, 33, 38)
"""Colours of the ground of plots and plate and of the mechanism's, whatever theme a viewer has: no
recording and no blueprint can choose it, and lines that are seen on this are not on white."""


def blueprint(
    roots: Sequence[str], groups: Collection[str], size: tuple[float, float] = SCREEN_SIZE_M
) -> rrb.Blueprint:
    """The arrangement for one run, or for several side by side.

    Args:
        roots: Root entities of the runs.
        groups: Entities of the plots there are, below each root.
        size: Sides of the screen along x and y, m.
    """
    worlds = [_world(root, len(roots) > 1, size) for root in roots]
    left = rrb.Vertical(
        rrb.Horizontal(*worlds) if len(worlds) > 1 else worlds[0],
        rrb.Horizontal(
            _plate(roots, size),
            rrb.TextLogView(contents=[f"+ {root}/events" for root in roots], name="events"),
            column_shares=[2, 1],
        ),
        rrb.StateTimelineView(
            origin=f"{roots[0]}/{LANES_GROUP}" if len(roots) == 1 else "/",
            contents=[f"+ {root}/{LANES_GROUP}/**" for root in roots],
            name="states",
        ),
        row_shares=[7, 5, 5],
    )
    tabs: dict[str, list[rrb.View]] = {
        name: [*_plots(roots, groups, titles)] for name, titles in PLOT_TABLES.items()
    }
    right = rrb.Tabs(*(rrb.Vertical(*plots, name=name) for name, plots in tabs.items() if plots))
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE_NAME),
    )


def _plots(
    roots: Sequence[str], groups: Collection[str], titles: Mapping[str, str]
) -> list[rrb.TimeSeriesView]:
    return [
        rrb.TimeSeriesView(
            origin="/" if len(roots) > 1 else f"{roots[0]}/{entity}",
            contents=[f"+ {root}/{entity}/**" for root in roots],
            name=title,
            background=rrb.archetypes.PlotBackground(color=PLOT_GROUND),
            axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
            axis_y=rrb.ScalarAxis(range=TWIN_RANGE) if entity in TWIN_PLOTS else None,
        )
        for entity, title in titles.items()
        if entity in groups
    ]


EYE_POSITION_M = np.array([-0.75, 0.63, 0.32])
"""Viewpoint of the mechanism, m; nearer or farther if its plate differs in size."""


def _world(root: str, several: bool, size: tuple[float, float]) -> rrb.Spatial3DView:
    title = root.removeprefix("/").replace("\\", "") if several else "mechanism"
    return rrb.Spatial3DView(
        origin=f"{root}/mechanism",
        name=title,
        background=rrb.Background(color=MECHANISM_GROUND),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=max(np.divide(size, SCREEN_SIZE_M)) * EYE_POSITION_M,
            look_target=(0.0, 0.0, -0.12),
            eye_up=(0, 0, 1),
        ),
    )


def _plate(roots: Sequence[str], size: tuple[float, float]) -> rrb.Spatial2DView:
    ball = "ball blue" if len(roots) == 1 else "ball of each run in its colour"
    x, y = (550 * side for side in size)
    return rrb.Spatial2DView(
        origin=f"{roots[0]}/plate_mm" if len(roots) == 1 else "/",
        contents=[f"+ {root}/plate_mm/**" for root in roots],
        name=f"from above [mm]: {ball}, reference white, estimate gold, measured grey",
        background=PLOT_GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=[-x, x], y_range=[-y, y]),
    )


APPLICATION_ID = "ballplate"


def new_stream(name: str, recording: str | None = None) -> rr.RecordingStream:
    """A stream of our application; the caller connects it.

    Args:
        name: What the recording is called.
        recording: Its identity, if several processes add to it.
    """
    stream = rr.RecordingStream(APPLICATION_ID, recording_id=recording)
    stream.send_recording_name(name)
    return stream


def fix(stream: rr.RecordingStream, shapes: Iterable[tuple[str, rr.AsComponents]]) -> None:
    """Send what does not change: entity and shape."""
    for entity, shape in shapes:
        stream.log(entity, shape, static=True)


def send(
    stream: rr.RecordingStream, batches: Iterable[Batch], timeline: str = TIMELINE_NAME
) -> None:
    """Send batches of columns on a time line."""
    for batch in batches:
        # Rerun rounds the times of rows, but cuts those of columns
        whole = np.round(1e9 * batch.time).astype("timedelta64[ns]")
        time = rr.TimeColumn(timeline, duration=whole)
        rr.send_columns(batch.entity, indexes=[time], columns=batch.columns, recording=stream)


def _plan(
    streams: Sequence[RunStream], blocks: Sequence[Mapping[str, Array]], more: Iterable[str] = ()
) -> rrb.Blueprint:
    """How runs are arranged, by rows of each, and further plots."""
    both = zip(streams, blocks, strict=True)
    groups = {group for each, rows in both for group in each.plots(rows)}
    groups |= {*more}
    return blueprint([each.root for each in streams], groups, streams[0].scenario.plant.size)


def write(path: Path, runs: Sequence[Run]) -> None:
    """Write runs side by side on one time line into an ``.rrd`` file.

    Made in memory, because the library's own file writer only logs that a disk is full.

    Raises:
        RecordError: If the file cannot be written.
        TwinError: If a run's scenario cannot be assembled.
    """
    stream, together = new_stream(runs[0].name), len(runs) > 1
    memory = stream.memory_recording()
    streams = [
        RunStream(run.name, run.scenario, i if together else None, run.followed)
        for i, run in enumerate(runs)
    ]
    plan = _plan(streams, [run.rows for run in runs])
    stream.send_blueprint(plan, make_active=True, make_default=True)
    for each, run in zip(streams, runs, strict=True):
        fix(stream, (*each.fixed(), *each.styles(run.rows)))
        send(stream, each.batches(run.rows))
        for severity, level in EVENT_LEVELS.items():
            events = [
                (float(event["time"]), str(event["text"]))
                for event in run.events
                if event["severity"] == severity
            ]
            send(stream, event_texts(each.root, events, level))
    stream.flush()
    write_whole(path, memory.drain_as_bytes())
    stream.disconnect()


EVENT_LEVELS = {"warning": "WARN", "level": "ERROR", "stop": "ERROR"}
"""Level of the log line of a recorded condition by its severity."""
POLL_INTERVAL_S = 0.08
"""Seconds between two looks for new rows."""
MAX_ROWS_AT_ONCE = 2000
"""Rows sent at a time, so that a view that is behind a fast run still moves."""


def work(
    buffer: Address, scenario: Scenario, name: str, url: str, recording: str | None, twin: bool
) -> None:
    """Show a run live: send rows until the writer has ended or died; the body of the process.

    Args:
        buffer: Where the rows come from.
        scenario: What is run.
        name: What the run is called.
        url: Address of the viewer, or of the server of a page.
        recording: Identity of the recording, if a second process adds to it.
        twin: Whether that is the run's twin, which then has plots.
    """
    step_back()
    os.environ.update(environment())
    with closing(SharedRingBuffer(*buffer)) as ring:
        stream, run = new_stream(name, recording), RunStream(name, scenario)
        begun = False
        for block in ring.blocks(POLL_INTERVAL_S, MAX_ROWS_AT_ONCE):
            if not block or not len(block["time"]):
                continue
            if not begun:
                plan = _plan([run], [block], TWIN_PLOTS if twin else ())
                stream.connect_grpc(url, default_blueprint=plan)
                if twin:  # its process may have come first, and the viewer made its own plan
                    stream.send_blueprint(plan, make_active=True, make_default=True)
                fix(stream, (*run.fixed(), *run.styles(block)))
                begun = True
            send(stream, run.batches(block))
            stream.flush()
