"""Logs that are no text: files of known kinds are read, others named with what would do.

The first bytes of a file decide its kind, not the ending of its name.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

from twin.base.errors import LogError, TwinError, one_line
from twin.base.foreign import kind_of, with_article
from twin.run.bags import read_bag, read_mcap
from twin.run.json_logs import read_json
from twin.run.mdf_logs import read_mdf
from twin.run.octave_logs import read_octave
from twin.run.readers import (
    ForeignTable,
    read_arrow,
    read_excel,
    read_hdf5,
    read_matlab,
    read_numpy,
    read_parquet,
    read_tdms,
)

_PICKLE_ADVICE = "in Python: write its data with pandas.DataFrame(...).to_csv('log.csv')"
_UNPACK_ADVICE = "unpack it first"
_SAVE_ADVICE = "save the sheet as CSV"
CONVERSIONS_BY_KIND = {
    "Python pickle": _PICKLE_ADVICE,
    "Excel file (.xls)": _SAVE_ADVICE,
    "OpenDocument file (.ods)": _SAVE_ADVICE,
    "ROS bag": "rostopic echo -b {name} -p /TOPIC > log.csv",
    "gzip file": "gunzip {name}",
    "bzip2 file": "bunzip2 {name}",
    "xz file": "unxz {name}",
    "Zstandard file": "unzstd {name}",
    "ZIP archive": _UNPACK_ADVICE,
    "7-Zip archive": _UNPACK_ADVICE,
    "RAR archive": _UNPACK_ADVICE,
    "tar archive": _UNPACK_ADVICE,
    "CAN trace of Vector (.blf)": "ballplate trace {name} --rig RIG --touch TOUCH --log log.csv",
}
"""Command that converts a file of a kind to a readable one; ``{name}`` is the file."""


def foreign_table(path: Path) -> ForeignTable | None:
    """The columns of a file that is no text; None of text.

    Args:
        path: The file.

    Raises:
        LogError: If it is of a kind that is not read, stating what would make a readable file, is
            broken, or would fill the memory.
        TwinError: If it needs an extra that is not installed.
        OSError: If it cannot be opened.
    """
    kind = kind_of(path)
    if not kind:
        return None
    if (read := READERS_BY_KIND.get(kind)) is None:
        raise _refusal(path, kind)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = read(path)
    except TwinError:
        raise
    except (Exception, MemoryError) as error:  # whatever a broken file makes its readers raise
        raise LogError(f"{path.name}: cannot be read: {one_line(error)}") from error
    if not table.columns:
        why = f"; {table.notes[0]}" if table.notes else ""
        raise LogError(f"{path.name}: {with_article(kind)} without a column of numbers{why}")
    return table


def refuse_foreign(path: Path) -> None:
    """Make sure that a file is text.

    Raises:
        LogError: If it is not, saying what would make a readable file.
        OSError: If it cannot be opened.
    """
    if kind := kind_of(path):
        raise _refusal(path, kind)


def _refusal(path: Path, kind: str) -> LogError:
    how = CONVERSIONS_BY_KIND.get(kind, "").format(name=path.name)
    advice = f": {how}" if how else ""
    return LogError(
        f"{path.name}: is {with_article(kind)}; logs are text with columns (CSV), or one of "
        f"{', '.join(READABLE_SUFFIXES)}{advice}"
    )


READERS_BY_KIND: dict[str, Callable[[Path], ForeignTable]] = {
    "MCAP file": read_mcap,
    "SQLite database": read_bag,
    "Parquet file": read_parquet,
    "Arrow file": read_arrow,
    "Arrow stream": read_arrow,
    "NumPy array": read_numpy,
    "NumPy archive (.npz)": read_numpy,
    "MATLAB file": read_matlab,
    "HDF5 file": read_hdf5,
    "Excel file (.xlsx)": read_excel,
    "LabVIEW file (.tdms)": read_tdms,
    "measurement file (.mf4)": read_mdf,
    "JSON file": read_json,
    "text file of Octave": read_octave,
}
"""Kind of a file to what reads it."""
READABLE_SUFFIXES = (
    *(".parquet", ".npz", ".npy", ".mat", ".mcap", ".db3", ".xlsx", ".tdms", ".mf4", ".h5"),
    ".json",
)
"""Usual endings of these kinds."""
