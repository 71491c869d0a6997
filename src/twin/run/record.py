"""The record of a run: named channels, one row per control period, and its file.

``run.parquet`` has columns with units and, as metadata, what the run and its controller were; it is
written whole or not at all. A run on a rig is streamed while it lasts: ``run.arrows`` has the same
as an Arrow stream, which can be read however it ends.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.catalog import origin
from controllers.interfaces import Quantity
from twin.base.data_file import DataError, parse_json, read_toml
from twin.base.errors import RecordError
from twin.base.writing import remove, write_whole
from twin.run.files import STREAM, arrow_fields
from twin.scenario.schema import KINDS, Scenario, choices, with_settings

if TYPE_CHECKING:
    import pyarrow as pa


Observe = Callable[[float, Mapping[str, NDArray[Any]]], None]


@dataclass(frozen=True)
class Channel:
    """A recorded quantity: its columns with one unit each."""

    columns: tuple[str, ...]
    units: tuple[str, ...]


CHANNELS = {
    name: Channel(tuple(columns), tuple(columns.values()))
    for name, columns in read_toml(Path(__file__).with_name("channels.toml")).items()
}
"""The channels of records: ``state`` of simulated ones only, ``timing`` of real-time ones only,
``computing`` of those whose law has a computing time: that of a command that was begun, else NaN,
and how much older the measurement behind what is applied is than the law's period explains;
``reference`` of those whose reference is not part of this program, ``laid`` where the law laid
another path because the plate cannot give it: of these times, else NaN."""


@dataclass
class Recorder:
    """Keeps N rigs' channels in memory, one entry a control period.

    Attributes:
        ticks: Room for this many periods.
        rigs: Number of rigs.
        period: Control period in s.
        plant: Names of the columns of the channel ``plant``, each ending in its unit.
        further: What the observer estimates beyond the state: the channel ``further``.
        keep: Channels that are kept; none for all.
        every: Control periods from one recorded instant to the next. Between two, the applied
            acceleration that is kept is the largest by amount; the rest is that of the instant.
        length: Periods recorded so far.
        data: Channel name to values, shape (ticks, N) or (ticks, N, columns); what is known at the
            end only, shape (length, N, columns).
        observers: Are shown time and channels of each period as they are recorded; must not
            stall.
    """

    ticks: int
    rigs: int
    period: float
    plant: tuple[str, ...] = ()
    further: tuple[Quantity, ...] = ()
    keep: tuple[str, ...] = ()
    every: int = 1
    length: int = 0
    data: dict[str, Array] = field(default_factory=dict)
    observers: list[Observe] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Make room for the times."""
        self._time = np.empty(math.ceil(self.ticks / self.every))
        self._columns: list[tuple[str, Array]] = []
        self._tick = 0
        self._peak: Array | None = None

    def append(self, time: float, channels: Mapping[str, NDArray[Any]]) -> None:
        """Add the control period that began at a time in s; always the same channels.

        Args:
            time: In s.
            channels: Name to values, shape (N,) or (N, columns).
        """
        for observe in self.observers:
            observe(time, channels)
        if self.every > 1:
            channels = {**channels, "applied": self._largest(channels["applied"])}
            self._tick += 1
            if (self._tick - 1) % self.every:
                return
            self._peak = None
        if not self._columns:
            for name in self.keep or channels:
                self.data[name] = np.empty((len(self._time), *channels[name].shape))
            self._columns = list(self.data.items())
        row = self.length
        for name, values in self._columns:
            values[row] = channels[name]
        self._time[row] = time
        self.length += 1

    def _largest(self, applied: Array) -> Array:
        """The largest by amount since the last recorded instant."""
        if self._peak is not None:
            applied = np.where(np.abs(applied) > np.abs(self._peak), applied, self._peak)
        self._peak = applied
        return applied

    @property
    def time(self) -> Array:
        """Seconds since the start, shape (length,); of a real-time run with gaps if any."""
        return self._time[: self.length]

    @property
    def end(self) -> float:
        """When the last period ended, s."""
        return float(self._time[self.length - 1]) + self.every * self.period if self.length else 0.0

    def __getitem__(self, name: str) -> Array:
        """What was recorded of a channel, shape (length, N, columns)."""
        return self.data[name][: self.length].reshape(self.length, self.rigs, -1)

    def channel(self, name: str) -> Channel:
        """Columns and units of a channel."""
        if name == "further":
            names = tuple(f"estimated_{quantity.name}" for quantity in self.further)
            return Channel(names, tuple(quantity.unit for quantity in self.further))
        units = tuple(column.rpartition("_")[2] for column in self.plant)
        return CHANNELS.get(name) or Channel(self.plant, units)

    @property
    def units(self) -> dict[str, str]:
        """Name to unit of all columns it may have."""
        known = map(self.channel, (*CHANNELS, "plant", "further"))
        return {k: v for each in known for k, v in zip(each.columns, each.units, strict=True)}

    def of_rig(self, rig: int) -> Recorder:
        """The record of one rig alone, a copy of what is in it so far."""
        alone = replace(self, ticks=self.every * self.length, rigs=1, data={}, observers=[])
        alone._time[:] = self.time
        for name, values in self.data.items():
            alone.data[name] = values[: self.length, rig : rig + 1].copy()
        return alone

    def columns(self) -> Iterator[tuple[str, str, Array]]:
        """Name, unit and values of every column but time; the rows of one rig follow the other."""
        for name in self.data:
            channel = self.channel(name)
            for column, unit, values in zip(
                channel.columns, channel.units, np.moveaxis(self[name], -1, 0), strict=True
            ):
                yield column, unit, values.T.ravel()


