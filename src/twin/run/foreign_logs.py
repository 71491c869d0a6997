"""Logs that are no text: Parquet, Arrow and MCAP files are read, others named with what would do.

What a file is, its first bytes say, not the ending of its name.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError
from twin.base.foreign import kind_of, with_article
from twin.devices.common import one_line

SIGNALS = "/signals"
"""Topic of an MCAP file of ours that has every column."""
_PYTHON = "in Python: "
_UNPACK = "unpack it first"
_SAVE = "save the sheet as CSV"
_MATLAB = "in MATLAB: load('{name}'); writetable(table(t, x, u), 'log.csv') with its own names"
HOW = {
    "MATLAB file": _MATLAB,
    "HDF5 file": f"{_MATLAB}; or {_PYTHON}h5py and numpy.savetxt",
    "NumPy array": f"{_PYTHON}numpy.savetxt('log.csv', numpy.load('{{name}}'), delimiter=',')",
    "NumPy archive (.npz)": (
        f"{_PYTHON}d = numpy.load('{{name}}'); numpy.savetxt('log.csv', numpy.column_stack([d['t'],"
        " d['x'], d['u']]), delimiter=',', header='t,x,u', comments='') with its own names"
    ),
    "JSON file": f"{_PYTHON}pandas.read_json('{{name}}').to_csv('log.csv', index=False)",
    "Python pickle": f"{_PYTHON}write what it holds with pandas.DataFrame(...).to_csv('log.csv')",
    "LabVIEW file (.tdms)": (
        f"{_PYTHON}nptdms.TdmsFile.read('{{name}}').as_dataframe().to_csv('log.csv', index=False)"
    ),
    "text file of Octave": "in Octave: load {name}; csvwrite('log.csv', [t x u]) with its names",
    "Excel file (.xlsx)": _SAVE,
    "Excel file (.xls)": _SAVE,
    "OpenDocument file (.ods)": _SAVE,
    "ROS bag": "rostopic echo -b {name} -p /TOPIC > log.csv",
    "SQLite database": "sqlite3 -header -csv {name} 'select t, x, u from TABLE' > log.csv",
    "gzip file": "gunzip {name}",
    "bzip2 file": "bunzip2 {name}",
    "xz file": "unxz {name}",
    "Zstandard file": "unzstd {name}",
    "ZIP archive": _UNPACK,
    "7-Zip archive": _UNPACK,
    "RAR archive": _UNPACK,
    "tar archive": _UNPACK,
    "Arrow file": f"{_PYTHON}pandas.read_feather('{{name}}').to_csv('log.csv', index=False)",
    "measurement file (.mf4)": f"{_PYTHON}asammdf.MDF('{{name}}').export('csv')",
    "CAN trace of Vector (.blf)": "ballplate trace {name} --rig RIG --touch TOUCH --log log.csv",
}
"""What makes a readable file of one of a kind; ``{name}`` is the file."""


class ForeignTable(NamedTuple):
    """Columns of a file that is no text.

    Attributes:
        columns: Name to numbers, shape (K,) each, NaN where there is none, or to texts.
        units: Name to unit; of those that the file gives one.
        metadata: The run's metadata; empty for a file of a different program.
    """

    columns: dict[str, Array | list[str]]
    units: dict[str, str]
    metadata: dict[str, Any]


def foreign_table(path: Path) -> ForeignTable | None:
    """The columns of a file that is no text; None of text.

    Args:
        path: The file.

    Raises:
        LogError: If it is of a kind that is not read, saying what would make a readable file, or
            is broken.
        OSError: If it cannot be opened.
    """
    kind = kind_of(path)
    if not kind:
        return None
    if kind == "MCAP file":
        return _mcap_table(path)
    if kind in {"Parquet file", "Arrow stream"}:
        return _arrow_table(path, stream=kind == "Arrow stream")
    raise _refusal(path, kind)


def refuse_foreign(path: Path) -> None:
    """Make sure that a file is text.

    Raises:
        LogError: If it is not, saying what would make a readable file.
        OSError: If it cannot be opened.
    """
    if kind := kind_of(path):
        raise _refusal(path, kind)


def _refusal(path: Path, kind: str) -> LogError:
    how = HOW.get(kind, "").format(name=path.name)
    advice = f": {how}" if how else ""
    return LogError(
        f"{path.name}: is {with_article(kind)}; logs are text with columns (CSV), Parquet, or MCAP "
        f"of ours{advice}"
    )


def _arrow_table(path: Path, *, stream: bool) -> ForeignTable:
    import pyarrow as pa  # noqa: PLC0415  heavy: a CSV file does without
    import pyarrow.parquet as pq  # noqa: PLC0415

    try:
        if stream:
            with path.open("rb") as source, pa.ipc.open_stream(source) as reader:
                table = reader.read_all()
        else:
            with pq.ParquetFile(path) as parquet:
                table = parquet.read()
    except (OSError, pa.ArrowException) as error:
        raise LogError(f"{path.name}: cannot be read: {one_line(error)}") from error
    columns: dict[str, Array | list[str]] = {}
    units: dict[str, str] = {}
    for field in table.schema:
        column = table.column(table.schema.get_field_index(field.name))
        if table.schema.names.count(field.name) == 1:
            columns[field.name] = _numbers_of(column.to_numpy())
        if unit := (field.metadata or {}).get(b"unit"):
            units[field.name] = unit.decode(errors="replace")
    return ForeignTable(columns, units, {})


def _numbers_of(values: Any) -> Array | list[str]:
    """Numbers of a column, times in s; texts where they are none."""
    if values.dtype.kind in "Mm":
        whole = values.astype(f"{values.dtype.kind}8[ns]")
        seconds = whole.astype(np.int64) / 1e9
        return np.where(np.isnat(whole), np.nan, seconds)
    if values.dtype.kind in "biuf":
        return np.asarray(values, dtype=float)
    try:
        return np.array([np.nan if each is None else float(each) for each in values])
    except (TypeError, ValueError):
        return ["" if each is None else str(each) for each in values]


def _mcap_table(path: Path) -> ForeignTable:
    """What a run of ours was exported as: a message of all columns for each period."""
    try:
        from mcap.reader import make_reader  # noqa: PLC0415  of an extra
        from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415
    except ImportError as error:
        raise LogError(
            f"{path.name}: is an MCAP file; reading needs the extra mcap: pip install "
            "'ballplate[mcap]'"
        ) from error
    rows: list[Any] = []
    units: dict[str, str] = {}
    metadata: dict[str, Any] = {}
    try:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for record in reader.iter_metadata():
                units |= record.metadata if record.name == "units" else {}
            for attached in reader.iter_attachments():
                if attached.media_type == "application/json":
                    metadata[attached.name.removesuffix(".json")] = json.loads(attached.data)
            rows += [message for *_, message in reader.iter_decoded_messages(topics=[SIGNALS])]
        columns = {name: np.array([getattr(row, _field(name)) for row in rows]) for name in units}
    except Exception as error:  # whatever a broken file makes its readers raise
        raise LogError(f"{path.name}: cannot be read: {one_line(error)}") from error
    if not rows:
        raise LogError(
            f"{path.name}: an MCAP file of a different program: it has no topic {SIGNALS}; write "
            "its content as CSV"
        )
    return ForeignTable(dict(columns), units, metadata)


def _field(name: str) -> str:
    """What a column is called in a message of ROS."""
    return "".join(c if c.isalnum() or c == "_" else "_" for c in name).lower()
