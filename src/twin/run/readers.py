"""Readers of measurement files of other programs, one function per format.

Each returns a ``ForeignTable``. None runs or unpickles anything of a file, and each checks the
size of the data before it reads them.
"""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.base.data_file import DataError, parse_json
from twin.base.errors import LogError
from twin.base.parts import extra
from twin.run.exporters import JSON_VARIABLE, METADATA_KEY
from twin.run.record import MOST_COLUMNS, MOST_ROWS, check_size, max_unpacked
from twin.run.units import is_unit

MAX_DEPTH = 6
"""Structures within structures that are read."""
MAX_MATRIX_COLUMNS = 64
"""Columns of a matrix that are read; a wider one is no log."""
MAT_HEADER_BYTES = 128
MAT_COMPRESSED = 15
"""Tag of a compressed element of a MATLAB 5 file."""
OBJECT_ADVICE = (
    "is a MATLAB object, which MATLAB alone reads; in MATLAB, of a timeseries: t = {name}.Time; "
    "x = {name}.Data; save('log.mat', 't', 'x'); of a timetable: writetimetable({name}, 'log.csv')"
)
LOGS_EXTRA = "logs"
"""The extra that brings the libraries of the rarer formats."""
NO_START_TIME = np.datetime64("1904-01-01")
"""The start time of a LabVIEW waveform that has none: the zero of LabVIEW's clock."""


@dataclass(frozen=True)
class ForeignTable:
    """Columns of a file that is no text.

    Attributes:
        columns: Name to numbers, shape (K,) each, NaN where there is none, or to texts. Those
            without a clock belong together row by row where they have one length.
        units: Name to unit; of those that the file gives one.
        metadata: The run's metadata; empty for a file of a different program.
        clocks: Name to times in s, shape (K,), of columns that have times of their own.
        notes: What was left out or assumed, in words.
    """

    columns: dict[str, Array | list[str]]
    units: dict[str, str] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)
    clocks: dict[str, Array] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_parquet(path: Path) -> ForeignTable:
    """The columns of a Parquet file."""
    import pyarrow.parquet as pq  # noqa: PLC0415  heavy: a CSV file does without

    with pq.ParquetFile(path) as parquet:
        rows, count = parquet.metadata.num_rows, len(parquet.schema_arrow)
        check_size(rows, count, count, path.stat().st_size)
        return _of_arrow(parquet.read())


def read_arrow(path: Path) -> ForeignTable:
    """The columns of a file or a stream of Arrow."""
    import pyarrow as pa  # noqa: PLC0415  heavy: a CSV file does without

    with path.open("rb") as source:
        streamed = source.read(6) != b"ARROW1"
        source.seek(0)
        open_it = pa.ipc.open_stream if streamed else pa.ipc.open_file
        with open_it(source) as reader:
            count = 0 if streamed else reader.num_record_batches
            batches = reader if streamed else map(reader.get_batch, range(count))
            kept, rows = [], 0
            for batch in batches:
                rows += batch.num_rows
                check_size(rows, batch.num_columns, batch.num_columns, path.stat().st_size)
                kept.append(batch)
            return _of_arrow(pa.Table.from_batches(kept, reader.schema))


def _of_arrow(table: Any) -> ForeignTable:
    """The columns of a table of Arrow, with the units of its fields."""
    columns: dict[str, Array | list[str]] = {}
    units: dict[str, str] = {}
    for each in table.schema:
        if table.schema.names.count(each.name) == 1:
            values = table.column(each.name).to_numpy()
            columns[each.name] = numbers_of(values)
        if unit := (each.metadata or {}).get(b"unit"):
            units[each.name] = unit.decode(errors="replace")
    metadata = _own_metadata((table.schema.metadata or {}).get(METADATA_KEY, b"{}"))
    return ForeignTable(columns, units, metadata)


def _own_metadata(text: str | bytes) -> Any:
    """The metadata of an exported run.

    Raises:
        ValueError: If they are not JSON, or go beyond a limit.
    """
    try:
        return parse_json(text)
    except DataError as error:
        raise ValueError(f"metadata of a run: {error}") from None


def numbers_of(values: NDArray[Any]) -> Array | list[str]:
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


