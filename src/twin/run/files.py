"""Run folders, what a command is given to look at, and what signals are."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from twin.data_file import DataError, parse_json
from twin.errors import LogError, RecordError
from twin.shipped import shipped

if TYPE_CHECKING:
    pass


ROOT = Path("runs")
"""Folder of the working folder in which every run has its own, unless it is told another."""
LAST = "last"
"""The word that stands for the newest run wherever a run folder is asked for."""
STREAM = "run.arrows"
"""The record of a run on a rig while it lasts; it stays where the run was killed."""
FILES = ("run.parquet", "metrics.json", "picture.png", STREAM)
"""What a run folder holds."""
MANIFEST = "compare.json"
"""File of a comparison that lists the folders of its runs, and their indicators."""
WHATIF = "whatif.json"
"""File of futures of a run: what ``--json`` prints, and their folders."""
LONGEST = 100
"""Characters of a folder's name."""


def run_folder(name: str, overrides: Sequence[str] = ()) -> Path:
    """The folder of a run, named by what was run and what was changed of it.

    Args:
        name: Scenario as asked for; of a file its name without the ending.
        overrides: ``KEY=VALUE`` each; of a key the last two parts are enough to tell runs apart.
    """
    changed = dict(text.partition("=")[::2] for text in overrides)
    settings = [f"{short_key(key)}={value}" for key, value in changed.items()]
    return ROOT / slug("-".join((Path(name).stem, *settings)))


def short_key(key: str) -> str:
    """The last two parts of a dotted key; of a kind, what it is the kind of."""
    return ".".join(key.strip().removesuffix(".kind").split(".")[-2:])


def slug(text: str) -> str:
    """A text as the name of a folder; one that loses more than brackets ends in a hash of it."""
    bare = re.sub(r"\s+", "-", re.sub(r"[\"'\[\]{}]|(?<=,)\s+", "", text))
    name = re.sub(r"[^\w.,=+~-]", "_", bare).lstrip("-.")
    if name == bare and len(name) <= LONGEST:
        return name
    mark = hashlib.sha256(text.encode()).hexdigest()[:6]
    return f"{name[: LONGEST - 7]}-{mark}"


def free(folder: Path) -> Path:
    """The folder, or, if a run is in it, the next of its name that is free."""
    number, found = 1, folder
    while record_in(found).exists():
        number += 1
        found = folder.with_name(f"{folder.name}~{number}")
    return found


def numbered(name: str, taken: Iterable[str]) -> str:
    """A name, or, if others have it already, with its number among them behind it."""
    others = sum(other.partition("~")[0] == name for other in taken)
    return f"{name}~{others + 1}" if others else name


def former(folder: Path) -> str:
    """What a new run in a folder replaces, in words; empty if there is none."""
    file = record_in(folder)
    if not file.exists():
        return ""
    return f" (replaced the run of {datetime.fromtimestamp(file.stat().st_mtime):%H:%M:%S, %d %b})"


def last(root: Path = ROOT) -> Path:
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


def forget(folder: Path, manifest: str = MANIFEST) -> str:
    """Remove the runs that a file of their folder lists, so that none of them stays behind.

    Only what those runs consist of, and the list, is removed.

    Returns:
        What a new comparison replaces, in words; empty if there is none.
    """
    inner = [folder / name for name in listed(folder, manifest)]
    for run in inner:
        for name in FILES:
            (run / name).unlink(missing_ok=True)
        with suppress(OSError):  # somebody else's files are in it
            run.rmdir()
    if not inner:
        return ""
    (folder / manifest).unlink()
    return f" (replaced a comparison of {len(inner)} runs)"


def listed(folder: Path, manifest: str = MANIFEST) -> dict[str, str]:
    """The folders that a file of their folder lists, in its order, and what each run is called."""
    try:
        found = parse_json((folder / manifest).read_bytes())
        inner = [Path(str(name)).name for name in found["folders"]]
        return dict(zip(inner, map(str, found.get("names", inner)), strict=True))
    except (OSError, DataError, KeyError, TypeError, ValueError, AttributeError):
        return {}


def is_last(path: Path) -> bool:
    """Whether a path is the word that stands for the newest run."""
    return path == Path(LAST) and not path.exists()


def record_of(path: Path) -> Path:
    """The file of a run or log: of a run folder its record, of ``last`` that of the newest run.

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
        raise RecordError(f"{path}: holds {len(inner)} runs; give one of them, as in {inner[0]}")
    return record_in(path)


def record_in(folder: Path) -> Path:
    """The record of a run folder, or, of a run that was killed, its stream."""
    whole, streamed = folder / "run.parquet", folder / STREAM
    return streamed if streamed.exists() and not whole.exists() else whole


def is_record(file: Path) -> bool:
    """Whether a file is the record of its folder."""
    return file.name in ("run.parquet", STREAM)


def run_name(path: Path) -> str:
    """What a run or log is called: a record by its folder, any other file by its own name."""
    file = record_of(path)
    return file.resolve().parent.name if is_record(file) else file.stem


def run_folders(folder: Path) -> list[Path]:
    """The run folders that a folder is or holds, those that were made together in their order."""
    order = [*listed(folder), *listed(folder, WHATIF)]
    found = sorted(file.parent for file in _records(folder))
    return sorted(found, key=lambda run: order.index(run.name) if run.name in order else len(order))


def _records(folder: Path) -> Iterator[Path]:
    own = record_in(folder)
    if own.exists():
        yield own
    else:
        yield from filter(Path.exists, map(record_in, folder.glob("*/")))


IGNORED = {".png", ".json", ".html", ".pdf", ".tex", ".rrd", ".svg", ".md"}
"""Endings of files that lie beside runs, as a pattern finds them."""


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


def sorted_out(arguments: Sequence[str]) -> Sources:
    """Which arguments are scenarios, which finished runs, and which logs.

    A name of a shipped scenario stands for it; a folder or file of that name is ``./NAME``. Folders
    without a run are passed over where there is anything else, as are the files a pattern finds.
    """
    known = shipped()
    scenarios, runs, logs = [], [], []
    for text in arguments:
        path = Path(text)
        if text in known or not (path.exists() or is_last(path) or path.suffix in OURS):
            scenarios.append(text)
        elif path.suffix == ".csv":
            logs.append(path)
        elif is_last(path) or path.suffix in OURS or (path.is_dir() and run_folders(path)):
            runs.append(path)
        elif not path.is_dir() and path.suffix not in IGNORED:
            scenarios.append(text)
    if not (scenarios or runs or logs):
        return Sources((), tuple(map(Path, arguments)), ())
    return Sources(tuple(scenarios), tuple(runs), tuple(logs))


def log_file(path: Path) -> Path:
    """The file of a recorded run or log.

    Raises:
        TwinError: If there is none.
    """
    check_no_scenario(path)
    file = record_of(path)
    if not file.is_file():
        raise LogError(f"log {file}: not found; give a run.parquet, its folder, or a CSV file")
    return file


def check_no_scenario(path: Path) -> None:
    """Make sure that what is to be opened is not a scenario, or the run of one that was not made.

    Raises:
        RecordError: If it is.
    """
    name = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
    if name.as_posix() in shipped() and not path.exists():
        what = "is a scenario, not a run" if name == path else "is not there yet"
        raise RecordError(f"{path} {what}; first: ballplate run {name}, then open runs/{name.name}")


OURS = {".csv", ".parquet", ".arrows"}
"""Endings that no scenario has."""
