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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
from twin.base.errors import RecordError, one_line, plural
from twin.base.shipped import nearest_neighbour
from twin.base.writing import remove, write_whole
from twin.run.exporters import METADATA_KEY, arrow_fields
from twin.run.files import RECORD_SUFFIXES, STREAM_FILE
from twin.scenario.schema import CATALOG_TABLES, MOST_PERIODS, Scenario, choices, with_settings

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
``computing`` if the law has a computing time: the time of a command that was begun, else NaN, and
the time by which the measurement behind the applied command is older than the law's period
explains; ``board`` if the controller is a program: its instructions, and what Python requests;
``reference`` if it is not part of this program, ``laid`` for times where the law follows
a different path because the plate cannot give the reference, else NaN."""


SECOND_AXIS_WORDS = frozenset(("y", "theta"))
"""Parts of the name of a column by which it is of the second axis."""


def of_axes(columns: Iterable[str], axes: int) -> list[str]:
    """Those of some columns that a rig with so many axes has."""
    return [name for name in columns if axes == 2 or SECOND_AXIS_WORDS.isdisjoint(name.split("_"))]


def _axes_in(metadata: Mapping[str, Any]) -> int:
    """Number of axes of the rig of a record."""
    tables: Any = metadata.get("scenario")
    plant = tables.get("plant") if isinstance(tables, dict) else None
    return 1 if isinstance(plant, dict) and plant.get("axes") == 1 else 2


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
            acceleration that is kept is the largest by amount; the rest is of the instant.
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
        """Recorded values of a channel, shape (length, N, columns)."""
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
    """Law, observer and reference of a scenario, by their tables.

    Returns:
        All settings with their values, also those that the scenario leaves to the class; and of a
        class that is not part of this program its file's name, SHA-256 and source text.
    """
    found: dict[str, dict[str, Any]] = {}
    for table in CATALOG_TABLES:
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
    names = set(of_axes([name for name, *_ in columns], _axes_in(metadata)))
    columns = [each for each in columns if each[0] in names]
    arrays = [_arrow(values) for *_, values in columns]
    schema, seal = _seal_schema({name: unit for name, unit, _ in columns}, metadata)
    seal = _digest(seal, map(_bytes, arrays))
    found = pa.Table.from_arrays(arrays, schema=schema)

    def fill(path: Path) -> None:
        # hardly two numbers of a signal are the same: a dictionary of them takes time and room
        with pq.ParquetWriter(path, schema, use_dictionary=False) as writer:
            writer.write_table(found)
            # of the file, not of the schema: a changed table is written to a new file without it
            writer.add_key_value_metadata({CHECKSUM_KEY: seal})

    write_whole(folder / "run.parquet", fill)
    remove(folder / STREAM_FILE)


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

    schema, seal = _seal_schema({name: units.get(name, "") for name in columns}, metadata)
    schema = schema.with_metadata({**schema.metadata, CHECKSUM_KEY: seal})
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("wb", buffering=0) as sink, pa.ipc.new_stream(sink, schema) as writer:

        def append(rows: Mapping[str, Array]) -> None:
            nonlocal seal
            arrays = [_arrow(np.ascontiguousarray(column)) for column in rows.values()]
            seal = _digest(seal, map(_bytes, arrays))
            batch = pa.RecordBatch.from_arrays(arrays, schema=schema)
            writer.write_batch(batch, custom_metadata={CHECKSUM_KEY: seal})
            os.fsync(sink.fileno())

        yield append


def _arrow(values: NDArray[Any]) -> pa.Array:
    """Numbers, shape (K,), as an Arrow array.

    ``pa.array`` does the same, but imports pandas wherever that is installed.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    kind = pa.from_numpy_dtype(values.dtype)
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(values)])


CHECKSUM_KEY = b"ballplate.checksum"
"""Key of a SHA-256: in a Parquet file of the metadata, names, units and values of all columns; in a
stream of the metadata, names and units, and with each batch the previous batch's and its values.
It is with the file, so that a table that is read, changed and written again has none.
Records of earlier versions have none."""


class DamagedError(OSError):
    """A record is not what was written."""


def _seal_schema(units: Mapping[str, str], metadata: Mapping[str, Any]) -> tuple[pa.Schema, bytes]:
    """The schema of a record, and the checksum of what is in it."""
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    about = json.dumps(metadata, sort_keys=True).encode()
    schema = pa.schema(arrow_fields(units), metadata={METADATA_KEY: about})
    return schema, _seal_of(schema)


def _seal_of(schema: pa.Schema) -> bytes:
    """The checksum of metadata, names, types and units of columns."""
    units = [[each.name, str(each.type), _unit(each)] for each in schema]
    about = (schema.metadata or {}).get(METADATA_KEY, b"")
    return _digest(b"", (about, json.dumps(units).encode()))