def split_matrix(name: str, values: NDArray[Any]) -> Iterator[tuple[str, Array | list[str]]]:
    """The columns of an array: itself, or of a matrix ``NAME.1``, ``NAME.2``, ...

    Rows are along the longer axis. Scalars, and arrays of more than two axes, have none.

    Args:
        name: Of the array; empty for columns that have a number alone.
        values: Any array.
    """
    if values.dtype.names:
        for part in values.dtype.names:
            yield from split_matrix(f"{name}.{part}" if name else part, values[part])
        return
    if values.dtype.kind not in "biufMmUSO":
        return
    values = np.squeeze(values)
    if values.ndim == 1 and len(values) > 1:
        yield name or "1", numbers_of(values)
    elif values.ndim == 2:
        tall = values if values.shape[0] >= values.shape[1] else values.T
        for k, column in enumerate(tall.T[:MAX_MATRIX_COLUMNS], start=1):
            yield f"{name}.{k}" if name else str(k), numbers_of(column)


def read_numpy(path: Path) -> ForeignTable:
    """The columns of an array of NumPy, or of an archive of such.

    Objects, which would be unpickled, are refused.
    """
    if not zipfile.is_zipfile(path):
        with path.open("rb") as file:
            return ForeignTable(dict(split_matrix("", _array(file, path.stat().st_size))))
    columns: dict[str, Array | list[str]] = {}
    notes = []
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        check_bytes(sum(entry.file_size for entry in entries), path)
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            with archive.open(entry) as file:
                try:
                    array = _array(file, entry.file_size)
                except ValueError as error:
                    notes.append(f"{name}: left out: {error}")
                    continue
            columns |= dict(split_matrix(name, array))
    if not columns and notes:
        raise ValueError(notes[0])
    return ForeignTable(columns, notes=tuple(notes))


def _array(file: Any, size: int) -> NDArray[Any]:
    """An array of NumPy of a file of so many bytes.

    Raises:
        ValueError: If it is none, holds objects, or its header promises more than the file has.
    """
    version = np.lib.format.read_magic(file)
    read_header = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, kind = read_header(file)
    if kind.hasobject:
        raise ValueError("holds Python objects, which are not unpickled")
    if math.prod(shape) * kind.itemsize > size:
        raise ValueError(f"is incomplete: its header states an array of {shape}")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def check_bytes(unpacked: int, path: Path) -> None:
    """Make sure that a file does not unpack into what only fills the memory.

    Raises:
        OSError: If it does.
    """
    size = path.stat().st_size
    most = max_unpacked(size)
    if unpacked > min(most, 8 * MOST_ROWS * MOST_COLUMNS):
        raise OSError(
            f"would take {1e-6 * unpacked:.0f} MB; at most {1e-6 * most:.0f} MB are read of a file "
            f"of {1e-3 * size:.0f} kB"
        )


def read_matlab(path: Path) -> ForeignTable:
    """The columns of a MATLAB 5 file: arrays, structures, and those of Simulink and ControlDesk."""
    from scipy.io import loadmat  # noqa: PLC0415  heavy: loaded when needed
    from scipy.io.matlab import MatlabFunction, MatlabOpaque  # noqa: PLC0415

    check_bytes(_unpacked_bytes(path), path)
    found = loadmat(path, struct_as_record=False, squeeze_me=True, chars_as_strings=True)
    values = {name: value for name, value in found.items() if not name.startswith("__")}
    opaque = [name for name, v in values.items() if isinstance(v, MatlabOpaque | MatlabFunction)]
    if "None" in values or "" in values:  # scipy's name of objects it has no name of
        opaque += [name for name in ("None", "") if name in values and name not in opaque]
    return _of_matlab(path, {n: _plain(v) for n, v in values.items() if n not in opaque}, opaque)


def _unpacked_bytes(path: Path) -> int:
    """Bytes of a MATLAB 5 file with its compressed elements unpacked, as far as matters."""
    raw = path.read_bytes()
    most = max_unpacked(len(raw))
    order = "<" if raw[126:128] == b"IM" else ">"
    at, total = MAT_HEADER_BYTES, 0
    while at + 8 <= len(raw) and total <= most:
        kind, size = struct.unpack_from(f"{order}II", raw, at)
        at += 8
        if kind == MAT_COMPRESSED:
            unpack, data = zlib.decompressobj(), raw[at : at + size]
            while data and total <= most:
                total += len(unpack.decompress(data, 1 << 20))
                data = unpack.unconsumed_tail
        else:
            total += size
        at += size
    return total


