"""The grader's side of an answer: a law or an observer like any other, worked out elsewhere."""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import selectors
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any, ClassVar, Self

import numpy as np

from controllers.arrays import Array
from controllers.controller import PerRigReference, SampledReference
from controllers.interfaces import (
    DelayedObserver,
    Feedback,
    Law,
    Measurement,
    Observer,
    Quantity,
    Reference,
)
from twin.errors import LawError, ScenarioError
from twin.lab import child
from twin.lab.schema import AnswerTable

START = 20.0
"""Seconds in which the process must be there, whatever else the machine does."""
LARGEST = 1e6
"""Largest number in an answer: plate accelerations in rad/s^2, states and gains in SI units."""
MOST_MEMORY = 1000
"""Integrator states that a law may have."""
NAME = "answer"
"""What a scenario calls the law or observer of an answer."""


class AnswerProcess:
    """A process that has an answer, and may do nothing else.

    Args:
        file: The answer.
        about: What it is.
        user: Whom the process belongs to, where another user than this one's can be had.

    Raises:
        LawError: If it cannot be loaded: its file, its line, the error.
    """

    def __init__(self, file: Path, about: AnswerTable, user: str | None = None) -> None:
        self.about = about
        self.failure: str | None = None
        """Why it ended, in one line."""
        self.slope: tuple[float, Array] = (np.nan, np.zeros(0))
        """Of a law: the last time in s at which it gave a command, and the rate of its memory."""
        self._left = about.seconds
        self._folder = TemporaryDirectory(prefix="ballplate-answer-")
        here = Path(self._folder.name).resolve()
        shutil.copyfile(file, here / about.file)
        if user is not None:
            shutil.chown(here, user)
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-I", "-u", child.__file__, here / about.file, about.kind),
                *(str(int(about.seconds) + 5), about.function),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=here,
            env={"OPENBLAS_NUM_THREADS": "1", "HOME": str(here), "LANG": "C.UTF-8"},
            start_new_session=True,
            user=user,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._ready = selectors.DefaultSelector()
        self._ready.register(self._from, selectors.EVENT_READ)
        try:
            self._left += START
            self.hello: Any = json.loads(self._answer(b"h"))
            self._left = about.seconds
        except json.JSONDecodeError:
            self.close()
            raise self._failed("it said something else than an answer") from None
        except LawError:
            self.close()
            raise

    def __enter__(self) -> Self:
        """Have the process."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.close()

    def close(self) -> None:
        """End it, and all that it may have begun."""
        try:
            os.killpg(self._process.pid, signal.SIGKILL)
        except (OSError, AttributeError):  # it has ended; not on Windows
            self._process.kill()
        self._process.communicate()
        self._ready.close()
        self._folder.cleanup()

    def printed(self) -> list[str]:
        """The last lines that the answer printed."""
        file = Path(self._folder.name) / child.PRINTED
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
            os.write(self._to, child.HEAD.pack(kind, len(content)) + content)
        return self._answer(expected)

    def numbers(
        self, kind: bytes, content: bytes, shapes: Sequence[tuple[int, ...]]
    ) -> list[Array]:
        """Say something and have arrays of some shapes.

        Raises:
            LawError: If it fails, or a number is none or too large.
        """
        got = self.ask(kind, content)
        sizes = [int(np.prod(shape)) for shape in shapes]
        if len(got) != 8 * sum(sizes):
            raise self._failed("it said something else than an answer")
        numbers = np.frombuffer(got)
        largest = np.abs(numbers).max(initial=0.0)
        if not largest < LARGEST:
            what = "is not finite" if not np.isfinite(largest) else f"is {largest:.3g}"
            raise self._failed(f"a number that it gives {what}; at most {LARGEST:.0e} is allowed")
        found: list[Array] = []
        at = 0
        for shape, size in zip(shapes, sizes, strict=True):
            found.append(numbers[at : at + size].reshape(shape).copy())
            at += size
        return found

    def _answer(self, expected: bytes) -> bytes:
        kind, size = child.HEAD.unpack(self._read(child.HEAD.size))
        if kind not in (expected, b"e") or size > 1 << 24:
            raise self._failed("it said something else than an answer")
        content = self._read(size)
        if kind == b"e":
            raise self._failed(content.decode("utf-8", "replace"), whole=True)
        return content

    def _read(self, size: int) -> bytes:
        content = b""
        while len(content) < size:
            begin = monotonic()
            if not self._ready.select(max(self._left, 0.0)):
                raise self._failed(f"it took longer than {self.about.seconds:g} s")
            self._left -= monotonic() - begin
            part = os.read(self._from, size - len(content))
            if not part:
                code = self._process.wait()
                killed = code in {-signal.SIGXCPU, -signal.SIGKILL}
                raise self._failed(
                    f"it used more than {self.about.seconds:g} s of a processor"
                    if killed
                    else f"its process ended by itself ({code})"
                )
            content += part
        return content

    def _failed(self, why: str, *, whole: bool = False) -> LawError:
        self.failure = why if whole else f"{self.about.file}: {why}"
        return LawError(self.failure)


def sent(reference: Reference) -> tuple[Any, ...]:
    """What a reference is made of, to be made again in another process."""
    match reference:
        case PerRigReference():
            return PerRigReference, reference.members, reference._period
        case SampledReference():
            return SampledReference, reference.original, reference._period
    raise ScenarioError("a lab's rigs must have one law: their designer knows different balls")


class AnswerLaw(Law):
    """The law of an answer; a subclass is made for each.

    Attributes:
        process: Has it.
    """

    process: ClassVar[AnswerProcess]

    def start(self, x: Array, reference: Reference, period: float) -> list[tuple[int, ...]]:
        """Begin a run there; the shapes of what is sent every period."""
        lead = x.shape[:-1]
        shapes = [(*lead, size) for size in (8, 8, len(self.needs), 2, 2, self.memory)]
        given = {"model": self.model, "reference": sent(reference), "period": period, "x": x}
        self.process.ask(b"s", pickle.dumps({**given, "shapes": shapes}), b"k")
        return shapes

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        parts = (now.x, now.equivalent, now.needed, now.rate, now.requested, now.memory)
        u, slope = self.process.numbers(
            b"c",
            np.concatenate([[now.time], *(each.ravel() for each in parts)]).tobytes(),
            (now.rate.shape, now.memory.shape),
        )
        self.process.slope = now.time, slope
        return u

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, (..., memory), known from ``command`` of that time."""
        if self.process.slope[0] == t:
            return self.process.slope[1]
        none = np.zeros((*x.shape[:-1], 2 + 2 + len(self.needs)))
        content = np.concatenate([[t], x.ravel(), x.ravel(), none.ravel(), q.ravel()]).tobytes()
        return self.process.numbers(b"q", content, (none[..., :2].shape, q.shape))[1]


