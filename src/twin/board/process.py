"""The process of a program that has the controller: asked once a period, ended with its run."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import IO, Any
from weakref import finalize

import numpy as np

from controllers.arrays import Array
from controllers.catalog import AnswerError
from controllers.fmu import keep_up
from twin.base.errors import ScenarioError, plural, shorten
from twin.board.program import command_of
from twin.board.protocol import (
    ANSWER_LENGTH,
    HELLO_LENGTH,
    MAX_FRAME_NUMBER,
    PROTOCOL_VERSION,
    Answer,
    FrameError,
    decode,
    encode,
)

START_TIMEOUT_S = 10.0
"""Seconds in which the program must say its first frame."""
ENDS_WITHIN_S = 1.0
"""Seconds after which a silent process has ended."""


class BoardProcess:
    """A program that has the controller, on an emulated processor or this computer.

    Args:
        program: Its file: an ``.elf`` is run by the emulator.
        called: What messages call it.
        period: Control period in s, for which it must be made.
        time_limit: Longest time in s that it may take for an answer.

    Raises:
        ScenarioError: If the file or the emulator is not there.
        AnswerError: If the program does not begin as one that speaks the protocol.
    """

    def __init__(self, program: Path, called: str, period: float, time_limit: float) -> None:
        self._called, self._limit = called, time_limit
        command = command_of(program)
        self._complaints: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  it lives as long
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._complaints
            )
        except OSError as error:
            self._complaints.close()
            raise ScenarioError(f"{called}: cannot be run: {error.strerror or error}") from error
        self._said: SimpleQueue[bytes] = SimpleQueue()
        heard = self._process.stdout, self._said
        self._reader = Thread(target=_read, args=heard, daemon=True)
        self._reader.start()
        self._number = 0
        finalize(self, _end, self._process, self._complaints)
        version, own = self._hear(0, HELLO_LENGTH, START_TIMEOUT_S).tolist()
        if version != PROTOCOL_VERSION:
            raise self._failed(
                f"speaks version {version:g} of the protocol, which is {PROTOCOL_VERSION}"
            )
        if not abs(own - period) <= 1e-6 * period:
            raise self._failed(f"is made for a period of {own:g} s; rig.period is {period:g} s")

    def ask(self, measured: Sequence[float] | Array) -> Answer:
        """The answer to a measurement, shape (17,), as the protocol has it.

        Raises:
            AnswerError: If there is none within the time, or it is none: why, in one line.
        """
        assert self._process.stdin is not None
        self._number = self._number % MAX_FRAME_NUMBER + 1
        if self._number == 1:
            keep_up(self._process, self._reader)
        with suppress(OSError):  # it has ended: its last message is still to be read
            self._process.stdin.write(encode(self._number, measured))
            self._process.stdin.flush()
        try:
            return Answer.of(self._hear(self._number, ANSWER_LENGTH, self._limit))
        except FrameError as error:
            raise self._failed(f"{error}, at {measured[0]:g} s") from error

    def saved_state(self) -> None:
        """None: what a program has within stays there."""

    def restore_state(self, state: None) -> None:
        """Refuse: a program begins at its beginning.

        Raises:
            ValueError: Always.
        """
        raise ValueError(f"{self._called} cannot be put back into a state")

    def _hear(self, number: int, count: int, seconds: float) -> Array:
        """The content of the frame that is due, shape (count,)."""
        heard, until = b"", time.monotonic() + seconds
        while True:
            try:
                more = self._said.get(timeout=max(0.0, until - time.monotonic()))
            except Empty:
                self._process.kill()
                part = f" but {plural(len(heard), 'byte')} of it" if heard else ""
                raise self._failed(f"gave no answer within {seconds:g} s{part}") from None
            if not more:
                raise self._failed(self._last_words())
            heard += more
            try:
                content = decode(heard, number, count)
            except FrameError as error:
                self._process.kill()
                raise self._failed(str(error)) from error
            if content is not None:
                return np.asarray(content)

    def _last_words(self) -> str:
        """How the process ended, and the first line of its complaint."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDS_WITHIN_S)
        self._complaints.seek(0)
        lines = self._complaints.read().decode(errors="replace").split("\n")
        why = next((shorten(line.strip()) for line in lines if line.strip()), "")
        code = self._process.returncode
        status = "" if code is None else f", exit status {code}"
        return f"its process ended{status}" + (f": {why}" if why else "")

    def _failed(self, why: str) -> AnswerError:
        return AnswerError(f"{self._called}: {why}")


def _read(pipe: Any, received: SimpleQueue[bytes]) -> None:
    """Read the output of a process until it ends, which is an empty text."""
    with pipe:
        while more := os.read(pipe.fileno(), 1 << 16):
            received.put(more)
    received.put(b"")


def _end(process: subprocess.Popen[bytes], complaints: IO[bytes]) -> None:
    complaints.close()
    process.kill()
    process.wait()
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.close()