def _plain(value: Any, depth: int = 0) -> Any:
    """Structures of scipy as dictionaries, arrays of them as lists."""
    if hasattr(value, "_fieldnames") and depth < MAX_DEPTH:
        return {name: _plain(getattr(value, name), depth + 1) for name in value._fieldnames}
    if isinstance(value, np.ndarray) and value.dtype == object and depth < MAX_DEPTH:
        return [_plain(each, depth + 1) for each in value.ravel()[:MOST_COLUMNS]]
    return value


OWN_STRUCTS = {"units", "scenario", "parameters", "metrics", JSON_VARIABLE}
"""Structs next to the columns in an exported run, known by the units among them."""


def _of_matlab(path: Path, values: Mapping[str, Any], opaque: list[str]) -> ForeignTable:
    """The table of a workspace of MATLAB.

    Args:
        path: The file.
        values: Variable to array, dictionary of a structure, list of a structure array or a cell.
        opaque: Variables that are objects of MATLAB.
    """
    columns: dict[str, Array | list[str]] = {}
    clocks: dict[str, Array] = {}
    units = values.get("units") if isinstance(values.get("units"), dict) else {}
    stated: dict[str, str] = {}
    for name, value in values.items():
        if not (name in OWN_STRUCTS and units):
            _take(columns, clocks, stated, name, value)
    if opaque and not columns:
        name = opaque[0] if opaque[0] not in ("None", "") else "ts"
        raise LogError(f"{path.name}: {name} {OBJECT_ADVICE.format(name=name)}")
    notes = [f"{name} {OBJECT_ADVICE.format(name=name)}" for name in opaque]
    named = {n: str(u) for n, u in (units or {}).items() if n in columns and str(u)}
    text = values.get(JSON_VARIABLE) if units else None
    metadata = _own_metadata(text) if isinstance(text, str) else {}
    return ForeignTable(columns, named | stated, metadata, clocks, tuple(notes))


def _take(
    columns: dict[str, Array | list[str]],
    clocks: dict[str, Array],
    units: dict[str, str],
    name: str,
    value: Any,
) -> None:
    """Add the columns of a variable of MATLAB, their times and units."""
    if isinstance(value, dict):
        if "signals" in value:
            _take_signals(columns, clocks, name, value)
        elif {"X", "Y"} <= value.keys() and _channels_of(value["Y"]):
            _take_recording(columns, clocks, units, value)
        else:
            for part, inner in value.items():
                _take(columns, clocks, units, f"{name}.{part}", inner)
    elif isinstance(value, list):
        for k, inner in enumerate(value, start=1):
            if isinstance(inner, dict | list):
                _take(columns, clocks, units, f"{name}.{k}", inner)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        columns |= dict(split_matrix(name, value))


def _channels_of(value: Any) -> list[dict[str, Any]]:
    """The structures with a name and numbers in a part of a recording of ControlDesk."""
    found = value if isinstance(value, list) else [value]
    named = all(isinstance(each, dict) and {"Name", "Data"} <= each.keys() for each in found)
    return [each for each in found if isinstance(each["Data"], np.ndarray)] if named else []


def _take_recording(
    columns: dict[str, Array | list[str]],
    clocks: dict[str, Array],
    units: dict[str, str],
    value: Mapping[str, Any],
) -> None:
    """Add the channels of a recording of dSPACE ControlDesk by name, with their times and units."""
    times = [np.ravel(each["Data"]).astype(float) for each in _channels_of(value["X"])]
    for k, channel in enumerate(_channels_of(value["Y"]), start=1):
        word = channel["Name"]
        name = word if isinstance(word, str) and word.strip() else f"Y.{k}"
        own = f"{name}.{k}" if name in columns else name
        place = channel.get("XIndex")
        at = int(place) - 1 if isinstance(place, int | float) else 0
        for column, numbers in split_matrix(own, channel["Data"]):
            columns[column] = numbers
            if 0 <= at < len(times) and len(times[at]) == len(numbers):
                clocks[column] = times[at]
            if isinstance(unit := channel.get("Unit"), str) and unit.strip():
                units[column] = unit.strip()


def _take_signals(
    columns: dict[str, Array | list[str]],
    clocks: dict[str, Array],
    name: str,
    value: Mapping[str, Any],
) -> None:
    """Add the signals of a structure as Simulink logs it, by label, with its time."""
    own_time = np.ravel(np.asarray(value.get("time", ())))
    time = own_time.astype(float) if own_time.dtype.kind in "biuf" else np.zeros(0)
    if len(time) > 1:
        columns[f"{name}.time"] = time
        clocks[f"{name}.time"] = time
    signals = value["signals"]
    for k, signal in enumerate(signals if isinstance(signals, list) else [signals], start=1):
        if not isinstance(signal, dict) or not isinstance(signal.get("values"), np.ndarray):
            continue
        label = signal.get("label")
        word = label if isinstance(label, str) and label.strip() else f"signals.{k}"
        for column, numbers in split_matrix(f"{name}.{word}", signal["values"]):
            columns[column] = numbers
            if len(numbers) == len(time):
                clocks[column] = time


