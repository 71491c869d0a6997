"""The file of a record, run.parquet: columns with units, and what the run was as metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.data_file import DataError, parse_json
from twin.errors import RecordError
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
    """Columns, their units and the metadata of a ``run.parquet``.

    Raises:
        RecordError: If it cannot be read or was not written by this program.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415

    try:
        # not pq.read_table, which imports pandas wherever that is installed
        with pq.ParquetFile(file) as parquet:
            table = parquet.read()
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


def read_beside(file: Path, name: str) -> bytes | None:
    """Further metadata of a record by name; None if it has none.

    Raises:
        RecordError: If there is no readable record.
    """
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415

    try:
        metadata: dict[bytes, bytes] = pq.read_schema(file).metadata or {}
    except (OSError, pa.ArrowException) as error:
        raise RecordError(f"{file}: not a readable record") from error
    return metadata.get(name.encode())


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
