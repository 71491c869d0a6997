"""A trace of a CAN bus in the viewer: states of nodes and drives as lanes, signals in SI units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from controllers.arrays import Array
from twin.base.writing import write_whole
from twin.devices.akd import protocol
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.object_names import STATUS, axis_of
from twin.devices.akd.rhythms import LONG_PAUSE
from twin.view.lanes import BAD, CALM, GOOD, IDLE_COLOUR, WARNING, Lane, Rgb, changes, lane_columns
from twin.view.recording import PLOT_GROUND, fix, new_stream, send
from twin.view.streams import LANES_GROUP, LINE_COLOURS, Batch, line

BUS_TIMELINE = "time [s]"
"""Seconds since the first frame."""
MAX_PLOTS = 8
"""Objects of PDOs that are drawn, those of most nodes first; the recording has all."""
NO_SIGNAL_OBJECTS = {0x1001, 0x2001, 0x603F, 0x6040, STATUS, 0x6060, 0x6061, 0x60FD}
"""Objects that are lanes or events, and no signal: words, modes, errors, inputs."""
NETWORK_COLOURS: Mapping[str, Rgb] = {
    "booting": WARNING,
    "pre-operational": CALM,
    "operational": GOOD,
    "stopped": BAD,
}
DRIVE_COLOURS: Mapping[str, Rgb] = {
    protocol.DriveState.OPERATION_ENABLED.value: GOOD,
    protocol.DriveState.SWITCHED_ON.value: CALM,
    protocol.DriveState.READY.value: CALM,
    protocol.DriveState.SWITCH_ON_DISABLED.value: IDLE_COLOUR,
    protocol.DriveState.QUICK_STOP.value: WARNING,
    protocol.DriveState.FAULT_REACTION.value: BAD,
    protocol.DriveState.FAULT.value: BAD,
}
SYNC_COLOURS: Mapping[str, Rgb] = {"regular": GOOD, "late": WARNING}
TRACE_EVENT_LEVELS = {"EMCY": "ERROR", "bus": "ERROR", "gap": "WARN"}
"""Level of the log line of an event by its kind; others are information."""


def lanes(conversation: Conversation) -> Iterator[tuple[str, Lane, Mapping[str, Rgb]]]:
    """The lanes of a trace: name, states over time, and the colour of each state.

    For each node its network state and, for each axis, the state that its status word shows; for
    the bus, whether SYNC comes regularly.
    """
    sync = np.array(conversation.sync)
    if len(sync) > 2:
        pause = np.diff(sync)
        late = np.where(pause > LONG_PAUSE * np.median(pause), "late", "regular")
        yield "SYNC", changes(sync[:-1], late), SYNC_COLOURS
    for number, node in sorted(conversation.nodes.items()):
        beats = [
            (each.time, each.text)
            for each in conversation.events
            if each.who == node.name and each.kind == "heartbeat"
        ]
        if beats:
            times, texts = zip(*beats, strict=True)
            yield f"{node.name} network", Lane(np.array(times), [*texts]), NETWORK_COLOURS
        for (of, key), series in conversation.series.items():
            index, axis = axis_of(key[0])
            if of != number or index != STATUS or not len(series.time):
                continue
            states = [protocol.state(int(word)).value for word in series.counts]
            name = f"{node.name} drive" + (f" axis {axis}" if axis > 1 else "")
            yield name, changes(np.array(series.time), np.array(states)), DRIVE_COLOURS


def signals(conversation: Conversation) -> dict[str, dict[str, tuple[Array, Array]]]:
    """Times in s and values, (K,) each, of what PDOs carried, by object with its unit and by node.

    Status, control and other words that are lanes or events are left out.
    """
    found: dict[str, dict[str, tuple[Array, Array]]] = {}
    for (number, key), series in conversation.series.items():
        if axis_of(key[0])[0] in NO_SIGNAL_OBJECTS:
            continue
        factor, unit = conversation.objects.scale(number, key)
        values = np.array(series.counts, float) * (factor if unit else 1.0)
        name = conversation.objects.name(number, key) + (f" [{unit}]" if unit else "")
        found.setdefault(name, {})[conversation.called(number)] = np.array(series.time), values
    return dict(sorted(found.items(), key=lambda each: -len(each[1])))


def write_bus(path: Path, conversation: Conversation, name: str) -> None:
    """Write a decoded trace as an ``.rrd`` file with its own arrangement.

    Args:
        path: The file.
        conversation: The trace.
        name: What the recording is called.

    Raises:
        RecordError: If the file cannot be written.
    """
    stream = new_stream(name)
    memory = stream.memory_recording()
    plots = signals(conversation)
    stream.send_blueprint(_arrange(list(plots)[:MAX_PLOTS]), make_active=True, make_default=True)
    fix(stream, _describe_entities(conversation, plots))
    send(stream, _batches(conversation, plots), BUS_TIMELINE)
    stream.flush()
    write_whole(path, memory.drain_as_bytes())
    stream.disconnect()


def _arrange(plots: list[str]) -> rrb.Blueprint:
    drawn = [
        rrb.TimeSeriesView(
            origin=f"/{rr.escape_entity_path_part(title)}",
            name=title,
            background=rrb.archetypes.PlotBackground(color=PLOT_GROUND),
            axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        )
        for title in plots
    ]
    left = rrb.Vertical(
        rrb.StateTimelineView(origin=f"/{LANES_GROUP}", name="states"),
        rrb.TextLogView(contents=["+ /events"], name="events"),
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*drawn)) if drawn else left,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=BUS_TIMELINE),
    )


def _lane_entity(name: str) -> str:
    return f"/{LANES_GROUP}/{rr.escape_entity_path_part(name.replace(' ', '_'))}"


def _describe_entities(
    conversation: Conversation, plots: Mapping[str, Mapping[str, tuple[Array, Array]]]
) -> Iterator[tuple[str, rr.AsComponents]]:
    for name, _, colours in lanes(conversation):
        look = rr.StateConfiguration(values=list(colours), colors=[*colours.values()])
        yield _lane_entity(name), look
    for title, lines in plots.items():
        for k, node in enumerate(lines):
            entity = f"/{rr.escape_entity_path_part(title)}/{rr.escape_entity_path_part(node)}"
            yield entity, line(LINE_COLOURS[k % len(LINE_COLOURS)], 1.5, node)


def _batches(
    conversation: Conversation, plots: Mapping[str, Mapping[str, tuple[Array, Array]]]
) -> Iterator[Batch]:
    for name, lane, _ in lanes(conversation):
        if len(lane.time):
            yield Batch(_lane_entity(name), lane.time, lane_columns(lane.states))
    for title, lines in plots.items():
        for node, (time, values) in lines.items():
            entity = f"/{rr.escape_entity_path_part(title)}/{rr.escape_entity_path_part(node)}"
            yield Batch(entity, time, rr.Scalars.columns(scalars=values))
    events = conversation.events
    if events:
        texts = rr.TextLog.columns(
            text=[f"{each.who}: {each.kind}: {each.text}" for each in events],
            level=[TRACE_EVENT_LEVELS.get(each.kind, "INFO") for each in events],
        )
        yield Batch("/events", np.array([each.time for each in events]), texts)