def read_hdf5(path: Path) -> ForeignTable:
    """The columns of an HDF5 file, also of MATLAB 7.3.

    Links, data in other files and objects are not followed.
    """
    with extra(LOGS_EXTRA, f"{path.name}: an HDF5 file"):
        import h5py  # noqa: PLC0415
    with path.open("rb") as opened:
        head = opened.read(16)
    with h5py.File(path, "r") as file:
        if b"MATLAB" in head or any("MATLAB_class" in item.attrs for item in file.values()):
            opaque: list[str] = []
            values = {
                name: _of_hdf5(file, item, name, opaque)
                for name, item in _items(file)
                if not name.startswith("#")
            }
            return _of_matlab(path, {n: v for n, v in values.items() if v is not None}, opaque)
        columns: dict[str, Array | list[str]] = {}
        units: dict[str, str] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and _is_readable(item, path):
                columns.update(split_matrix(name, item[()]))
                unit = item.attrs.get("units", item.attrs.get("unit"))
                if isinstance(unit, str):
                    units[name] = unit

        file.visititems(visit)
    return ForeignTable(columns, {n: u for n, u in units.items() if n in columns})


def _items(group: Any) -> Iterator[tuple[str, Any]]:
    """Members of a group that are in this file and no links."""
    import h5py  # noqa: PLC0415

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield name, group[name]


def _is_readable(dataset: Any, path: Path) -> bool:
    """Whether a dataset holds numbers of this file, of a size that is a log's.

    Raises:
        OSError: If it would fill the memory.
    """
    if dataset.dtype.kind not in "biufV" or dataset.dtype.hasobject or dataset.shape is None:
        return False
    if dataset.is_virtual or dataset.external or not 1 <= len(dataset.shape) <= 2:
        return False
    check_bytes(dataset.size * dataset.dtype.itemsize, path)
    return True


def _of_hdf5(file: Any, item: Any, name: str, opaque: list[str], depth: int = 0) -> Any:
    """A variable of MATLAB 7.3: array, text, dictionary or list; None where there is none."""
    import h5py  # noqa: PLC0415

    if "MATLAB_object_decode" in item.attrs:
        opaque.append(name)
    if depth > MAX_DEPTH or "MATLAB_object_decode" in item.attrs:
        return None
    if isinstance(item, h5py.Group):
        found = {k: _of_hdf5(file, v, k, opaque, depth + 1) for k, v in _items(item)}
        return _structure_array(found)
    if item.dtype == h5py.ref_dtype and item.size <= MOST_COLUMNS:
        inner = [file[each] for each in item[()].ravel() if each]
        return [_of_hdf5(file, each, name, opaque, depth + 1) for each in inner]
    path = Path(file.filename)
    readable = "MATLAB_empty" not in item.attrs and _is_readable(item, path)
    values = item[()].T if readable else None
    if values is not None and item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, values.ravel()[:200]))
    return values


def _structure_array(found: dict[str, Any]) -> Any:
    """A structure, or, where each field is a list of one length, the list of structures."""
    lengths = {len(v) if isinstance(v, list) else -1 for v in found.values() if v is not None}
    if len(lengths) != 1 or -1 in lengths:
        return found
    (count,) = lengths
    return [{k: v[row] for k, v in found.items() if v is not None} for row in range(count)]


def read_excel(path: Path) -> ForeignTable:
    """The columns of the first sheet with numbers of an Excel file; the row above names them."""
    with extra(LOGS_EXTRA, f"{path.name}: an Excel file"):
        from openpyxl import load_workbook  # noqa: PLC0415
    with zipfile.ZipFile(path) as archive:
        check_bytes(sum(entry.file_size for entry in archive.infolist()), path)
    with path.open("rb") as file:  # by its name openpyxl would go by the ending
        return _of_book(path, load_workbook(file, read_only=True, data_only=True, keep_links=False))


