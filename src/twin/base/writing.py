"""Writing results: whether it can be done, and whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
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
    _probe(folder, f"{option} {folder}")
    return folder


def _probe(folder: Path, where: str) -> None:
    """Make and remove a file in a folder, and the folder if it does not exist.

    Raises:
        ScenarioError: If that fails; it begins with ``where``.
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
        raise ScenarioError(f"{where}: cannot be written: {why(error)}") from error


def check_writable_file(file: Path, option: str = "--out") -> Path:
    """Check before the work that a file can be written; arguments as of ``check_writable``.

    Returns:
        The file.

    Raises:
        ScenarioError: If it is a folder, or its folder cannot be made or written.
    """
    if file.is_dir():
        raise ScenarioError(f"{option} {file}: is a folder; give a file")
    check_writable_beside(file, option)
    return file


def check_writable_beside(path: Path, option: str) -> None:
    """Check before the work that a file or folder of a name can be made in its folder.

    Raises:
        ScenarioError: If it has no name, or its folder cannot be made or written.
    """
    if not path.name:
        raise ScenarioError(f"{option}: names no file")
    _probe(path.parent, f"{option} {path}")


@contextmanager
def written_alone(folder: Path, option: str = "--out") -> Iterator[None]:
    """Make sure that no other process writes into a folder within the context.

    It locks a hidden file next to the folder by a lock of the system, which ends with the process
    that holds it. Systems without such locks have no check.

    Raises:
        ScenarioError: If a second process does, or the file cannot be made.
    """
    try:
        import fcntl  # noqa: PLC0415  not on Windows
    except ImportError:
        yield
        return
    name = lock_file(folder)
    above = [each for each in name.parents if not each.exists()]
    try:
        number = _lock(name, fcntl.LOCK_EX | fcntl.LOCK_NB, fcntl.flock)
    except BlockingIOError:
        raise ScenarioError(
            f"{option} {folder}: another run is writing there; give another folder"
        ) from None
    except OSError as error:
        raise ScenarioError(f"{option} {folder}: cannot be locked: {why(error)}") from error
    try:
        yield
    finally:
        name.unlink(missing_ok=True)
        os.close(number)
        with suppress(OSError):  # something has been written there
            for each in above:
                each.rmdir()


def lock_file(folder: Path) -> Path:
    """The file that is locked while a folder is written.

    It lies next to the folder; inside it if the folder is a root, or its parent cannot be written.
    """
    place = folder.resolve()
    above = next(each for each in place.parents or (place,) if each.exists())
    if place.parent == place or (place.is_dir() and not os.access(above, os.W_OK)):
        return place / ".lock"
    inner = place.name if len(os.fsencode(place.name)) <= MAX_FOLDER_NAME_BYTES else None
    mark = inner or hashlib.sha256(os.fsencode(place.name)).hexdigest()
    return place.with_name(f".{mark}.lock")


MAX_FOLDER_NAME_BYTES = 200
"""Bytes of a folder's name to which others can be added: file systems allow 255."""


def _lock(name: Path, how: int, lock: Callable[[int, int], object]) -> int:
    """Descriptor of a locked file that is still there: who held it before may just remove it."""
    while True:
        name.parent.mkdir(parents=True, exist_ok=True)
        number = os.open(name, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            lock(number, how)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(number), name.stat()):
                    return number
        except BaseException:
            os.close(number)
            raise
        os.close(number)


def write_whole(path: Path, content: str | bytes | Callable[[Path], object]) -> None:
    """Fill a temporary file next to ``path`` and rename it: a whole file or none.

    Args:
        path: The file; its folder is made if missing.
        content: Its content, or a function that writes the content into a file.

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
    """Let ``fill`` fill a temporary folder next to ``path`` and rename it: a whole folder or none.

    Raises:
        RecordError: If there is something of that name, or the folder cannot be written.
    """
    if path.exists():
        raise RecordError(f"{path}: exists; give a new folder")
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