def _digest(before: bytes, parts: Iterable[bytes | memoryview]) -> bytes:
    found = hashlib.sha256(before)
    for part in parts:
        found.update(part)
    return found.hexdigest().encode()


def _bytes(values: pa.Array) -> memoryview:
    """The bytes of numbers without nulls."""
    kind = np.dtype(values.type.to_pandas_dtype())
    buffer = memoryview(values.buffers()[1] or b"")
    return buffer[values.offset * kind.itemsize :][: len(values) * kind.itemsize]


def _unit(item: pa.Field) -> str:
    return (item.metadata or {}).get(b"unit", b"").decode(errors="replace")


def read_run(file: Path) -> tuple[dict[str, Array], dict[str, str], dict[str, Any]]:
    """Columns, their units and the metadata of a ``run.parquet`` or ``run.arrows``.

    Of a rig of one axis the file lacks the columns of the second; here they are 0.

    Raises:
        RecordError: If it cannot be read or was not written by this program.
    """

    def wanted(schema: pa.Schema) -> list[str]:
        if len(set(schema.names)) < len(schema.names):
            raise RecordError(f"{file}: not a readable Parquet file: two columns have one name")
        if METADATA_KEY not in (schema.metadata or {}):
            raise RecordError(f"{file}: a Parquet file, but not a record of ballplate")
        return [each.name for each in schema if is_number(each.type)]

    try:
        table = read_table(file, wanted)
    except FileNotFoundError as error:
        absent = "no such record; a run folder contains run.parquet"
        if not file.suffix:
            absent = "no such run folder"
        raise RecordError(f"{file}: {absent}{nearest_neighbour(file)}") from error
    except DamagedError as error:
        raise RecordError(f"{file}: {error}") from error
    except unreadable_errors() as error:
        if file.name == STREAM_FILE and not file.stat().st_size:
            raise RecordError(f"{file}: nothing has been recorded yet") from error
        if file.suffix not in RECORD_SUFFIXES and not isinstance(error, OSError):
            raise RecordError(
                f"{file}: not a run, which is a folder with run.parquet, or this file"
            ) from error
        raise RecordError(f"{file}: not a readable Parquet file: {one_line(error)}") from error
    about = table.schema.metadata
    table = table.rename_columns([OLD_COLUMNS.get(name, name) for name in table.column_names])
    columns = {name: _numbers(table[name]) for name in table.column_names}
    units = {item.name: _unit(item) for item in table.schema}
    try:
        metadata = parse_json(about[METADATA_KEY])
    except DataError as error:
        raise RecordError(f"{file}: metadata 'ballplate': {error}") from error
    if not isinstance(metadata, dict):
        raise RecordError(f"{file}: metadata 'ballplate': not a JSON object")
    if _axes_in(metadata) == 1:
        _add_second_axis(columns, units)
    if TORN_KEY in about:
        metadata["incomplete"] = [f"{file.name}: {about[TORN_KEY].decode()}"]
    return columns, units, metadata


def _add_second_axis(columns: dict[str, Array], units: dict[str, str]) -> None:
    """Add the columns of the second axis to every channel that has some of the first."""
    for channel in CHANNELS.values():
        lacking = set(channel.columns) - set(of_axes(channel.columns, 1)) - columns.keys()
        if lacking and not columns.keys().isdisjoint(channel.columns):
            known = dict(zip(channel.columns, channel.units, strict=True))
            for name in lacking:
                columns[name], units[name] = np.zeros_like(columns["time"]), known[name]


TORN_KEY = b"ballplate.torn"
"""Metadata key of a stream without its last rows; no file has it."""
MOST_ROWS = MOST_PERIODS
"""Rows of a record that is read."""
MOST_COLUMNS = 1000
"""Columns of it, wanted or not."""
MOST_BYTES, MOST_UNPACKED = 64_000_000, 200
"""Bytes that a table may take in memory, or how many times its file's size if that is more: columns
that stand still are packed well, but the noise and the times of a run are not."""


