"""A recorded run as a file that other programs read."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from twin.errors import RecordError
from twin.writing import write_whole

if TYPE_CHECKING:
    from controllers.arrays import Array

Columns = Mapping[str, "Array"]
Units = Mapping[str, str]


def export(path: Path, columns: Columns, units: Units) -> None:
    """Write columns of one length into a file; its ending says how.

    Args:
        path: ``.csv``: a header ``name [unit]``, as ``identify`` reads it, numbers with all their
            digits. ``.mat``: one column vector per name, and the struct ``units``, for MATLAB.
            ``.parquet``: one column per name with its unit in the metadata.
        columns: Name to values, shape (K,) each.
        units: Name to unit.

    Raises:
        RecordError: If the ending is none of these, or the file cannot be written.
    """
    write = WRITERS.get(path.suffix)
    if write is None:
        known = ", ".join(WRITERS)
        raise RecordError(f"{path}: the ending says what is written; known: {known}")
    write_whole(path, lambda target: write(target, columns, units))


def _csv(path: Path, columns: Columns, units: Units) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(f"{name} [{units[name]}]" if units.get(name) else name for name in columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


def _mat(path: Path, columns: Columns, units: Units) -> None:
    from scipy.io import savemat  # noqa: PLC0415  heavy: loaded when needed

    named = {_matlab(name): values for name, values in columns.items()}
    savemat(
        path,
        {**named, "units": {_matlab(name): units.get(name, "") for name in columns}},
        oned_as="column",
        appendmat=False,
        long_field_names=True,
    )


def _matlab(name: str) -> str:
    """A name that MATLAB allows."""
    return re.sub(r"\W", "_", name)


def _parquet(path: Path, columns: Columns, units: Units) -> None:
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415

    fields = [
        pa.field(name, pa.float64(), metadata={"unit": units.get(name, "")}) for name in columns
    ]
    arrays = [pa.array(values.tolist(), pa.float64()) for values in columns.values()]
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), path)


WRITERS: dict[str, Callable[[Path, Columns, Units], None]] = {
    ".csv": _csv,
    ".mat": _mat,
    ".parquet": _parquet,
}
"""Ending of a file to what writes it."""
