"""Files of runs: their folders, their indicators, and their columns for other programs.

Columns of a run with their units become CSV, MATLAB, Parquet, and MCAP with messages of ROS 2.
"""

from __future__ import annotations

import csv
import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

from twin.base.data_file import DataError, parse_json, read_toml
from twin.base.errors import LogError, RecordError, nearest
from twin.base.foreign import kind_of
from twin.base.shipped import nearest_neighbour, shipped_scenarios
from twin.base.writing import write_whole

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from controllers.arrays import Array


RUNS_FOLDER = Path("runs")
"""Folder of the working folder in which every run has a folder by default."""
NEWEST_RUN = "last"
"""The word that stands for the newest run wherever a run folder is asked for."""
STREAM_FILE = "run.arrows"
"""The record of a run on a rig while it lasts; it stays where the run was killed."""
RUN_FILES = ("run.parquet", "metrics.json", "picture.png", STREAM_FILE)
"""Files of a run folder."""
MANIFEST_FILE = "compare.json"
"""File of a comparison that lists the folders of its runs, and their indicators."""
PICTURE_OF_MANY = "compare.png"
"""Picture of the runs of a comparison, in their folder."""
WHATIF_FILE = "whatif.json"
"""File of futures of a run: what ``--json`` prints, and their folders."""
MAX_LINKED_RUNS = 100_000
"""Position of a linked run from which the file that names it is damaged."""
MAX_NAME_LENGTH = 100
"""Characters of a folder's name."""


def run_folder(name: str, overrides: Sequence[str] = ()) -> Path:
    """The folder of a run, named by what was run and what was changed of it.

    Args:
        name: Scenario as asked for; of a file its name without the ending.
        overrides: ``KEY=VALUE`` each; of a key the last two parts are enough to tell runs apart.
    """
    changed = dict(text.partition("=")[::2] for text in overrides)
    settings = [f"{short_key(key)}={value}" for key, value in changed.items()]
    return RUNS_FOLDER / slug("-".join((Path(name).stem, *settings)))


def short_key(key: str) -> str:
    """The last two parts of a dotted key; ``controller.kind`` gives ``controller``."""
    return ".".join(key.strip().removesuffix(".kind").split(".")[-2:])


def slug(text: str) -> str:
    """A text as the name of a folder; one that loses more than brackets ends in a hash of it."""
    bare = re.sub(r"\s+", "-", re.sub(r"[\"'\[\]{}]|(?<=,)\s+", "", text))
    name = re.sub(r"[^\w.,=+~-]", "_", bare).lstrip("-.")
    if name == bare and len(name) <= MAX_NAME_LENGTH:
        return name
    mark = hashlib.sha256(text.encode()).hexdigest()[:6]
    most = MAX_NAME_LENGTH - 7
    return "-".join(filter(None, (_cut(name, most) if len(name) > most else name, mark)))


def _cut(name: str, most: int) -> str:
    """The beginning of a name: cut between two settings, else between words.

    Where that leaves less than half of what may stay, it is cut anywhere.
    """
    for signs in ("-", ",_="):
        end = max(name.rfind(sign, 0, most + 1) for sign in signs)
        if end >= most // 2:
            return name[:end]
    return name[:most]


def folder_names(texts: Iterable[str]) -> list[str]:
    """A name of a folder for each text, no two equal where upper and lower case are one.

    None is the name of a file that lies next to run folders.
    """
    found: list[str] = []
    taken = {MANIFEST_FILE, PICTURE_OF_MANY}
    for text in texts:
        name, number = slug(text), 1
        while name.casefold() in taken:
            number += 1
            name = f"{slug(text)}~{number}"
        taken.add(name.casefold())
        found.append(name)
    return found


def free(folder: Path) -> Path:
    """The folder, or, if a run is in it, the next of its name that is free."""
    number, found = 1, folder
    while record_in(found).exists():
        number += 1
        found = folder.with_name(f"{folder.name}~{number}")
    return found


def number_name(name: str, taken: Iterable[str]) -> str:
    """A name, or, if others have it already, with its number among them behind it."""
    others = sum(other.partition("~")[0] == name for other in taken)
    return f"{name}~{others + 1}" if others else name


def last(root: Path = RUNS_FOLDER) -> Path:
    """The newest run folder, or folder of run folders, below a folder.

    Raises:
        RecordError: If there is none.
    """
    times = {
        folder: max(file.stat().st_mtime_ns for file in files)
        for folder in (root.iterdir() if root.is_dir() else ())
        if (files := list(_records(folder)))
    }
    if not times:
        raise RecordError(f"no run in {root}/ yet; begin with: ballplate run circle")
    return max(times, key=lambda folder: (times[folder], folder))