def unreadable_errors() -> tuple[type[Exception], ...]:
    """Errors of pyarrow for a file that is damaged or of a wrong kind.

    Two are no errors of Arrow's: a name that is no UTF-8 is found only when it is asked for, and a
    changed length may ask for more memory than there is.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    return OSError, pa.ArrowException, UnicodeDecodeError, MemoryError


def is_number(kind: pa.DataType) -> bool:
    """Whether a column of a type is read."""
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    return pa.types.is_floating(kind) or pa.types.is_integer(kind)


def read_table(file: Path, wanted: Callable[[pa.Schema], list[str]]) -> pa.Table:
    """The table of a Parquet file, or of a stream as far as it was written.

    Its schema and its size are looked at before anything else is read.

    Args:
        file: The file.
        wanted: Is given the schema; returns the names of the columns that are read, numbers all.

    Raises:
        DamagedError: If it has a checksum that it does not match.
        OSError: If it cannot be read, or is larger than the limits of this module.
        pyarrow.ArrowException: If it is no such file; see also `unreadable_errors`.
    """
    import pyarrow.parquet as pq  # noqa: PLC0415  heavy: loaded when needed

    if file.suffix == Path(STREAM_FILE).suffix:
        return _read_stream(file, wanted)
    # not pq.read_table, which imports pandas wherever that is installed
    with pq.ParquetFile(file) as parquet:
        schema, rows = parquet.schema_arrow, parquet.metadata.num_rows
        names = wanted(schema)
        check_size(rows, len(schema), len(names), file.stat().st_size)
        seal = (parquet.metadata.metadata or {}).get(CHECKSUM_KEY)
        if seal is None:
            return parquet.read(columns=names)
        if not all(is_number(each.type) for each in schema):
            raise DamagedError("damaged: a column holds no numbers")
        check_size(rows, len(schema), len(schema), file.stat().st_size)
        table = parquet.read()
    if any(column.null_count for column in table.columns):
        raise DamagedError("damaged: values are missing")
    parts = (_bytes(chunk) for column in table.columns for chunk in column.chunks)
    if _digest(_seal_of(table.schema), parts) != seal:
        raise DamagedError("damaged: it does not match its checksum")
    return table.select(names)


def max_unpacked(size: int) -> int:
    """Largest number of bytes into which a file of so many bytes may unpack."""
    return max(MOST_BYTES, MOST_UNPACKED * size)


def check_size(rows: int, columns: int, wanted: int, size: int) -> None:
    """Make sure that a table is none that only fills the memory.

    Raises:
        OSError: If it is.
    """
    if rows > MOST_ROWS or columns > MOST_COLUMNS:
        raise OSError(
            f"{plural(rows, 'row')} of {plural(columns, 'column')}; "
            f"at most {MOST_ROWS} of {MOST_COLUMNS} are read"
        )
    most = max_unpacked(size)
    if 8 * rows * wanted > most:
        raise OSError(
            f"{plural(rows, 'row')} of {plural(wanted, 'column')} "
            f"would take {8e-6 * rows * wanted:.0f} MB; "
            f"at most {1e-6 * most:.0f} MB are read of a file of {1e-3 * size:.0f} kB"
        )


def _read_stream(file: Path, wanted: Callable[[pa.Schema], list[str]]) -> pa.Table:
    """The table of a stream; arguments and errors as for ``stored``."""
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    batches, rows, left = [], 0, b""
    with file.open("rb") as source, pa.ipc.open_stream(source) as reader:
        schema = reader.schema
        names = wanted(schema)
        sealed = CHECKSUM_KEY in (schema.metadata or {})
        seal = _seal_of(schema)
        if sealed and seal != schema.metadata[CHECKSUM_KEY]:
            raise DamagedError("damaged: its head does not match its checksum")
        end = source.tell()
        # its last rows may be torn
        with suppress(StopIteration, *unreadable_errors()):
            while True:
                batch, custom = reader.read_next_batch_with_custom_metadata()
                batch.validate()
                if sealed:
                    seal = _digest(seal, map(_bytes, batch.columns))
                    if any(each.null_count for each in batch.columns) or (
                        seal != (custom or {}).get(CHECKSUM_KEY)
                    ):
                        break
                batches.append(batch)
                rows += len(batch)
                end = source.tell()
        check_size(rows, len(schema), len(names), file.stat().st_size)
        source.seek(end)
        left = source.read().removesuffix(END_OF_STREAM)
    if sealed and (left.count(CHECKSUM_KEY) > 1 or (left and _is_ended(file))):
        since = batches[-1][0][-1].as_py() if batches else 0.0
        raise DamagedError(f"damaged: its rows after {since:.3f} s do not match their checksum")
    if left:
        lacks = "its last rows were being written or are damaged; they are left out"
        schema = schema.with_metadata({**(schema.metadata or {}), TORN_KEY: lacks})
    whole = [batch.replace_schema_metadata(schema.metadata) for batch in batches]
    return pa.Table.from_batches(whole, schema).select(names)


END_OF_STREAM = b"\xff\xff\xff\xff\0\0\0\0"
"""Last bytes of a stream that was closed by its writer."""


def _is_ended(file: Path) -> bool:
    with file.open("rb") as source:
        source.seek(-len(END_OF_STREAM), os.SEEK_END)
        return source.read() == END_OF_STREAM


def read_metadata(file: Path) -> bytes | None:
    """The metadata of a record in JSON; None if it has none.

    Raises:
        RecordError: If there is no readable record.
    """
    import pyarrow.parquet as pq  # noqa: PLC0415  heavy: loaded when needed

    streamed = file.suffix == Path(STREAM_FILE).suffix
    try:
        schema = read_table(file, lambda _: []).schema if streamed else pq.read_schema(file)
    except unreadable_errors() as error:
        raise RecordError(f"{file}: not a readable record") from error
    return (schema.metadata or {}).get(METADATA_KEY)


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
