"""Reads TOML and JSON that somebody else wrote: within limits, so that the answer comes at once."""

from __future__ import annotations

import json
import os
import stat
import tomllib
from datetime import date, time
from importlib.resources import files
from pathlib import Path
from typing import Any

from twin.base.errors import ScenarioError, TwinError

MAX_NESTING = 32
"""Levels of nesting."""
INTEGER_RANGE = (-(2**63), 2**63 - 1)
"""Smallest and largest integer, as TOML promises them."""

MAX_REGULAR_BYTES = 4 * 1024**2
"""Length of a file that a stranger handed in."""

_TOO_LARGE = "an integer beyond 64 bit"


class DataError(TwinError, ValueError):
    """A file or text has a wrong form; the message names no source: the caller adds it."""


def read_regular(path: Path, largest: int = MAX_REGULAR_BYTES) -> bytes:
    """The bytes of a file that a stranger handed in; no link is followed, nothing is waited for.

    Args:
        path: The file.
        largest: Length in bytes that it may have.

    Raises:
        DataError: If it is not a regular file with one name, is too large or cannot be read.
    """
    how = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        check_regular(path.lstat())
        with open(os.open(path, how | getattr(os, "O_BINARY", 0)), "rb") as file:  # noqa: PTH123
            check_regular(os.fstat(file.fileno()))  # as it was opened
            content = file.read(largest + 1)
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}") from error
    if len(content) > largest:
        raise DataError(f"is larger than {largest // 1024} kB")
    return content


def check_regular(about: os.stat_result) -> None:
    """Make sure that a file, by its state as of ``lstat``, is one that may be opened.

    Raises:
        DataError: If it is a link, a pipe, a device, or has a second name elsewhere.
    """
    if stat.S_ISLNK(about.st_mode):
        raise DataError("is a link; hand in the file itself")
    if not stat.S_ISREG(about.st_mode):
        raise DataError("is not a regular file")
    if about.st_nlink > 1:
        raise DataError("has a second name elsewhere (a hard link); hand in a copy")


def read_toml(path: Path, *, regular: bool = False) -> dict[str, Any]:
    """The tables of a TOML file.

    Args:
        path: The file.
        regular: Whether it must be a file as ``read_regular`` reads it.

    Raises:
        DataError: If it cannot be read, is not TOML, or goes beyond a limit of this module.
    """
    if "\0" in str(path):
        raise DataError("cannot be read: a NUL in its name")
    try:
        if regular:
            return parse_toml(read_regular(path).decode("utf-8-sig"))
        return parse_toml(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"not a TOML file: {error}") from error
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}") from error


def read_tables(path: Path, called: str = "", *, regular: bool = False) -> dict[str, Any]:
    """The tables of a TOML file.

    Args:
        path: The file.
        called: What a message calls it; its name by default.
        regular: Whether it is a stranger's, as of ``read_regular``.

    Raises:
        ScenarioError: If it cannot be read.
    """
    try:
        return read_toml(path, regular=regular)
    except DataError as error:
        raise ScenarioError(f"{called or path.name}: {error}") from error


def read_packaged(package: str, name: str) -> dict[str, Any]:
    """The tables of a TOML file in the folder of a package.

    Args:
        package: Its full name.
        name: Of the file.
    """
    return tomllib.loads((files(package) / name).read_text(encoding="utf-8"))


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a text in TOML.

    Raises:
        tomllib.TOMLDecodeError: If it is not TOML.
        DataError: If it goes beyond a limit of this module.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise DataError(f"nested deeper than {MAX_NESTING} levels") from None
    except ValueError:  # Python refuses to convert thousands of digits
        raise DataError(_TOO_LARGE) from None
    _check(tables)
    return tables


def parse_json(text: str | bytes) -> Any:
    """Parse a text in JSON.

    Raises:
        DataError: If it is not JSON, or goes beyond a limit of this module.
    """
    try:
        data = json.loads(text)
    except RecursionError:
        raise DataError(f"nested deeper than {MAX_NESTING} levels") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"not JSON: {error}") from None
    except ValueError:  # as for TOML
        raise DataError(_TOO_LARGE) from None
    _check(data)
    return data


def _check(value: Any, level: int = 0) -> None:
    """Refuse what is nested too deep, a date, and an integer that is too large."""
    if level > MAX_NESTING:
        raise DataError(f"nested deeper than {MAX_NESTING} levels")
    if isinstance(value, dict):
        for inner in value.values():
            _check(inner, level + 1)
    elif isinstance(value, list):
        for inner in value:
            _check(inner, level + 1)
    elif isinstance(value, date | time):
        raise DataError(f"{value} is a date or a time; a text stands in quotes")
    elif isinstance(value, int) and not INTEGER_RANGE[0] <= value <= INTEGER_RANGE[1]:
        raise DataError(_TOO_LARGE)