def _of_book(path: Path, book: Any) -> ForeignTable:
    """The columns of the first sheet with numbers of a workbook."""
    try:
        for sheet in book.worksheets:
            rows = [list(row[:MOST_COLUMNS]) for row in sheet.iter_rows(values_only=True)]
            begins = next((k for k, row in enumerate(rows) if _is_numeric(row)), None)
            if begins is None:
                continue
            above, stated = _names_of_sheet(rows[:begins])
            width = max(map(len, rows[begins:]))
            columns: dict[str, Array | list[str]] = {}
            units: dict[str, str] = {}
            for k in range(width):
                name = str(above[k]) if k < len(above) and above[k] is not None else str(k + 1)
                cells = [_cell(row[k]) if k < len(row) else None for row in rows[begins:]]
                columns[name] = numbers_of(np.array([*cells, None], dtype=object)[:-1])
                if k < len(stated) and stated[k] is not None:
                    units[name] = str(stated[k]).strip("[]() ")
            others = [each.title for each in book.worksheets if each is not sheet]
            notes = (f"read of sheet {sheet.title}, not of {', '.join(others)}",) if others else ()
            return ForeignTable(columns, units, notes=notes)
    finally:
        book.close()
    raise LogError(f"{path.name}: no sheet has rows of numbers")


def _names_of_sheet(rows: list[list[Any]]) -> tuple[list[Any], list[Any]]:
    """The names and the units of columns, of the rows above the first numbers; empty without any.

    Units have a row of their own, below the names, if each of its filled cells is one.
    """
    above, before = (rows[-1] if rows else []), (rows[-2] if len(rows) > 1 else [])
    words = [str(cell).strip("[]() ") for cell in above if cell is not None]
    if words and any(cell is not None for cell in before) and all(map(is_unit, words)):
        return before, above
    return above, []


def _is_numeric(row: list[Any]) -> bool:
    """Whether more than half of the filled cells of a row are numbers or times."""
    filled = [cell for cell in row if cell is not None]
    return 2 * sum(not isinstance(_cell(cell), str) for cell in filled) > len(filled) > 0


def _cell(value: Any) -> Any:
    """A cell of a sheet: a number, times in s, or its text."""
    if isinstance(value, datetime):
        return value.replace(tzinfo=UTC).timestamp()
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day, tzinfo=UTC).timestamp()
    if isinstance(value, time):
        return 3600 * value.hour + 60 * value.minute + value.second + 1e-6 * value.microsecond
    return value.total_seconds() if isinstance(value, timedelta) else value


def read_tdms(path: Path) -> ForeignTable:
    """The channels of a LabVIEW file as ``GROUP/CHANNEL``, with the times of their waveforms.

    Where every waveform has a start time, times count from the first start.
    """
    with extra(LOGS_EXTRA, f"{path.name}: a LabVIEW file"):
        from nptdms import TdmsFile  # noqa: PLC0415
    columns: dict[str, Array | list[str]] = {}
    units: dict[str, str] = {}
    clocks: dict[str, Array] = {}
    starts: dict[str, np.datetime64] = {}
    with path.open("rb") as opened, TdmsFile.open(opened) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        check_size(max(map(len, channels), default=0), len(channels), 1, path.stat().st_size)
        check_bytes(8 * sum(map(len, channels)), path)
        for channel in channels:
            name = f"{channel.group_name}/{channel.name}"
            values = np.asarray(channel[:])
            if values.dtype.kind not in "biufM" or len(values) < 2:
                continue
            columns[name] = numbers_of(values)
            unit = channel.properties.get("unit_string")
            if isinstance(unit, str) and unit:
                units[name] = unit
            step = channel.properties.get("wf_increment")
            if isinstance(step, float) and step > 0:
                offset = float(channel.properties.get("wf_start_offset", 0.0))
                clocks[name] = offset + step * np.arange(len(values))
                start = channel.properties.get("wf_start_time")
                if isinstance(start, np.datetime64) and start != NO_START_TIME:
                    starts[name] = start
    if not clocks or len(starts) < len(clocks):
        return ForeignTable(columns, units, clocks=clocks)
    first = min(starts.values())
    shifts = {name: float((each - first) / np.timedelta64(1, "s")) for name, each in starts.items()}
    clocks = {name: clock + shifts[name] for name, clock in clocks.items()}
    apart = max(shifts.values())
    note = f"the waveforms start up to {apart:.3g} s apart: times count from the first start"
    return ForeignTable(columns, units, clocks=clocks, notes=(note,) if apart > 0 else ())
