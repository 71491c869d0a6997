"""The shipped scenarios and models, found without importing what checks and runs them."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from difflib import get_close_matches
from functools import cache
from os.path import isdir, isfile  # False, no error, of a name that no file can have
from pathlib import Path

import controllers
from twin.base.data_file import DataError, read_toml
from twin.base.errors import ScenarioError, shorten, suggest, suggest_setting

OTHER_FOLDERS = {"studies", "fits", "families", "tunes", "labs", "starts", "rigs", "bench"}
"""Folders of files that are no scenarios."""


def folder() -> Path:
    """Folder of the shipped scenarios: next to the controllers, in a checkout and installed."""
    return Path(controllers.__file__).parent.parent / "scenarios"


def model_path(name: str = "ballplate.xml") -> Path:
    """Path of a file of ``models/``, installed (twin/models) or in the repository.

    The file itself need not exist; whoever opens it reports that.
    """
    package = Path(__file__).resolve().parents[1]
    installed = package / "models" / name
    return installed if installed.exists() else package.parents[1] / "models" / name


@cache
def shipped_scenarios() -> dict[str, Path]:
    """The shipped scenarios by name; those of a subfolder as ``folder/name``."""
    root = folder()
    return {
        path.relative_to(root).with_suffix("").as_posix(): path
        for path in sorted(root.rglob("*.toml"))
        if path.relative_to(root).parts[0] not in OTHER_FOLDERS
    }


def shipped_in(kind: str) -> dict[str, Path]:
    """The shipped files of a kind such as ``studies``, by name."""
    return {path.stem: path for path in sorted((folder() / kind).glob("*.toml"))}


def shipped_labs() -> dict[str, Path]:
    """The folders of the shipped labs by name."""
    return {path.parent.name: path.parent for path in sorted(folder().glob("labs/*/lab.toml"))}


def titles(files: Mapping[str, Path]) -> dict[str, str]:
    """The titles of files by name; of one that is no TOML file why."""
    found = {}
    for name, path in files.items():
        try:
            found[name] = str(read_toml(path).get("title", ""))
        except DataError as error:
            found[name] = f"(unreadable: {error})"
    return found


def find(name: str) -> Path:
    """The file of a scenario: a shipped one by its name, or any TOML file by its path.

    Raises:
        ScenarioError: If there is no such file.
    """
    return chosen("scenario", name, shipped_scenarios())


def chosen(what: str, name: str, known: Mapping[str, Path]) -> Path:
    """The file of a shipped name, or of a path.

    Args:
        what: Its name in the message.
        name: The name or path.
        known: The shipped files by name.

    Raises:
        ScenarioError: If there is no such file.
    """
    path = known.get(name) or Path(name)
    if not isfile(path):  # noqa: PTH113
        if what == "scenario" and (name == "last" or isfile(path / "run.parquet")):  # noqa: PTH113
            raise ScenarioError(
                f"'{shorten(name)}' is a run, not a scenario; to look at it: "
                f"ballplate report {shorten(name)}, or view, compare, export"
            )
        raise ScenarioError(f"{what} '{shorten(name)}': not found{_hint(what, name, known)}")
    return path


def _hint(what: str, name: str, known: Mapping[str, Path]) -> str:
    """The nearest name, the short ones, and the command that lists all."""
    if isdir(name):  # noqa: PTH112
        return f"; that is a folder, a {what} is a TOML file"
    if near := nearest_neighbour(Path(name)):
        return near
    if what == "scenario" and (setting := suggest_setting(name)):
        return setting
    every = f"; `ballplate {LISTING_COMMANDS[what]}` lists all" if what in LISTING_COMMANDS else ""
    meant = suggest(name, known)
    return f"{meant} (known: {', '.join(each for each in known if '/' not in each)}{every})"


MIN_FILE_LIKENESS = 0.7
"""Likeness of two names without suffix, as difflib has it, from which one may stand for the other:
names of runs share words, as excite and identify-excite (0.57) or excite and circle (0.5)."""
MIN_BEGINNING = 3
"""Number of letters from which a name may be the beginning of a longer one."""


def nearest_neighbour(path: Path) -> str:
    """A hint at what lies in the folder of a path and has the nearest name; empty without any."""
    if len(path.parts) < 2 or not isdir(path.parent):  # noqa: PTH112
        return ""
    there: list[str] = []
    with suppress(OSError):
        there = sorted(each.name for each in path.parent.iterdir() if each.name[0] != ".")
    longer = [each for each in there if each.startswith(path.name)]
    begun = longer if len(path.name) >= MIN_BEGINNING else []
    words = set(path.name.split("-"))
    with_more = [each for each in there if len(words) > 1 and words < set(each.split("-"))]
    stems = {Path(each).stem: each for each in there}
    like = get_close_matches(path.stem, stems, n=1, cutoff=MIN_FILE_LIKENESS)
    near = begun or with_more or [stems[stem] for stem in like]
    return f"; did you mean '{path.parent / near[0]}'?" if near else ""


LISTING_COMMANDS = {"scenario": "list", "study": "study"}
"""Word for a kind of file in the command that lists the shipped ones."""