def classes_of(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """What law, observer and reference of a scenario were, by their tables.

    Returns:
        All settings with their values, also those that the scenario leaves to the class; and of a
        class that is not part of this program its file's name, SHA-256 and source text.
    """
    found: dict[str, dict[str, Any]] = {}
    for table in KINDS:
        choice = getattr(scenario, table)
        cls = choices(table)[choice.kind]
        given = with_settings(cls, choice.settings)
        found[table] = {"settings": given.model_dump(mode="json", warnings=False)}
        if (place := origin(cls)) is not None:
            file, text = place
            mark = hashlib.sha256(text.encode()).hexdigest() if text else ""
            found[table] |= {"file": file, "sha256": mark, "source": text}
    return found


OLD_COLUMNS = {
    "wished_phi_acc": "requested_phi_acc",
    "wished_theta_acc": "requested_theta_acc",
}
"""Names of columns in records of earlier versions, and today's."""


def write_run(folder: Path, recorder: Recorder, metadata: Mapping[str, Any]) -> None:
    """Write ``run.parquet`` into a run folder.

    Args:
        folder: The run folder; made if missing.
        recorder: What was recorded.
        metadata: Of the run; JSON.

    Raises:
        RecordError: If the folder cannot be written.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415

    columns = [("time", "s", recorder.time), *recorder.columns()]
    fields = arrow_fields({name: unit for name, unit, _ in columns})
    said = json.dumps(metadata, sort_keys=True)
    schema = pa.schema(fields, metadata={"ballplate": said})
    found = pa.Table.from_arrays([_arrow(values) for *_, values in columns], schema=schema)
    write_whole(folder / "run.parquet", lambda path: pq.write_table(found, path))
    remove(folder / STREAM)


@contextmanager
def stream(
    columns: Sequence[str], file: Path, units: Mapping[str, str], metadata: Mapping[str, Any]
) -> Iterator[Callable[[Mapping[str, Array]], None]]:
    """Write a record while its run lasts; what is given columns, shape (K,) each, keeps them.

    When it returns they are on the disk, whatever becomes of this process or of the computer.

    Args:
        columns: Their names, ``time`` first.
        file: A new file; its folder is made if missing.
        units: Name to unit.
        metadata: Of the run; JSON.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    fields = arrow_fields({name: units.get(name, "") for name in columns})
    schema = pa.schema(fields, metadata={"ballplate": json.dumps(metadata, sort_keys=True)})
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("wb", buffering=0) as sink, pa.ipc.new_stream(sink, schema) as writer:

        def append(rows: Mapping[str, Array]) -> None:
            arrays = [_arrow(np.ascontiguousarray(column)) for column in rows.values()]
            writer.write_batch(pa.RecordBatch.from_arrays(arrays, schema=schema))
            os.fsync(sink.fileno())

        yield append


def _arrow(values: NDArray[Any]) -> pa.Array:
    """Numbers, shape (K,), as an Arrow array.

    ``pa.array`` does the same, but imports pandas wherever that is installed.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    kind = pa.from_numpy_dtype(values.dtype)
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(values)])


def read_run(file: Path) -> tuple[dict[str, Array], dict[str, str], dict[str, Any]]:
    """Columns, their units and the metadata of a ``run.parquet`` or ``run.arrows``.

    Raises:
        RecordError: If it cannot be read or was not written by this program.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    try:
        table = stored(file)
    except FileNotFoundError as error:
        raise RecordError(f"{file}: no such record; a run folder holds run.parquet") from error
    except (OSError, pa.ArrowException) as error:
        if file.name == STREAM and not file.stat().st_size:
            raise RecordError(f"{file}: nothing has been recorded yet") from error
        reason = str(error).splitlines()[0]
        raise RecordError(f"{file}: not a readable Parquet file: {reason}") from error
    if len(set(table.column_names)) < len(table.column_names):
        raise RecordError(f"{file}: not a readable Parquet file: two columns have one name")
    encoded = (table.schema.metadata or {}).get(b"ballplate")
    if encoded is None:
        raise RecordError(f"{file}: a Parquet file, but not a record of ballplate")
    table = table.rename_columns([OLD_COLUMNS.get(name, name) for name in table.column_names])
    columns = {
        name: _numbers(table[name])
        for name in table.column_names
        if pa.types.is_floating(table[name].type) or pa.types.is_integer(table[name].type)
    }
    units = {
        item.name: (item.metadata or {}).get(b"unit", b"").decode(errors="replace")
        for item in table.schema
    }
    try:
        metadata = parse_json(encoded)
    except DataError as error:
        raise RecordError(f"{file}: metadata 'ballplate': {error}") from error
    if not isinstance(metadata, dict):
        raise RecordError(f"{file}: metadata 'ballplate': not a JSON object")
    return columns, units, metadata


def stored(file: Path) -> pa.Table:
    """The table of a Parquet file, or of a stream as far as it was written.

    Raises:
        OSError: If it cannot be read.
        pyarrow.ArrowException: If it is no such file.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415

    if file.suffix != Path(STREAM).suffix:
        # not pq.read_table, which imports pandas wherever that is installed
        with pq.ParquetFile(file) as parquet:
            return parquet.read()
    with file.open("rb") as source, pa.ipc.open_stream(source) as reader:
        batches = []
        with suppress(StopIteration, OSError, pa.ArrowException):  # its last rows may be torn
            while True:
                batches.append(reader.read_next_batch())
        return pa.Table.from_batches(batches, reader.schema)


def read_metadata(file: Path) -> bytes | None:
    """The metadata of a record in JSON; None if it has none.

    Raises:
        RecordError: If there is no readable record.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415

    streamed = file.suffix == Path(STREAM).suffix
    try:
        schema = stored(file).schema if streamed else pq.read_schema(file)
    except (OSError, pa.ArrowException) as error:
        raise RecordError(f"{file}: not a readable record") from error
    return (schema.metadata or {}).get(b"ballplate")


def _numbers(column: pa.ChunkedArray) -> Array:
    """A column of numbers, shape (K,).

    ``to_numpy`` does the same, but imports pandas wherever that is installed.
    """
    if column.null_count:
        return np.asarray(column.to_numpy(), float)
    kind = column.type.to_pandas_dtype()
    parts = [
        np.frombuffer(chunk.buffers()[1], kind, len(chunk), chunk.offset * np.dtype(kind).itemsize)
        for chunk in column.chunks
        if len(chunk)
    ]
    return np.concatenate([np.zeros(0), *parts]).astype(float)
