"""Columns with their units as files of other programs: CSV, MATLAB, Parquet, and MCAP of ROS 2."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.base.data_file import read_toml
from twin.base.errors import RecordError, nearest
from twin.base.writing import write_whole

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from controllers.arrays import Array


Units = Mapping[str, str]
Columns = Mapping[str, "Array"]
About = Mapping[str, Any]


FILM_SUFFIXES = (".webp", ".gif", ".mp4")
"""Endings of moving pictures of runs, see ``twin.run.film``."""


def export(path: Path, columns: Columns, units: Units, about: About | None = None) -> None:
    """Write columns of one length into a file in the format of its ending.

    Args:
        path: ``.csv``: a header ``name [unit]``, as ``identify`` reads it, numbers with all their
            digits. ``.mat``: one column vector per name, and the struct ``units``, for MATLAB; of
            a run also the structs ``scenario``, ``parameters`` and ``metrics``, and the same in
            JSON as the text ``record_json``, from which they are read back.
            ``.parquet``: one column per name with its unit in the metadata. ``.mcap``:
            messages of ROS 2, see ``ros2.toml``, by the extra ``mcap``.
        columns: Name to values, shape (K,) each.
        units: Name to unit.
        about: Further data by name: structs of a .mat file, metadata of a Parquet file, attachments
            of an MCAP file in JSON. A CSV file has no place for them.

    Raises:
        RecordError: If the ending is none of these, a package for it is missing, or the file cannot
            be written.
    """
    check_ending(path)
    write = WRITERS[path.suffix]
    write_whole(path, lambda target: write(target, columns, units, about or {}))


def check_ending(path: Path, more: Sequence[str] = ()) -> None:
    """Make sure that columns can be written into a file of this ending.

    Args:
        path: The file.
        more: Further endings that are allowed.

    Raises:
        RecordError: If they cannot.
    """
    if path.suffix not in (*WRITERS, *more):
        known, moves = ", ".join(WRITERS), ", ".join(FILM_SUFFIXES)
        raise RecordError(
            f"{path}: unknown ending; known: {known}, moving pictures: {moves}; of a scenario: "
            ".fmu, .c"
        )


def _csv(path: Path, columns: Columns, units: Units, about: About) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(f"{name} [{units[name]}]" if units.get(name) else name for name in columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


METADATA_KEY = b"ballplate"
"""Key of the metadata of a Parquet or Arrow file under which a run has its own, in JSON."""
JSON_VARIABLE = "record_json"
"""Variable of a .mat file with all further data in JSON, which keeps what MATLAB's types lose."""


def _mat(path: Path, columns: Columns, units: Units, about: About) -> None:
    from scipy.io import savemat  # noqa: PLC0415  heavy: loaded when needed

    named = {_plain(name): values for name, values in columns.items()}
    savemat(
        path,
        {
            **{_plain(name): _matlab_value(value) for name, value in about.items()},
            **({JSON_VARIABLE: json.dumps(about)} if about else {}),
            **named,
            "units": {_plain(name): units.get(name, "") for name in columns},
        },
        oned_as="column",
        appendmat=False,
        long_field_names=True,
    )


def _matlab_value(value: Any) -> Any:
    """A value of JSON as MATLAB has it.

    A table is a struct, a list of numbers a row, rows of one length a matrix, any other list a cell
    array; nothing is an empty matrix.
    """
    import numpy as np  # noqa: PLC0415  heavy: loaded when needed

    if value is None:
        return np.zeros((0, 0))
    if isinstance(value, Mapping):
        return {_plain(name): _matlab_value(each) for name, each in value.items()}
    if not isinstance(value, list | tuple):
        return value
    with suppress(TypeError, ValueError):  # rows of different lengths
        if np.asarray(value).dtype.kind in "biuf":
            return np.array(value, float)
    cells = np.empty(len(value), object)
    cells[:] = [_matlab_value(each) for each in value]
    return cells


def _plain(name: str) -> str:
    """A name that MATLAB and ROS allow."""
    return re.sub(r"\W", "_", name)


def ros_field(name: str) -> str:
    """Name of a column in a message of ROS."""
    return _plain(name).lower()


def _parquet(path: Path, columns: Columns, units: Units, about: About) -> None:
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415

    arrays = [pa.array(values.tolist(), pa.float64()) for values in columns.values()]
    fields = arrow_fields({name: units.get(name, "") for name in columns})
    schema = pa.schema(fields, {METADATA_KEY: json.dumps(about)} if about else None)
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), path)


ROS2_TABLES = read_toml(Path(__file__).with_name("ros2.toml"))
"""Topics of an MCAP file, and the messages of ROS 2 on them."""
UPRIGHT_ORIENTATION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
"""The orientation of the frame itself, as a quaternion."""


