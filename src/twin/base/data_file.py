"""Reads TOML and JSON that somebody else wrote: within limits, so that the answer comes at once."""

from __future__ import annotations

import json
import tomllib
from datetime import date, time
from importlib.resources import files
from pathlib import Path
from typing import Any

from twin.base.errors import TwinError

DEEPEST = 32
"""Levels of nesting."""
INTEGERS = (-(2**63), 2**63 - 1)
"""Smallest and largest integer, as TOML promises them."""

_TOO_LARGE = "an integer beyond 64 bit"


class DataError(TwinError, ValueError):
    """A file or text is not what it should be; the message names no source: the caller does."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        DataError: If it cannot be read, is not TOML, or goes beyond a limit of this module.
    """
    if "\0" in str(path):
        raise DataError("cannot be read: a NUL in its name")
    try:
        return parse_toml(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"not a TOML file: {error}") from error
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}") from error


def packaged(package: str, name: str) -> dict[str, Any]:
    """The tables of a TOML file that lies beside the modules of a package.

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
        raise DataError(f"nested deeper than {DEEPEST} levels") from None
    except ValueError:  # Python refuses to convert thousands of digits
        raise DataError(_TOO_LARGE) from None
    _check(tables)
    return tables


def parse_json(text: str | bytes) -> Any:
    """What a text in JSON holds.

    Raises:
        DataError: If it is not JSON, or goes beyond a limit of this module.
    """
    try:
        data = json.loads(text)
    except RecursionError:
        raise DataError(f"nested deeper than {DEEPEST} levels") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"not JSON: {error}") from None
    except ValueError:  # as for TOML
        raise DataError(_TOO_LARGE) from None
    _check(data)
    return data


def _check(value: Any, level: int = 0) -> None:
    """Refuse what is nested too deep, a date, and an integer that is too large."""
    if level > DEEPEST:
        raise DataError(f"nested deeper than {DEEPEST} levels")
    if isinstance(value, dict):
        for inner in value.values():
            _check(inner, level + 1)
    elif isinstance(value, list):
        for inner in value:
            _check(inner, level + 1)
    elif isinstance(value, date | time):
        raise DataError(f"{value} is a date or a time; a text stands in quotes")
    elif isinstance(value, int) and not INTEGERS[0] <= value <= INTEGERS[1]:
        raise DataError(_TOO_LARGE)
