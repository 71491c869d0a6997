"""The grader's side of an answer: a law like any other, worked out in a process of its own."""

from __future__ import annotations

import json
import os
import pickle
import selectors
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any, ClassVar

import numpy as np

from controllers import catalog
from controllers.arrays import Array
from controllers.controller import PerRigReference, SampledReference
from controllers.interfaces import Feedback, Law, Reference
from twin.errors import LawError, ScenarioError
from twin.lab.schema import AnswerTable

START = 20.0
"""Seconds in which the process must be there, whatever else the machine does."""
LARGEST = 1e6
"""Largest number in an answer: plate accelerations in rad/s^2 and rates of a law's memory."""
MOST_MEMORY = 1000
"""Integrator states that a law may have."""
NAME = "answer"
"""What a scenario calls the law of an answer."""
STRANGE = "it said something else than an answer"


def check_user(user: str | None) -> None:
    """Make sure that a process can be given to a user.

    Raises:
        ScenarioError: If there is none of that name, or only root could.
    """
    if user is None:
        return
    try:
        with TemporaryDirectory() as folder:
            shutil.chown(folder, user)
        subprocess.run([sys.executable, "-I", "-c", "import twin"], user=user, cwd="/", check=True)
    except (LookupError, OSError, subprocess.SubprocessError) as error:
        raise ScenarioError(f"--user {user}: cannot be had: {error}") from None


class AnswerProcess:
    """A process that has an answer, and may do little else.

    Args:
        file: The answer.
        about: What it is.
        user: Whom the process belongs to, where another user than this one's can be had.

    Raises:
        LawError: If it cannot be loaded: its file, its line, the error.
        ScenarioError: If the system cannot keep a process within limits.
    """

    def __init__(self, file: Path, about: AnswerTable, user: str | None) -> None:
        if sys.platform == "win32":
            raise ScenarioError("answers in Python are judged on Linux or macOS: no limits here")
        from twin.lab import child  # noqa: PLC0415  not on Windows

        self._head, self._about = child.HEAD, about
        self.failure: str | None = None
        """Why it ended, in one line."""
        self.slope: tuple[float, Array] = (np.nan, np.zeros(0))
        """The last time in s of a command, and the rate of the law's memory then."""
        self._left = about.seconds + START
        self._folder = TemporaryDirectory(prefix="ballplate-answer-")
        here = Path(self._folder.name).resolve()
        shutil.copyfile(file, here / about.file)
        if user is not None:
            shutil.chown(here, user)
        given = [str(here / about.file), str(int(about.seconds) + 5)]
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-u", child.__file__, *given],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=here,
            env={"OPENBLAS_NUM_THREADS": "1", "HOME": str(here), "LANG": "C.UTF-8"},
            start_new_session=True,
            user=user,
        )
        assert self._process.stdin and self._process.stdout  # noqa: PT018
        self._to, self._from = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._printed = here / child.PRINTED
        self._ready = selectors.DefaultSelector()
        self._ready.register(self._from, selectors.EVENT_READ)

    def hello(self) -> Any:
        """What it says of itself once it is there."""
        try:
            said = json.loads(self._answer(b"h"))
        except json.JSONDecodeError:
            raise self._failed(STRANGE) from None
        self._left = self._about.seconds
        return said

    def close(self) -> None:
        """End it, and all that it may have begun."""
        with suppress(OSError):  # it has ended
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.communicate()
        self._ready.close()
        self._folder.cleanup()

    def printed(self) -> list[str]:
        """The last lines that the answer printed."""
        file = self._printed
        text = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
        return [line[:200] for line in text.splitlines()[-5:]]

    def ask(self, kind: bytes, content: bytes, expected: bytes = b"u") -> bytes:
        """Say something and have the answer.

        Raises:
            LawError: If it fails, is too late, or says something else.
        """
        if self.failure is not None:
            raise LawError(self.failure)
        with suppress(OSError):  # it has ended: what it said last is still to be read
            os.write(self._to, self._head.pack(kind, len(content)) + content)
        return self._answer(expected)

    def numbers(self, kind: bytes, content: bytes, sizes: Sequence[int]) -> list[Array]:
        """Say something and have rows of so many numbers.

        Raises:
            LawError: If it fails, or a number is none or too large.
        """
        got = np.frombuffer(bytearray(self.ask(kind, content)))
        if len(got) != sum(sizes):
            raise self._failed(STRANGE)
        largest = np.abs(got).max(initial=0.0)
        if not largest < LARGEST:
            what = f"is {largest:.3g}" if np.isfinite(largest) else "is not finite"
            raise self._failed(f"a number that it gives {what}; at most {LARGEST:.0e} is allowed")
        return np.split(got, np.cumsum(sizes)[:-1])

    def _answer(self, expected: bytes) -> bytes:
        kind, size = self._head.unpack(self._read(self._head.size))
        if kind not in (expected, b"e") or size > 1 << 24:
            raise self._failed(STRANGE)
        content = self._read(size)
        if kind == b"e":
            raise self._failed(content.decode("utf-8", "replace"), whole=True)
        return content

    def _read(self, size: int) -> bytes:
        content, longest = b"", f"{self._about.seconds:g} s"
        while len(content) < size:
            begin = monotonic()
            if not self._ready.select(max(self._left, 0.0)):
                raise self._failed(f"it took longer than {longest}")
            self._left -= monotonic() - begin
            content += (part := os.read(self._from, size - len(content)))
            if not part:
                raise self._failed(f"its process ended by itself ({self._process.wait()})")
        return content

    def _failed(self, why: str, *, whole: bool = False) -> LawError:
        self.failure = why if whole else f"{self._about.file}: {why}"
        return LawError(self.failure)


