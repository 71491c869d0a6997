"""Folders and files of runs: how they are named, where they lie, and which of them is meant."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from twin.base.data_file import DataError, parse_json
from twin.base.errors import LogError, RecordError
from twin.base.foreign import kind_of
from twin.base.shipped import nearest_neighbour, shipped_scenarios

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
    folders = list(root.iterdir()) if root.is_dir() else []
    times = {
        folder: max(file.stat().st_mtime_ns for file in files)
        for folder in folders
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
