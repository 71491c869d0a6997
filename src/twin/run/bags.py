"""Readers of messages of ROS 2, or in JSON: MCAP files, and bags in SQLite (.db3).

Any numeric field of a message is a column ``TOPIC/FIELD``, as ``/ball/pose.position.x``, an entry
of an array ``FIELD.0``, ``FIELD.1``, ...
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError
from twin.base.parts import extra
from twin.run.exporters import ROS2_TABLES, ros_field
from twin.run.readers import MAX_MATRIX_COLUMNS, ForeignTable
from twin.run.record import MOST_ROWS

if TYPE_CHECKING:
    from mcap.records import Schema

SIGNALS_TOPIC = "/signals"
"""Topic of an MCAP file of ours that has every column."""
BAGS_EXTRA = "mcap"
"""The extra that brings the readers."""
KNOWN_MESSAGES = ROS2_TABLES["messages"] | ROS2_TABLES["known"]
"""Name of a type of messages to its definition, for bags without definitions."""
KNOWN_PARTS = "".join(
    f"{80 * '='}\nMSG: {name}\n{text}"
    for name, text in (
        ROS2_TABLES["parts"]
        | ROS2_TABLES["known_parts"]
        | {name.replace("/msg/", "/"): text for name, text in ROS2_TABLES["known"].items()}
    ).items()
)
"""Definitions of the messages in them."""
MAX_MESSAGE_BYTES = 1 << 16
"""Larger messages are pictures and point clouds: they are left out."""
MAX_CLOCK_DIFFERENCE_S = 0.5
"""Difference between the offsets of the stamps of two topics up to which one clock made them."""
NANOSECONDS_PER_S = 1_000_000_000


class _Raw(NamedTuple):
    """A message as it was logged.

    Attributes:
        topic: Its topic.
        schema: Its type's name and definition.
        encoding: Of its data; ``cdr`` and ``json`` are read.
        data: Its bytes.
        logged: When it was logged, ns.
    """

    topic: str
    schema: Schema | None
    encoding: str
    data: bytes
    logged: int


def read_mcap(path: Path) -> ForeignTable:
    """The columns of an MCAP file: those of a run of ours, or every numeric field."""
    with extra(BAGS_EXTRA, f"{path.name}: an MCAP file"):
        from mcap.reader import make_reader  # noqa: PLC0415  of an extra
        from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415
    units: dict[str, str] = {}
    metadata: dict[str, Any] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for record in reader.iter_metadata():
            units |= record.metadata if record.name == "units" else {}
        for attached in reader.iter_attachments():
            if attached.media_type == "application/json":
                metadata[attached.name.removesuffix(".json")] = json.loads(attached.data)
        if units:
            rows = [message for *_, message in reader.iter_decoded_messages(topics=[SIGNALS_TOPIC])]
            if rows:
                own = {k: np.array([getattr(row, ros_field(k)) for row in rows]) for k in units}
                return ForeignTable(dict(own), units, metadata)
        messages = (
            _Raw(channel.topic, schema, channel.message_encoding, each.data, each.log_time)
            for schema, channel, each in reader.iter_messages()
        )
        return _of_messages(messages)


def read_bag(path: Path) -> ForeignTable:
    """The columns of a bag of ROS 2 in SQLite: of messages that it defines, or of common ones."""
    with extra(BAGS_EXTRA, f"{path.name}: a bag of ROS 2"):
        from mcap.records import Schema  # noqa: PLC0415  of an extra
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
        tables = {name for (name,) in base.execute("select name from sqlite_master")}
        if not {"topics", "messages"} <= tables:
            raise LogError(
                f"{path.name}: an SQLite database that is no bag of ROS 2; "
                f"sqlite3 -header -csv {path.name} 'select t, x, u from TABLE' > log.csv"
            )
        defined: dict[str, str] = {}
        if "message_definitions" in tables:
            query = "select topic_type, encoded_message_definition from message_definitions"
            defined = {str(kind): str(text) for kind, text in base.execute(query)}
        topics = {
            int(number): (str(name), str(kind), str(encoding))
            for number, name, kind, encoding in base.execute(
                "select id, name, type, serialization_format from topics"
            )
        }
        for _, kind, _ in topics.values():
            if (text := KNOWN_MESSAGES.get(kind)) is not None:
                defined.setdefault(kind, text + KNOWN_PARTS)
        schemas = {
            kind: Schema(id=k, name=kind, encoding="ros2msg", data=text.encode())
            for k, (kind, text) in enumerate(defined.items(), start=1)
        }

        def messages() -> Iterator[_Raw]:
            query = "select topic_id, timestamp, data from messages order by timestamp"
            for number, logged, data in base.execute(query):
                name, kind, encoding = topics[number]
                yield _Raw(name, schemas.get(kind), encoding, bytes(data), int(logged))

        return _of_messages(messages())


def _of_messages(messages: Iterable[_Raw]) -> ForeignTable:
    """Every numeric field of messages, at their own stamps or when they were logged."""
    from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415  of an extra

    factory = DecoderFactory()
    times: dict[str, list[tuple[float, float]]] = {}
    fields: dict[str, dict[str, dict[int, float]]] = {}
    skipped: dict[str, str] = {}
    first = None
    for count, each in enumerate(messages):
        if count >= MOST_ROWS:
            raise OSError(f"more than {MOST_ROWS} messages")
        decode = _decode_json if each.encoding == "json" else None
        decode = decode or factory.decoder_for(each.encoding, each.schema)
        if decode is None:
            what = each.schema.encoding if each.schema else "no definition of its messages"
            skipped[each.topic] = f"{each.encoding} with {what}; JSON and CDR with ros2msg are read"
            continue
        if len(each.data) > MAX_MESSAGE_BYTES:
            skipped[each.topic] = f"messages of {len(each.data) // 1000} kB"
            continue
        message = decode(each.data)
        first = each.logged if first is None else first
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        stamped = 0 if stamp is None else stamp.sec * NANOSECONDS_PER_S + stamp.nanosec
        own = times.setdefault(each.topic, [])
        # differences of whole nanoseconds: a double holds those since 1970 to 0.2 us only
        logged_s = (each.logged - first) / NANOSECONDS_PER_S
        own.append((logged_s, (stamped - first) / NANOSECONDS_PER_S if stamped else np.nan))
        columns = fields.setdefault(each.topic, {})
        with suppress(RecursionError):  # one in JSON may be nested without end
            for name, value in _numbers("", message):
                columns.setdefault(name, {})[len(own) - 1] = value
    return _table(times, fields, skipped)


def _decode_json(data: bytes) -> Any:
    """The content of a message in JSON, its numbers as floats; None where it is none."""
    with suppress(ValueError, RecursionError):
        return json.loads(data, parse_int=float)
    return None


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """The numbers of a message, or of a part of it, by their dotted names."""
    if isinstance(value, int | float):
        yield name, float(value)
    elif isinstance(value, dict):
        for part, inner in value.items():
            yield from _numbers(f"{name}.{part}" if name else part, inner)
    elif parts := getattr(value, "__slots__", ()):  # as mcap-ros2-support has the fields
        for part in filter(lambda part: part != "header", parts):
            yield from _numbers(f"{name}.{part}" if name else part, getattr(value, part))
    elif isinstance(value, str | bytes) or not hasattr(value, "__len__"):
        return
    elif len(value) <= MAX_MATRIX_COLUMNS:
        for k, inner in enumerate(value):
            yield from _numbers(f"{name}.{k}" if name else str(k), inner)


def _table(
    times: dict[str, list[tuple[float, float]]],
    fields: dict[str, dict[str, dict[int, float]]],
    skipped: dict[str, str],
) -> ForeignTable:
    """The table of topics.

    Args:
        times: Topic to the time at which each message was logged and its own stamp, s.
        fields: Topic to the values of each field by the number of the message.
        skipped: Topic to why its messages are not read.
    """
    clocks = {topic: np.array(each) for topic, each in times.items()}
    offsets = {t: float(np.median(c[:, 0] - c[:, 1])) for t, c in clocks.items()}
    known = [each for each in offsets.values() if np.isfinite(each)]
    apart = max(known) - min(known) if known else 0.0
    notes = [f"{topic}: left out: {why}" for topic, why in skipped.items()]
    if apart > MAX_CLOCK_DIFFERENCE_S:
        notes.append(
            f"the stamps of the topics are {apart:.3g} s apart, by clocks that differ: times are "
            "those at which messages were logged"
        )
    elif known:
        stamped = [topic for topic, each in offsets.items() if np.isfinite(each)]
        notes.append(f"times are the stamps in the headers of {', '.join(stamped)}")
    columns: dict[str, Array | list[str]] = {}
    own: dict[str, Array] = {}
    for topic, clock in clocks.items():
        if apart > MAX_CLOCK_DIFFERENCE_S or not known:
            at = clock[:, 0]
        elif np.isfinite(offsets[topic]):
            at = clock[:, 1]
        else:  # logged as long after it was sent as usual
            at = clock[:, 0] - np.median(known)
        for field, values in fields[topic].items():
            name = f"{topic}/{field}" if field else topic  # a message may be a number alone
            column = np.full(len(at), np.nan)
            column[list(values)] = list(values.values())
            columns[name], own[name] = column, at
    return ForeignTable(columns, clocks=own, notes=tuple(notes))
