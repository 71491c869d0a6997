"""The grader's side of an answer: a law like any other, worked out in a process of its own."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from select import select
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any, ClassVar

import numpy as np

from controllers import catalog
from controllers.arrays import Array
from controllers.controller import PerRigReference, SampledReference
from controllers.interfaces import Feedback, Law, Reference
from twin.data_file import DataError, parse_json
from twin.errors import LawError, ScenarioError
from twin.lab.schema import AnswerTable

START = 20.0
"""Seconds in which the process must be there, whatever else the machine does."""
LARGEST = 1e6
"""Largest number in an answer: plate accelerations in rad/s^2 and rates of a law's memory."""
LONGEST = 1 << 24
"""Bytes of a line that it says."""
MOST_MEMORY = 1000
"""Integrator states that a law may have."""
NAME = "answer"
"""What a scenario calls the law of an answer."""
STRANGE = "it said something else than an answer"


@dataclass
class AnswerProcess:
    """A process that has an answer, and may do little else.

    It is asked by pickles, of the grader's own making, and says lines of JSON, which can do nothing
    here but be read.

    Attributes:
        process: The process.
        prints: File of what it prints.
        name: What the answer's file is called.
        seconds: Wall time in s that it may take.
        left: What of that is left, s.
        failure: Why it ended, in one line.
        slope: The last time in s of a command, and the rate of the law's memory then.
    """

    process: subprocess.Popen[bytes]
    prints: Path
    name: str
    seconds: float
    left: float
    failure: str | None = None
    slope: tuple[float, Array] = (np.nan, np.zeros(0))

    def ask(self, what: str, like: Array, *given: Any) -> Array:
        """Ask something and have its answer, of the shape of an array.

        Raises:
            LawError: If it fails, is too late, says something else, or a number is none or too
                large.
        """
        if self.failure is not None:
            raise LawError(self.failure)
        assert self.process.stdin is not None
        with suppress(OSError):  # it has ended: what it said last is still to be read
            os.write(self.process.stdin.fileno(), pickle.dumps((what, *given)))
        said = self.said()
        try:
            got = np.array(said["answer"], float).reshape(like.shape)
        except (LookupError, TypeError, ValueError):
            raise self.failed(STRANGE) from None
        largest = np.abs(got).max(initial=0.0)
        if not largest < LARGEST:
            what = f"is {largest:.3g}" if np.isfinite(largest) else "is not finite"
            raise self.failed(f"a number that it gives {what}; at most {LARGEST:.0e} is allowed")
        return got

    def said(self) -> dict[str, Any]:
        """What it says next; errors as of ``ask``."""
        assert self.process.stdout is not None
        line, pipe = b"", self.process.stdout.fileno()
        while not line.endswith(b"\n") and len(line) < LONGEST:
            begin = monotonic()
            if not select([pipe], [], [], max(self.left, 0.0))[0]:
                raise self.failed(f"it took longer than {self.seconds:g} s")
            self.left -= monotonic() - begin
            if not (part := os.read(pipe, 1 << 16)):
                raise self.failed(f"its process ended by itself ({self.process.wait()})")
            line += part
        try:
            said = parse_json(line)
        except DataError:
            said = None
        if not isinstance(said, dict):
            raise self.failed(STRANGE)
        if "error" in said:
            self.failure = str(said["error"]).encode("utf-8", "replace").decode()
            raise LawError(self.failure)
        return said

    def printed(self) -> list[str]:
        """The last lines that the answer printed."""
        text = self.prints.read_text(encoding="utf-8", errors="replace")
        return [line[:200] for line in text.splitlines()[-5:]]

    def failed(self, why: str) -> LawError:
        """The error that it did not give what it must; it is asked nothing more."""
        self.failure = f"{self.name}: {why}"
        return LawError(self.failure)


class AnswerLaw(Law):
    """The law of an answer; a subclass is made for each.

    Attributes:
        process: Has it.
    """

    process: ClassVar[AnswerProcess]

    def start(self, x: Array, reference: Reference, period: float) -> None:
        """Begin a run there."""
        self.process.ask("start", np.zeros(0), self.model, x, sent(reference), period)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2); the memory's rate comes with them."""
        both = np.concatenate([now.rate, now.memory], axis=-1)
        both = self.process.ask("command", both, *now[:6], now.memory)
        self.process.slope = now.time, both[..., 2:]
        return both[..., :2]

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, shape (..., memory), as it came with the command of t."""
        if self.process.slope[0] == t:
            return self.process.slope[1]
        return self.process.ask("memory_rate", q, t, x, q)  # between two commands


def sent(reference: Reference) -> tuple[Any, ...]:
    """What a reference is made of, to be made again in another process."""
    match reference:
        case PerRigReference():
            return PerRigReference, reference.members, reference._period
        case SampledReference():
            return SampledReference, reference.original, reference._period
    raise ScenarioError("a lab's rigs must have one law: their designer knows different balls")


@contextmanager
def answering(file: Path, about: AnswerTable) -> Iterator[AnswerProcess]:
    """Have an answer's law in the catalog, called ``answer``, within the context.

    Args:
        file: The answer.
        about: What it is.

    Raises:
        LawError: If it cannot be loaded: its file, its line, the error.
        ScenarioError: If the system cannot keep a process within limits.
    """
    if sys.platform == "win32":
        raise ScenarioError("answers in Python are judged on Linux or macOS: no limits here")
    from twin.lab import child  # noqa: PLC0415  not on Windows

    with TemporaryDirectory(prefix="ballplate-answer-") as folder:
        here = Path(folder).resolve()
        own, prints = here / about.file, here / "printed.txt"
        shutil.copyfile(file, own)
        with prints.open("ab") as to:
            begun = subprocess.Popen(
                [sys.executable, "-I", "-u", child.__file__, own, str(int(about.seconds) + 5)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=to,
                cwd=here,
                env={"OPENBLAS_NUM_THREADS": "1", "HOME": folder, "LANG": "C.UTF-8"},
                start_new_session=True,
            )
        process = AnswerProcess(begun, prints, about.file, about.seconds, about.seconds + START)
        try:
            said = process.said()
            process.left = about.seconds
            try:
                memory, needs = (
                    min(int(said["memory"]), MOST_MEMORY),
                    tuple(map(str, said["needs"])),
                )
            except (LookupError, TypeError, ValueError, OverflowError):
                raise process.failed(STRANGE) from None
            law = {"name": NAME, "process": process, "memory": memory, "needs": needs}
            catalog.register(type("Answer", (AnswerLaw,), law | {"__module__": __name__}))
            yield process
        finally:
            catalog._registered.pop(NAME, None)
            catalog._all_classes.cache_clear()
            with suppress(OSError):  # it has ended, and all that it may have begun
                os.killpg(begun.pid, signal.SIGKILL)
            begun.communicate()
