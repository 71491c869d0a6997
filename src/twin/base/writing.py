"""Writing results: whether it can be done, and whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from twin.base.errors import RecordError, ScenarioError


def check_writable(folder: Path, option: str = "--out") -> Path:
    """Check before the work that the results can be written; nothing is left of the check.

    Args:
        folder: Where they go; it need not exist.
        option: The option that named it.

    Returns:
        The folder.

    Raises:
        ScenarioError: If the folder cannot be made or written.
    """
    above = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
        for each in above:
            each.rmdir()
    except OSError as error:
        raise ScenarioError(f"{option} {folder}: cannot be written: {why(error)}") from error
    return folder


@contextmanager
def written_alone(folder: Path, option: str = "--out") -> Iterator[None]:
    """Make sure that no other process writes into a folder within the context.

    A lock of the system, gone with the process that holds it; where there are none, nothing.

    Raises:
        ScenarioError: If another process does.
    """
    try:
        import fcntl  # noqa: PLC0415  not on Windows
    except ImportError:
        yield
        return
    mark = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:24]
    name = Path(tempfile.gettempdir()) / f"ballplate-{os.getuid()}-{mark}.lock"
    with name.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ScenarioError(
                f"{option} {folder}: another run is writing there; name another folder"
            ) from None
        try:
            yield
        finally:
            name.unlink(missing_ok=True)


def write_whole(path: Path, content: str | bytes | Callable[[Path], object]) -> None:
    """Fill a temporary file beside ``path`` and rename it: a whole file or none.

    Args:
        path: The file; its folder is made if missing.
        content: What it holds, or what writes that into a file.

    Raises:
        RecordError: If the folder cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        temporary = Path(name)
        temporary.chmod(0o644)
        try:
            if callable(content):
                content(temporary)
            else:
                temporary.write_bytes(content.encode() if isinstance(content, str) else content)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise RecordError(f"cannot write {path}: {why(error)}") from error


def write_folder(path: Path, fill: Callable[[Path], object]) -> None:
    """Let ``fill`` fill a temporary folder beside ``path`` and rename it: a whole folder or none.

    Raises:
        RecordError: If there is something of that name, or the folder cannot be written.
    """
    if path.exists():
        raise RecordError(f"{path}: exists; name a new folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.stem}-", dir=path.parent) as name:
            inner = Path(name) / path.name
            inner.mkdir()
            fill(inner)
            inner.replace(path)
    except OSError as error:
        raise RecordError(f"cannot write {path}: {why(error)}") from error


def remove(path: Path) -> None:
    """Remove a file that may be there.

    Raises:
        RecordError: If it cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise RecordError(f"cannot replace {path}: {why(error)}") from error


def why(error: Exception) -> str:
    """Why a file cannot be read or written, in words."""
    if isinstance(error, FileExistsError | NotADirectoryError):
        return "a file is where a folder should be"
    return getattr(error, "strerror", None) or str(error)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file whole.

    Raises:
        RecordError: If the folder cannot be written.
    """
    write_whole(path, json.dumps(content, indent=2) + "\n")