class AnswerLaw(Law):
    """The law of an answer; a subclass is made for each.

    Attributes:
        process: Has it.
    """

    process: ClassVar[AnswerProcess]

    def start(self, x: Array, reference: Reference, period: float) -> None:
        """Begin a run there."""
        lead = x.shape[:-1]
        shapes = [(*lead, size) for size in (8, 8, len(self.needs), 2, 2, self.memory)]
        own = {"model": self.model, "reference": sent(reference), "shapes": shapes}
        self.process.ask(b"s", pickle.dumps({**own, "x": x, "period": period}), b"k")

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        parts = (now.x, now.equivalent, now.needed, now.rate, now.requested, now.memory)
        content = np.concatenate([[now.time], *(each.ravel() for each in parts)]).tobytes()
        u, slope = self.process.numbers(b"c", content, (now.rate.size, now.memory.size))
        self.process.slope = now.time, slope.reshape(now.memory.shape)
        return u.reshape(now.rate.shape)

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, (..., memory), known from ``command`` of that time."""
        if self.process.slope[0] != t:  # in between, where its command is held
            rest = np.zeros(x[..., 0].size * (len(self.needs) + 4))
            content = np.concatenate([[t], x.ravel(), x.ravel(), rest, q.ravel()]).tobytes()
            _, slope = self.process.numbers(b"q", content, (x[..., :2].size, q.size))
            return slope.reshape(q.shape)
        return self.process.slope[1]


def sent(reference: Reference) -> tuple[Any, ...]:
    """What a reference is made of, to be made again in another process."""
    match reference:
        case PerRigReference():
            return PerRigReference, reference.members, reference._period
        case SampledReference():
            return SampledReference, reference.original, reference._period
    raise ScenarioError("a lab's rigs must have one law: their designer knows different balls")


@contextmanager
def answering(file: Path, about: AnswerTable, user: str | None) -> Iterator[AnswerProcess]:
    """Have an answer's law in the catalog, called ``answer``, within the context.

    Raises:
        LawError: If it cannot be loaded: its file, its line, the error.
    """
    process = AnswerProcess(file, about, user)
    try:
        said = process.hello()
        try:
            memory, needs = min(int(said["memory"]), MOST_MEMORY), tuple(map(str, said["needs"]))
        except (KeyError, TypeError, ValueError):
            raise LawError(f"{about.file}: {STRANGE}") from None
        own = {"name": NAME, "process": process, "memory": memory, "needs": needs}
        catalog.register(type("Answer", (AnswerLaw,), own | {"__module__": __name__}))
        yield process
    finally:
        catalog._registered.pop(NAME, None)
        catalog._all_classes.cache_clear()
        process.close()
