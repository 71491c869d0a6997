"""Replays the recorded commands of an entry of the public benchmark as a law."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from zipfile import ZipFile

import numpy as np

from controllers import catalog
from controllers.arrays import Array
from controllers.interfaces import Feedback, Law, Reference
from twin.base.data_file import check_regular
from twin.scenario.schema import ControllerChoice

MAX_COMMANDS_BYTES = 1 << 30
"""Sum of the commands of an entry, unpacked."""


@dataclass(frozen=True, kw_only=True)
class RecordedCommands(Law):
    """The recorded commands of a run; ``register_commands`` makes a class for those of an entry."""

    number: int = 0
    """Index of the run."""

    @abstractmethod
    def recorded(self) -> Array:
        """Plate accelerations of the run in rad/s^2, shape (ticks, 2)."""

    def start(self, x: Array, reference: Reference, period: float) -> float:
        """The control period."""
        return period

    def command(self, now: Feedback) -> Array:
        """The recorded command at this time, shape (..., 2)."""
        u = self.recorded()  # as long as the longest run of its batch
        return np.broadcast_to(u[min(round(now.time / now.plan), len(u) - 1)], now.rate.shape)


@contextmanager
def register_commands(commands: Sequence[Array]) -> Iterator[str]:
    """A law in the catalog that gives recorded commands; its name there.

    Args:
        commands: Plate accelerations in rad/s^2 of each run, shape (ticks, 2).
    """

    class OfEntry(RecordedCommands):
        name: ClassVar[str] = "replayed"

        def recorded(self) -> Array:
            return commands[self.number]

    catalog.register(OfEntry)
    try:
        yield OfEntry.name
    finally:
        catalog.unregister(OfEntry.name)


def replay_of(name: str, number: int) -> ControllerChoice:
    """The controller that replays the run of an index."""
    return ControllerChoice.model_validate({"kind": name, "number": number})


def commands_of(folder: Path) -> list[Array]:
    """The commands in a finished entry's folder, run by run, each of shape (ticks, 2), rad/s^2.

    Raises:
        TwinError: If the file may not be opened, or is too large.
        OSError: If it cannot be read.
        ValueError: If it has something else than numbers.
        BadZipFile: If it is not a file of numpy.
    """
    file = folder / "commands.npz"
    check_regular(file.lstat())
    with ZipFile(file) as packed:
        if sum(each.file_size for each in packed.infolist()) > MAX_COMMANDS_BYTES:
            raise ValueError(f"commands.npz unpacks to more than {MAX_COMMANDS_BYTES >> 20} MB")
    with np.load(file) as commands:
        return [np.asarray(commands[f"arr_{i}"], float) for i in range(len(commands.files))]