def forget(folder: Path, manifest: str = MANIFEST_FILE) -> None:
    """Remove the runs that a file of their folder lists, so that none of them stays behind.

    Only what those runs consist of, and the list, is removed.
    """
    for run in [folder / name for name in read_manifest(folder, manifest)]:
        for name in RUN_FILES:
            (run / name).unlink(missing_ok=True)
        with suppress(OSError):  # somebody else's files are in it
            run.rmdir()
    (folder / manifest).unlink(missing_ok=True)


def read_manifest(folder: Path, manifest: str = MANIFEST_FILE) -> dict[str, str]:
    """The folders that a file of their folder lists, in its order, and what each run is called."""
    try:
        found = parse_json((folder / manifest).read_bytes())
        inner = [Path(str(name)).name for name in found["folders"]]
        if any(name in ("", "..") or "\0" in name for name in inner):
            return {}  # no folder within this one, whoever wrote it
        return dict(zip(inner, map(str, found.get("names", inner)), strict=True))
    except (OSError, DataError, KeyError, TypeError, ValueError, AttributeError):
        return {}


def read_links(folder: Path, manifest: str = MANIFEST_FILE) -> list[tuple[int, Path]]:
    """The finished runs that a comparison has shown and that lie elsewhere: position and folder.

    None if the file is damaged.
    """
    try:
        found = parse_json((folder / manifest).read_bytes()).get("linked", [])
        links = [(int(each["position"]), folder / str(each["run"])) for each in found]
    except (OSError, DataError, KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return []
    if any(not 0 <= position < MAX_LINKED_RUNS or "\0" in str(run) for position, run in links):
        return []
    return sorted(links)


def is_last(path: Path) -> bool:
    """Whether a path is the word that stands for the newest run."""
    return path == Path(NEWEST_RUN) and not path.exists()


def record_of(path: Path) -> Path:
    """The file of a run or log: of a run folder its record, of ``last`` the newest run's record.

    Raises:
        RecordError: If ``last`` is asked for and there is none, or the folder holds several runs.
    """
    path = last() if is_last(path) else path
    if not path.is_dir():
        return path
    inner = run_folders(path)
    if len(inner) == 1:
        return record_in(inner[0])
    if inner:
        raise RecordError(
            f"{path}: contains {len(inner)} runs; give one of them, such as {inner[0]}"
        )
    return record_in(path)


def record_in(folder: Path) -> Path:
    """The record of a run folder, or, of a run that was killed, its stream."""
    whole, streamed = folder / "run.parquet", folder / STREAM_FILE
    return streamed if streamed.exists() and not whole.exists() else whole


def is_record(file: Path) -> bool:
    """Whether a file is the record of its folder."""
    return file.name in ("run.parquet", STREAM_FILE)


def run_name(path: Path) -> str:
    """Name of a run or log: of a record its folder, of any other file its own name."""
    file = record_of(path)
    return file.resolve().parent.name if is_record(file) else file.stem


def run_folders(folder: Path) -> list[Path]:
    """The run folders that a folder is, holds or links to.

    Those that were made together are in their order, and each linked one at its position.
    """
    order = [*read_manifest(folder), *read_manifest(folder, WHATIF_FILE)]
    found = sorted(file.parent for file in _records(folder))
    found.sort(key=lambda run: order.index(run.name) if run.name in order else len(order))
    for position, run in read_links(folder):
        found.insert(position, run)
    return found


def _records(folder: Path) -> Iterator[Path]:
    own = record_in(folder)
    if own.exists():
        yield own
    else:
        yield from filter(Path.exists, map(record_in, folder.glob("*/")))


TEXT_SUFFIXES = {".csv", ".txt", ".tsv", ".dat", ".log"}
"""File names of logs."""
IGNORED_SUFFIXES = {".png", ".json", ".html", ".pdf", ".tex", ".rrd", ".svg", ".md"}
"""Endings of files that lie next to runs, as a pattern finds them."""


class Sources(NamedTuple):
    """Arguments sorted out.

    Attributes:
        scenarios: Names and files of scenarios, to be run.
        runs: Run folders, folders of such, and Parquet files.
        logs: CSV files.
    """

    scenarios: tuple[str, ...]
    runs: tuple[Path, ...]
    logs: tuple[Path, ...]


def sorted_out(arguments: Sequence[str], *, of_any_rig: bool = False) -> Sources:
    """Sort arguments into scenarios, finished runs and logs.

    A name of a shipped scenario stands for it; a folder or file of that name is ``./NAME``. Folders
    without a run are passed over where there is anything else, as are the files a pattern finds.

    Args:
        arguments: As they were given.
        of_any_rig: Whether columns of logs are named: then a Parquet file that is no record is one.
    """
    known = shipped_scenarios()
    scenarios, runs, logs = [], [], []
    for text in arguments:
        path = Path(text)
        if text in known or not (path.exists() or is_last(path) or path.suffix in RECORD_SUFFIXES):
            scenarios.append(text)
        elif is_log(path, of_any_rig=of_any_rig):
            logs.append(path)
        elif (
            is_last(path) or path.suffix in RECORD_SUFFIXES or (path.is_dir() and run_folders(path))
        ):
            runs.append(path)
        elif not path.is_dir() and path.suffix not in IGNORED_SUFFIXES:
            scenarios.append(text)
    if not (scenarios or runs or logs):
        return Sources((), tuple(map(Path, arguments)), ())
    return Sources(tuple(scenarios), tuple(runs), tuple(logs))


def is_log(path: Path, *, of_any_rig: bool = False) -> bool:
    """Whether a path is a log: by its ending a text, there or not, or a file of a known kind.

    Args:
        path: What was given; a folder is none.
        of_any_rig: Whether columns of logs are named: then a Parquet file that is no record is one.
    """
    if path.suffix in TEXT_SUFFIXES and not path.is_dir():
        return True
    if path.suffix in RECORD_SUFFIXES:
        return of_any_rig and path.is_file() and not is_record(path)
    return path.suffix not in IGNORED_SUFFIXES and path.is_file() and bool(kind_of(path))


BAG_SUFFIXES = {".mcap", ".db3"}
"""Endings of the files with the messages of a bag of ROS 2, in its folder."""


def log_file(path: Path) -> Path:
    """The file of a recorded run or log; of the folder of a bag of ROS 2 its file of messages.

    Raises:
        TwinError: If there is none, or the bag has several.
    """
    check_no_scenario(path)
    bags = []
    if path.is_dir() and not run_folders(path):
        bags = sorted(each for each in path.iterdir() if each.suffix in BAG_SUFFIXES)
    if len(bags) > 1:
        raise LogError(f"{path}: a bag of {len(bags)} files; give one of them, such as {bags[0]}")
    file = bags[0] if bags else record_of(path)
    if not file.is_file():
        raise LogError(
            f"log {file}: not found; give a run.parquet, its folder, or a log such as a CSV file"
        )
    return file


def check_no_scenario(path: Path) -> None:
    """Make sure that what is to be opened is not a scenario, or the run of one that was not made.

    Raises:
        RecordError: If it is.
    """
    name = path.relative_to(RUNS_FOLDER) if path.is_relative_to(RUNS_FOLDER) else path
    if name.as_posix() in shipped_scenarios() and not path.exists():
        what = "is a scenario, not a run" if name == path else "is not there yet"
        first = f"first: ballplate run {name}, then open runs/{name.name}"
        raise RecordError(f"{path} {what}; {first}{nearest_neighbour(path)}")


RECORD_SUFFIXES = {".csv", ".parquet", ".arrows"}
"""Endings that no scenario has."""


INDICATORS: dict[str, dict[str, str]] = read_toml(Path(__file__).with_name("indicators.toml"))
"""Every indicator with ``unit``, ``words`` and the unit it is ``printed`` with."""
INDICATOR_UNITS = {name: about["unit"] for name, about in INDICATORS.items() if "unit" in about}
"""Unit of every indicator as JSON has it."""
BOARD_INDICATORS = ("command_difference", "instructions_median", "instructions_max")
"""Those that a run has only if its controller is a program."""
MOTION_INDICATORS = tuple(
    name
    for name in INDICATORS
    if name not in {"outcome", "outcome_time", "judged_from", "real_time_factor", *BOARD_INDICATORS}
)
"""Indicators that evaluate a motion."""


def nearest_indicator(name: object, known: Iterable[str] = MOTION_INDICATORS) -> str:
    """The end of a message about an unknown indicator: the one that is meant, and those known.

    Args:
        name: As it was given; also a word that a table prints for an indicator, as ``e_tt``.
        known: Names of those that there are.
    """
    names = list(known)
    word = str(name).casefold()
    called = {each: INDICATORS.get(each, {}).get("words", "").casefold().split() for each in names}
    meant = [each for each, words in called.items() if word in words]
    return nearest(meant[0] if len(meant) == 1 else name, names)


class Indicators(dict[str, Any]):
    """Indicators of a run by name; one that it lacks is a ``KeyError`` with the nearest name."""

    def __missing__(self, name: object) -> NoReturn:
        raise KeyError(f"no indicator '{name}'{nearest_indicator(name, self)}")


LOST_ENDINGS = ("fell", "lost", "diverged")
"""Endings after which no error is shown: a lost ball has none."""


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
