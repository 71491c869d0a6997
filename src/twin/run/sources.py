"""What a command is given to look at: scenarios to run, finished runs, logs of a rig."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from twin.errors import LogError, RecordError
from twin.run.folders import is_last, record_of, run_folders
from twin.shipped import shipped

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
    """Make sure that what is to be opened is not the name of a scenario.

    Raises:
        RecordError: If it is.
    """
    if path.as_posix() in shipped() and not path.exists():
        raise RecordError(
            f"{path} is a scenario, not a run; first: ballplate run {path}, then open "
            f"runs/{path.name}"
        )


OURS = {".csv", ".parquet", ".arrows"}
"""Endings that no scenario has."""
