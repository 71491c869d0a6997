"""Signals of a rig: columns with units, and their files for other programs.

Those are CSV, MATLAB, Parquet, and MCAP with messages of ROS 2.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.data_file import read_toml
from twin.errors import RecordError, nearest
from twin.writing import write_whole

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from controllers.arrays import Array

Units = Mapping[str, str]
Columns = Mapping[str, "Array"]
About = Mapping[str, Any]


MOVING = (".webp", ".gif", ".mp4")
"""Endings of moving pictures of runs, see ``twin.run.film``."""


def export(path: Path, columns: Columns, units: Units, about: About | None = None) -> None:
    """Write columns of one length into a file; its ending says how.

    Args:
        path: ``.csv``: a header ``name [unit]``, as ``identify`` reads it, numbers with all their
            digits. ``.mat``: one column vector per name, and the struct ``units``, for MATLAB.
            ``.parquet``: one column per name with its unit in the metadata. ``.mcap``:
            messages of ROS 2, see ``ros2.toml``, by the extra ``mcap``.
        columns: Name to values, shape (K,) each.
        units: Name to unit.
        about: What else there is to tell, by name: attachments of an MCAP file, in JSON.

    Raises:
        RecordError: If the ending is none of these, what it needs is lacking, or the file cannot be
            written.
    """
    write = WRITERS.get(path.suffix)
    if write is None:
        known, moves = ", ".join(WRITERS), ", ".join(MOVING)
        raise RecordError(
            f"{path}: the ending says what is written; known: {known}, moving pictures: {moves}"
        )
    write_whole(path, lambda target: write(target, columns, units, about or {}))


def _csv(path: Path, columns: Columns, units: Units, about: About) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(f"{name} [{units[name]}]" if units.get(name) else name for name in columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


def _mat(path: Path, columns: Columns, units: Units, about: About) -> None:
    from scipy.io import savemat  # noqa: PLC0415  heavy: loaded when needed

    named = {_plain(name): values for name, values in columns.items()}
    savemat(
        path,
        {**named, "units": {_plain(name): units.get(name, "") for name in columns}},
        oned_as="column",
        appendmat=False,
        long_field_names=True,
    )


def _plain(name: str) -> str:
    """A name that MATLAB and ROS allow."""
    return re.sub(r"\W", "_", name)


def _parquet(path: Path, columns: Columns, units: Units, about: About) -> None:
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415

    arrays = [pa.array(values.tolist(), pa.float64()) for values in columns.values()]
    schema = pa.schema(arrow_fields({name: units.get(name, "") for name in columns}))
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), path)


ROS2 = read_toml(Path(__file__).with_name("ros2.toml"))
"""Topics of an MCAP file, and the messages of ROS 2 on them."""


def _mcap(path: Path, columns: Columns, units: Units, about: About) -> None:
    """Each period is a message of each topic whose columns are there; time is that of the run."""
    try:
        from mcap_ros2.writer import Writer  # noqa: PLC0415  of an extra
    except ImportError as error:
        raise RecordError("needs the extra mcap: pip install 'ballplate[mcap]'") from error
    fields = {_plain(name).lower(): name for name in columns}
    own = "".join(f"float64 {field}  # {units.get(name) or 1}\n" for field, name in fields.items())
    parts = "".join(f"{80 * '='}\nMSG: {name}\n{text}" for name, text in ROS2["parts"].items())
    topics = {t: each for t, each in ROS2["topics"].items() if columns.keys() >= {*each["columns"]}}
    with path.open("wb") as file, Writer(file) as writer:
        for name, content in about.items():
            data = json.dumps(content, indent=2).encode()
            writer.add_attachment(0, 0, f"{name}.json", "application/json", data)
        writer.add_metadata("units", {name: units.get(name, "") for name in columns})
        schemas = {
            kind: writer.register_msgdef(kind, text + (own if "Signals" in kind else "") + parts)
            for kind, text in ROS2["messages"].items()
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
                point = {"point": {"x": of_it[0], "y": of_it[1], "z": 0.0}} if of_it else {}
                # an encoder takes of it what its message has
                content, schema = message | joints | point, schemas[each["message"]]
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
    """

    rows: Mapping[str, Array]
    units: Mapping[str, str]

    def __getitem__(self, name: str) -> Array:
        """The values of a column, shape (K,).

        Raises:
            RecordError: If there is none of that name.
        """
        try:
            return self.rows[name]
        except KeyError:
            raise RecordError(f"no column '{name}'{nearest(name, self.rows)}") from None

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
            file: Its ending says how: ``.csv``, ``.mat``, ``.parquet``, or ``.mcap`` for ROS 2,
                Foxglove and Rerun, by the extra ``mcap``.

        Raises:
            RecordError: If the ending is none of these, or the file cannot be written.
        """
        export(Path(file), self.rows, self.units, self.about)
        return Path(file)
