"""Readers of traces in packed bytes that python-can reads."""

from __future__ import annotations

import gzip
import importlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, BinaryIO

from twin.base.finalisers import quiet_finalisers
from twin.devices.akd.trace_files.frames import Notes, TracedFrame, classic_frame

if TYPE_CHECKING:
    import can


FIRST_BLF_CHANNEL = 1
"""The first channel of a .blf file; python-can counts from 0 and takes 1 off when it reads one."""


def read_blf(raw: BinaryIO, file: Path, notes: Notes) -> Iterator[TracedFrame | None]:
    """Reader of packed files of Vector's tools (.blf)."""
    import can  # noqa: PLC0415  takes 0.2 s

    number = 0
    with can.BLFReader(raw) as reader:
        for number, message in enumerate(reader, 1):  # noqa: B007
            yield _of_message(message, FIRST_BLF_CHANNEL)
        if file.suffix.lower() != ".gz" and reader.file_size > file.stat().st_size:
            notes.remarks.append(
                f"cut off, ends after frame {number}"
            )  # the head gives the full size


def read_database(raw: BinaryIO, file: Path, notes: Notes) -> Iterator[TracedFrame | None]:
    """Reader of databases of python-can (.db)."""
    import can  # noqa: PLC0415  takes 0.2 s

    notes.remarks.append(
        "python-can's writer of .db drops the frames that wait when it is stopped: the last frames "
        "of the bus may be missing"
    )
    with _unpack(raw, file) as plain, can.SqliteReader(plain) as reader:
        yield from map(_of_message, reader)


def read_mf4(raw: BinaryIO, file: Path, _: Notes) -> Iterator[TracedFrame | None]:
    """Measurement files (.mf4), where asammdf is installed.

    If asammdf was imported first, it imported python-can, which then took it for missing.
    """
    from can.io import mf4  # noqa: PLC0415  takes 0.2 s

    if getattr(mf4, "asammdf", None) is None:
        importlib.reload(mf4)
    found, problem = list[TracedFrame | None](), ""
    try:
        with quiet_finalisers(), _unpack(raw, file) as plain, mf4.MF4Reader(plain) as reader:
            found.extend(map(_of_message, reader))
    except ValueError as error:
        problem = str(error)
    yield from found
    if problem:
        raise ValueError(problem)


def _of_message(message: can.Message, first_channel: int = 0) -> TracedFrame | None:
    """The classic frame that python-can read; None for one of CAN FD.

    Args:
        message: As it was read.
        first_channel: Number in the file of the channel that python-can calls 0.
    """
    channel = message.channel
    if isinstance(channel, int):
        channel += first_channel
    if message.is_fd or len(message.data) > message.dlc:
        return None
    return classic_frame(
        message.timestamp,
        message.arbitration_id,
        bytes(message.data),
        extended=message.is_extended_id,
        remote=message.dlc if message.is_remote_frame else None,
        error=message.is_error_frame,
        sent=not message.is_rx,
        channel=None if channel is None else str(channel),
    )


@contextmanager
def _unpack(raw: BinaryIO, file: Path) -> Iterator[Path]:
    """A file for readers that open it themselves; of one packed by gzip, a copy of its content."""
    if not isinstance(raw, gzip.GzipFile):
        yield file
        return
    with TemporaryDirectory() as folder:
        plain = Path(folder) / file.stem
        with plain.open("wb") as copy:
            shutil.copyfileobj(raw, copy)
        yield plain
