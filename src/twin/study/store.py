"""The rows of a study on disk: whole files only, and no run twice."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from twin.errors import RecordError
from twin.study.schema import METRICS
from twin.study.work import Row
from twin.writing import write_whole

SCHEMA = pa.schema(
    [
        ("key", pa.string()),
        ("outcome", pa.string()),
        ("reason", pa.string()),
        *((name, pa.float64()) for name in METRICS),
    ]
)


class Store:
    """The finished runs in a folder, one file a chunk, named by what is in it.

    A file is written under another name and renamed, so that a killed study leaves whole chunks or
    none; what is in no file is run again.

    Args:
        folder: Where; made for the first chunk.

    Raises:
        RecordError: If it cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "chunks"
        if self.folder.exists() and not self.folder.is_dir():
            raise RecordError(f"{self.folder}: is no folder")
        self._chunks = [_read(path) for path in sorted(self.folder.glob("[!.]*.parquet"))]

    def add(self, rows: Sequence[Row]) -> None:
        """Keep a chunk of finished runs."""
        name = hashlib.sha256("".join(row["key"] for row in rows).encode()).hexdigest()[:32]
        table = pa.Table.from_pylist(list(rows), SCHEMA)
        write_whole(self.folder / f"{name}.parquet", lambda path: pq.write_table(table, path))
        self._chunks.append(table)

    def rows(self, keys: Sequence[str]) -> pa.Table:
        """The runs with these keys, in their order; those that are not finished are left out."""
        kept = pa.concat_tables([SCHEMA.empty_table(), *self._chunks])
        places = pc.index_in(pa.array(keys, pa.string()), kept["key"].combine_chunks())
        return kept.take(places.drop_null())


def _read(path: Path) -> pa.Table:
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise RecordError(f"{path}: not a readable chunk; delete it: {reason}") from error
    if table.schema.names != SCHEMA.names:
        raise RecordError(
            f"{path}: a chunk of another version of this program; choose another --out"
        )
    for name, wanted, kind in zip(SCHEMA.names, SCHEMA.types, table.schema.types, strict=True):
        if kind != wanted:
            raise RecordError(f"{path}: {name}: must be {wanted}, is {kind}; delete this chunk")
    for name in ("key", "outcome"):
        if table[name].null_count:
            raise RecordError(f"{path}: {name}: missing in a row; delete this chunk")
    return table
