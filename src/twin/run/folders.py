"""Where runs are kept: folders named by what differs, the last one, and what was there before."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from twin.data_file import DataError, parse_json
from twin.errors import RecordError

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


def forget(folder: Path) -> str:
    """Remove the runs of the comparison that a folder holds.

    Returns:
        What a new one replaces, in words; empty if there is none.
    """
    count = forget_listed(folder, MANIFEST)
    return f" (replaced a comparison of {count} runs)" if count else ""


def forget_listed(folder: Path, manifest: str) -> int:
    """Remove the runs that a file of their folder lists, so that none of them stays behind.

    Only what those runs consist of, and the list, is removed.

    Returns:
        How many there were.
    """
    listed = folder / manifest
    try:
        names = parse_json(listed.read_bytes())["folders"]
        inner = [folder / Path(str(name)).name for name in names]
    except (OSError, DataError, KeyError, TypeError):
        return 0
    for run in inner:
        for name in FILES:
            (run / name).unlink(missing_ok=True)
        with suppress(OSError):  # somebody else's files are in it
            run.rmdir()
    listed.unlink()
    return len(inner)


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
    """The run folders that a folder is or holds."""
    return sorted(file.parent for file in _records(folder))


def _records(folder: Path) -> Iterator[Path]:
    own = record_in(folder)
    if own.exists():
        yield own
    else:
        yield from filter(Path.exists, map(record_in, folder.glob("*/")))