def _mcap(path: Path, columns: Columns, units: Units, about: About) -> None:
    """Each period is a message of each topic of which the columns exist; time is the run's."""
    try:
        from mcap_ros2.writer import Writer  # noqa: PLC0415  of an extra
    except ImportError as error:
        raise RecordError("needs the extra mcap: pip install 'ballplate[mcap]'") from error
    fields = {ros_field(name): name for name in columns}
    own = "".join(f"float64 {field}  # {units.get(name) or 1}\n" for field, name in fields.items())
    parts = "".join(
        f"{80 * '='}\nMSG: {name}\n{text}" for name, text in ROS2_TABLES["parts"].items()
    )
    topics = {
        t: each for t, each in ROS2_TABLES["topics"].items() if columns.keys() >= {*each["columns"]}
    }
    with path.open("wb") as file, Writer(file) as writer:
        for name, content in about.items():
            data = json.dumps(content, indent=2).encode()
            writer.add_attachment(0, 0, f"{name}.json", "application/json", data)
        writer.add_metadata("units", {name: units.get(name, "") for name in columns})
        schemas = {
            kind: writer.register_msgdef(kind, text + (own if "Signals" in kind else "") + parts)
            for kind, text in ROS2_TABLES["messages"].items()
        }
        every = zip(*(each.tolist() for each in columns.values()), strict=True)
        for row, values in enumerate(every):
            now = dict(zip(columns, values, strict=True))
            nanoseconds = round(1e9 * now["time"])
            sec, nanosec = divmod(nanoseconds, 10**9)
            stamp = {"sec": sec, "nanosec": nanosec}
            message: dict[str, Any] = {field: now[name] for field, name in fields.items()}
            message |= {"header": {"stamp": stamp, "frame_id": "plate"}, "name": ["phi", "theta"]}
            for topic, each in topics.items():
                of_it = [now[name] for name in each["columns"]]
                joints = {"position": of_it[:2], "velocity": of_it[2:], "effort": []}
                position = dict(zip("xyz", (*of_it[:2], 0.0), strict=False))
                pose = {"pose": {"position": position, "orientation": UPRIGHT_ORIENTATION}}
                # an encoder takes of it what its message has
                content, schema = message | joints | pose, schemas[each["message"]]
                writer.write_message(topic, schema, content, nanoseconds, sequence=row)


WRITERS: dict[str, Callable[[Path, Columns, Units, About], None]] = {
    ".csv": _csv,
    ".mat": _mat,
    ".parquet": _parquet,
    ".mcap": _mcap,
}
"""Ending of a file to what writes it."""


def arrow_fields(units: Units) -> list[pa.Field]:
    """Columns of numbers as Arrow names them, each with its unit."""
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed

    return [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in units.items()]


class Signals(Mapping[str, "Array"]):
    """Columns of one rig's record, shape (K,) each, by their names.

    Attributes:
        rows: Name to values.
        units: Name to unit, as ``m`` or ``rad/s``.

    Examples:
        >>> import ballplate as bp
        >>> done = bp.run("hold", ["plant.kind=lagrange"], duration=0.1)
        >>> isinstance(done, bp.Signals), done["measured_x"].shape, done.units["measured_x"]
        (True, (50,), 'm')
    """

    rows: Mapping[str, Array]
    units: Mapping[str, str]

    def __getitem__(self, name: str) -> Array:
        """The values of a column, shape (K,).

        Raises:
            RecordError: If there is none of that name.
        """
        if name not in self:
            raise RecordError(f"no column '{name}'{nearest(name, self)}")
        return self.rows[name]

    def __contains__(self, name: object) -> bool:
        return name in self.rows

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def time(self) -> Array:
        """Seconds since the start, shape (K,)."""
        return self["time"]

    def to_pandas(self) -> pd.DataFrame:
        """The columns as a table over time in s; ``attrs["units"]`` has their units."""
        import pandas as pd  # noqa: PLC0415  heavy: loaded when needed

        frame = pd.DataFrame(dict(self)).set_index("time")
        frame.attrs["units"] = dict(self.units)
        return frame

    @property
    def about(self) -> dict[str, Any]:
        """What there is to tell of them besides, by name, for files that can hold it."""
        return {}

    def export(self, file: str | Path) -> Path:
        """Write the columns for other programs, with their units; returns the file.

        Args:
            file: Format by its ending: ``.csv``, ``.mat``, ``.parquet``, or ``.mcap`` for ROS 2,
                Foxglove and Rerun, by the extra ``mcap``.

        Raises:
            RecordError: If the ending is none of these, or the file cannot be written.
        """
        export(Path(file), dict(self), self.units, self.about)
        return Path(file)