class AnswerObserver(Observer):
    """The observer of an answer; a subclass is made for each.

    Attributes:
        process: Has it.
    """

    process: ClassVar[AnswerProcess]

    def start(self, x: Array) -> None:
        """Begin at the state x, shape (..., 8)."""
        names = {each.name for each in dataclasses.fields(self) if each.init}
        given = {"settings": {name: getattr(self, name) for name in names}, "x": x}
        lead = x.shape[:-1]
        shapes = [(*lead, 4), lead, lead]
        self._took(b"s", pickle.dumps({**given, "shapes": shapes}), x.shape)

    def correct(self, measurement: Measurement) -> Array:
        """Take in a measurement and return the estimate, shape (..., 8)."""
        parts = (measurement.y, measurement.age, measurement.touched)
        numbers = np.concatenate([[measurement.time], *(np.ravel(each) for each in parts)])
        self._took(b"c", numbers.astype(float).tobytes(), self.x.shape)
        return self.x

    def predict(self, u: Array) -> None:
        """Carry the estimate one period ahead under u, shape (..., 2)."""
        self._took(b"p", np.concatenate([[0.0], u.ravel()]).tobytes(), self.x.shape)

    def _took(self, kind: bytes, content: bytes, shape: tuple[int, ...]) -> None:
        shapes = (shape, shape, (*shape[:-1], len(self.knows)))
        self.x, self._equivalent, self._further = self.process.numbers(kind, content, shapes)

    @property
    def equivalent(self) -> Array:
        """The estimate as ``Feedback.equivalent`` has it, shape (..., 8)."""
        return self._equivalent

    @property
    def further(self) -> Array:
        """What it knows beyond the state, shape (..., len(knows))."""
        return self._further


def answer_class(process: AnswerProcess) -> type[Law] | type[Observer]:
    """The class of an answer's law or observer for the catalog, called ``answer``."""
    said = process.hello
    own: dict[str, Any] = {"name": NAME, "process": process, "__module__": __name__}
    try:
        if process.about.kind == "law":
            memory, needs = min(int(said["memory"]), MOST_MEMORY), tuple(map(str, said["needs"]))
            return type("Answer", (AnswerLaw,), {**own, "memory": memory, "needs": needs})
        own["knows"] = tuple(Quantity(str(name), str(unit)) for name, unit in said["knows"])
        base = DelayedObserver if said["delayed"] else Observer
        return type("Answer", (AnswerObserver, base), own)
    except (KeyError, TypeError, ValueError):
        raise LawError(f"{process.about.file}: it says what it is in no way known") from None
