"""The file of a record, run.parquet: columns with units, and what the run was as metadata.

A run on a rig is streamed while it lasts: run.arrows has the same columns and metadata as an Arrow
stream, which can be read however it ends.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.data_file import DataError, parse_json
from twin.errors import RecordError
from twin.run.folders import STREAM
from twin.run.record import Recorder
from twin.writing import write_whole

if TYPE_CHECKING:
    import pyarrow as pa

OLD_COLUMNS = {
    "wished_phi_acc": "requested_phi_acc",
    "wished_theta_acc": "requested_theta_acc",
}
"""Names of columns in records of earlier versions, and today's."""


def write_run(
    folder: Path,
    recorder: Recorder,
    metadata: Mapping[str, Any],
    beside: Mapping[str, bytes] | None = None,
) -> None:
    """Write ``run.parquet`` into a run folder.

    Args:
        folder: The run folder; made if missing.
        recorder: What was recorded.
        metadata: Of the run; JSON.
        beside: Further metadata of the file by name.

    Raises:
        RecordError: If the folder cannot be written.
    """
    import pyarrow.parquet as pq  # noqa: PLC0415  heavy: loaded when needed

    found = table(recorder, metadata, beside)
    write_whole(folder / "run.parquet", lambda path: pq.write_table(found, path))
    (folder / STREAM).unlink(missing_ok=True)


@contextmanager
def stream(
    file: Path, columns: Sequence[str], units: Mapping[str, str], metadata: Mapping[str, Any]
) -> Iterator[Callable[[Array], None]]:
    """Write a record while its run lasts; what is given rows, shape (K, columns), keeps them.

    When it returns they are on the disk, whatever becomes of this process or of the computer.

    Args:
        file: A new file; its folder is made if missing.
        columns: Their names in the order of the rows, ``time`` first.
        units: Name to unit.
        metadata: Of the run; JSON.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    fields = [
        pa.field(name, pa.float64(), metadata={"unit": units.get(name, "")}) for name in columns
    ]
    schema = pa.schema(fields, metadata={"ballplate": json.dumps(metadata, sort_keys=True)})
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("wb", buffering=0) as sink, pa.ipc.new_stream(sink, schema) as writer:

        def append(rows: Array) -> None:
            arrays = [_arrow(np.ascontiguousarray(column)) for column in rows.T]
            writer.write_batch(pa.RecordBatch.from_arrays(arrays, schema=schema))
            os.fsync(sink.fileno())

        yield append


def table(
    recorder: Recorder, metadata: Mapping[str, Any], beside: Mapping[str, bytes] | None = None
) -> pa.Table:
    """All channels as an Arrow table; with several rigs the rows of one follow the other.

    Args:
        recorder: What was recorded.
        metadata: Of the run; JSON.
        beside: Further metadata by name.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    rows = recorder.length
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    arrays = [_arrow(np.tile(recorder.time, recorder.rigs))]
    if recorder.rigs > 1:
        fields.append(pa.field("rig", pa.int32(), metadata={"unit": "1"}))
        arrays.append(_arrow(np.repeat(np.arange(recorder.rigs, dtype=np.int32), rows)))
    for column, unit, values in recorder.columns():
        fields.append(pa.field(column, pa.float64(), metadata={"unit": unit}))
        arrays.append(_arrow(values))
    encoded: dict[str, str | bytes] = {"ballplate": json.dumps(metadata, sort_keys=True)}
    encoded |= beside or {}
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=encoded))


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
        reason = str(error).splitlines()[0]
        raise RecordError(f"{file}: not a readable Parquet file: {reason}") from error
    if len(set(table.column_names)) < len(table.column_names):
        raise RecordError(f"{file}: not a readable Parquet file: two columns have one name")
    encoded = (table.schema.metadata or {}).get(b"ballplate")
    if encoded is None:
        raise RecordError(f"{file}: a Parquet file, but not a record of ballplate")
    columns = {
        name: _numbers(table[name])
        for name in table.column_names
        if pa.types.is_floating(table[name].type) or pa.types.is_integer(table[name].type)
    }
    columns = {OLD_COLUMNS.get(name, name): values for name, values in columns.items()}
    units = {
        OLD_COLUMNS.get(item.name, item.name): (
            (item.metadata or {}).get(b"unit", b"").decode(errors="replace")
        )
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


def read_beside(file: Path, name: str) -> bytes | None:
    """Further metadata of a record by name; None if it has none.

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
    found: bytes | None = (schema.metadata or {}).get(name.encode())
    return found


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
