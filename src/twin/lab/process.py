"""The grader's side of an answer in Python: asked as a law, observer or function of its own is."""

from __future__ import annotations

import math
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
from tempfile import TemporaryDirectory, TemporaryFile
from threading import RLock
from time import monotonic
from typing import IO, Any, ClassVar

import numpy as np

from controllers import catalog
from controllers.arrays import Array
from controllers.controller import PerRigReference, SampledReference
from controllers.interfaces import Feedback, Law, Measurement, Observer, Quantity, Reference
from twin.base.data_file import DataError, parse_json, read_regular
from twin.base.errors import LawError, ScenarioError, printable
from twin.lab.schema import AnswerTable

START_TIMEOUT_S = 20.0
"""Seconds in which the process must be there, whatever else the machine does."""
MAX_LOADING_S = 20.0
"""Time that an answer's file may take to be loaded, or a check's where it is more."""
LOOK_INTERVAL_S = 0.05
"""Time after which its folder is looked at again when it is asked."""
MAX_OWN_FILES = 32
"""Files in its folder, its own among them."""
MAX_OWN_BYTES = 4 * 1024**2
"""Sum of what they hold that are not the answer itself."""
POLL_INTERVAL_S = 0.01
"""Seconds after which one that has not answered is looked at."""
BUSY_STATES = ("R", "D")
"""States of a process that has work to do."""
MOST_SLOWED = 10
"""Factor by which other processes may slow it."""
MAX_ANSWER_NUMBER = 1e6
"""Largest number in an answer: accelerations in rad/s^2, estimates, rates of a law's memory."""
MAX_LINE_BYTES = 1 << 24
"""Bytes of a line that it says."""
MAX_ERROR_CHARACTERS = 1000
"""Length of an error that it tells."""
MAX_PRINTED_BYTES = 1 << 20
"""Bytes of what it prints that are read."""
MOST_MEMORY = 1000
"""Integrator states that a law may have, and quantities that an observer may know."""
ANSWER_NAME = "answer"
"""What a scenario calls the law or observer of an answer."""
STRANGE_MESSAGE = "it said something else than an answer"
PICKLED, NUMBERS = b"*", b"="
"""As the process has them."""
PROGRAM_OPCODES = {"start": 0.0, "command": 1.0, "correct": 1.0, "predict": 2.0}
"""What a program in any language is asked, as it is told."""
CHILD_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OPENSSL_CONF": "none"}
"""Without which numpy has threads, and Node.js ends because it may not read /etc."""
ONE_AT_A_TIME = RLock()
"""Held while a process of this computer's has the name ``answer``: a cluster's may have threads."""


@dataclass
class AnswerProcess:
    """A process that has an answer, and may do little else.

    It is asked by pickles and arrays, of the grader's own making, and says lines of JSON and bytes
    of numbers, which can do nothing here but be read. A program in any language is asked and says
    numbers alone: how many there are, then these.

    Attributes:
        process: The process.
        prints: What it prints: a file without a name, which no answer can put a link in place of.
        folder: Its own.
        name: What the answer's file is called.
        seconds: Time in s that it may take.
        left: That, and what it took until it was ready, less the time in which it slept.
        end: Until when it must have ended, whatever else the machine does.
        failure: Why it ended, in one line.
        program: Whether it is a program that is told numbers alone.
        loading: Whether it has not come to its first answer.
        looked: When its folder was looked at last, by the clock, s.
        slope: The last time in s of a command, and the rate of the law's memory then.
    """

    process: subprocess.Popen[bytes]
    prints: IO[bytes]
    folder: Path
    name: str
    seconds: float
    left: float
    end: float
    failure: str | None = None
    program: bool = False
    loading: bool = True
    looked: float = 0.0
    slope: tuple[float, Array] = (np.nan, np.zeros(0))

    def ask(self, what: str, width: int, time: float, *given: Array) -> Array:
        """Ask what is asked in every period and have its answer, an array (..., width).

        Args:
            what: What is asked.
            width: Of the answer's last axis.
            time: In s.
            given: Arrays of the same rigs; they go side by side, as one.

        Raises:
            LawError: If it fails, is too late, says something else, or a number is none or too
                large.
        """
        both = np.concatenate(given, axis=-1)
        self.tell(self.message(what, time, both))
        shape = (*both.shape[:-1], width)
        count = math.prod(shape)
        sign = np.float64(count).tobytes() if self.program else NUMBERS
        said = self.heard(8 * count, sign)
        if not said.startswith(sign):
            if said.startswith(b"{"):
                self.read(said)
            raise self.failed(f"{STRANGE_MESSAGE} of {count} numbers")
        got = np.frombuffer(said[len(sign) :]).reshape(shape).copy()
        largest = np.abs(got).max(initial=0.0)
        if not largest < MAX_ANSWER_NUMBER:
            what = f"is {largest:.3g}" if np.isfinite(largest) else "is not finite"
            raise self.failed(
                f"a number that it gives {what}; at most {MAX_ANSWER_NUMBER:.0e} is allowed"
            )
        return got

    def message(self, what: str, time: float, numbers: Array) -> bytes:
        """What is asked, the time in s or the period, and the numbers of all rigs, as bytes."""
        if self.program:
            return (
                np.array([2 + numbers.size, PROGRAM_OPCODES[what], time]).tobytes()
                + numbers.tobytes()
            )
        return what[:1].encode() + np.float64(time).tobytes() + numbers.tobytes()

    def begin(self, x: Array, *others: Any, period: float) -> None:
        """Begin a run at states x; a program is told these and the period. Errors as of ``ask``."""
        if self.program:
            self.tell(self.message("start", period, x))
        else:
            self.call("start", x, *others, period)

    def call(self, what: str, *given: Any) -> Any:
        """Ask anything else and have its answer; errors as of ``ask``."""
        self.tell(PICKLED + pickle.dumps((what, *given)))
        said = self.read(self.heard())
        if "answer" not in said:
            raise self.failed(STRANGE_MESSAGE)
        return said["answer"]

    def tell(self, text: bytes) -> None:
        """Send it something; errors as of ``ask``."""
        if self.failure is not None:
            raise LawError(self.failure)
        if monotonic() - self.looked > LOOK_INTERVAL_S:
            self.check_files()
        assert self.process.stdin is not None
        pipe, rest = self.process.stdin.fileno(), memoryview(text)
        with suppress(BrokenPipeError):  # it has ended: what it said last is still to be read
            while rest:
                self.wait([], [pipe])
                rest = rest[os.write(pipe, rest) :]

    def heard(self, size: int = 0, sign: bytes = b"{") -> bytes:
        """A line, or, where so many bytes of numbers are due, these after their sign."""
        assert self.process.stdout is not None
        heard, pipe = b"", self.process.stdout.fileno()
        while True:
            self.wait([pipe], [])
            if not (part := os.read(pipe, 1 << 16)):
                why = f"its process ended by itself ({self.process.wait()})"
                lines = self.printed(100)  # of a stack of calls, the line that has the error
                said = [line for line in lines if "rror" in line] or lines
                raise self.failed(": ".join([why, *said[-1:]]))
            heard += part
            if size and heard[: len(sign)] == sign[: len(heard)]:
                if len(heard) >= size + len(sign):
                    break
            elif not heard.startswith(b"{") or b"\n" in heard or len(heard) > MAX_LINE_BYTES:
                return heard
        if len(heard) != size + len(sign):
            raise self.failed(STRANGE_MESSAGE)
        return heard

    def wait(self, reads: list[int], writes: list[int]) -> None:
        """Wait for it, as long as it still may take.

        Its processor time counts, and time in which it sleeps; not time in which it would go on
        but other processes have the processors.
        """
        while (
            not (ready := any(select(reads, writes, [], POLL_INTERVAL_S))) or monotonic() > self.end
        ):
            state, used = self.at_work()
            self.left -= 0.0 if state in BUSY_STATES else POLL_INTERVAL_S
            if ready or used > self.left or monotonic() > self.end:
                raise self.failed(self.too_late())
            self.check_files()

    def too_late(self) -> str:
        """That it took too long, for what, in words."""
        if not self.loading:
            return f"it took longer than {self.seconds:g} s"
        most = max(self.seconds, MAX_LOADING_S)
        return f"it took longer than {most:g} s to be loaded: a loop outside of its functions?"

    def check_files(self) -> None:
        """Make sure that it has not filled its folder; errors as of ``ask``."""
        self.looked, count, total = monotonic(), 0, 0
        with suppress(OSError), os.scandir(self.folder) as entries:
            for entry in entries:
                count += 1
                if entry.name != self.name:
                    total += entry.stat(follow_symlinks=False).st_size
                if count > MAX_OWN_FILES or total > MAX_OWN_BYTES:
                    most = f"{MAX_OWN_FILES} files of {MAX_OWN_BYTES // 1024**2} MB together"
                    raise self.failed(f"it writes more than {most}")

    def at_work(self) -> tuple[str, float]:
        """Its state, and its processor time in s, as Linux says; elsewhere it always sleeps."""
        with suppress(OSError):
            text = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="utf-8")
            state, *others = text.rpartition(")")[2].split()
            return state, sum(map(int, others[10:12])) / os.sysconf("SC_CLK_TCK")
        return "S", 0.0

    def read(self, line: bytes) -> dict[str, Any]:
        """What a line of JSON says; errors as of ``ask``."""
        try:
            said = parse_json(line.splitlines()[-1])  # a program that cannot be begun says two
        except DataError:
            said = None
        if not isinstance(said, dict):
            raise self.failed(STRANGE_MESSAGE)
        if "error" in said:
            text = str(said["error"]).encode("utf-8", "replace").decode()
            self.failure = printable(text)[:MAX_ERROR_CHARACTERS]
            raise LawError(self.failure)
        return said

    def printed(self, most: int = 5) -> list[str]:
        """The last lines that the answer printed."""
        text = os.pread(self.prints.fileno(), MAX_PRINTED_BYTES, 0).decode(errors="replace")
        lines = [printable(line)[:200] for line in text.splitlines() if line.strip()]
        return lines[-most:]

    def failed(self, why: str) -> LawError:
        """The error that it did not give what it must; it is asked nothing more."""
        self.failure = printable(f"{self.name}: {why}")
        return LawError(self.failure)


class AnswerLaw(Law):
    """The law of an answer; a subclass is made for each.

    Attributes:
        process: Has it.
    """

    process: ClassVar[AnswerProcess]

    def start(self, x: Array, reference: Reference, period: float) -> None:
        """Begin a run there."""
        self.process.begin(x, self.model, picklable_reference(reference), period=period)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2); the memory's rate comes with them."""
        given: list[Any] = [*now[:6], now.memory]
        if self.process.program:  # it has no reference to ask: position, four derivatives
            given += [np.broadcast_to(each, now.rate.shape) for each in now.reference(now.time)]
        both = self.process.ask("command", 2 + self.memory, *given)
        self.process.slope = now.time, both[..., 2:]
        return both[..., :2]

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, shape (..., memory), as it came with the command of t."""
        if self.process.slope[0] == t:
            return self.process.slope[1]
        return self.process.ask("memory_rate", self.memory, t, x, q)  # between two commands


@dataclass(kw_only=True)
class AnswerObserver(Observer):
    """The observer of an answer; a subclass is made for each.

    Attributes:
        process: Has it.
    """

    process: ClassVar[AnswerProcess]

    def start(self, x: Array) -> None:
        """Begin at the state x there."""
        super().start(x)
        self.process.begin(x, self.model, period=self.period)

    def correct(self, measurement: Measurement) -> Array:
        """The estimate at a measurement, of which the true state stays here."""
        time, y, *others = measurement[:4]
        return self._asked("correct", time, y, *(each[..., np.newaxis] for each in others))

    def predict(self, u: Array) -> None:
        """One period ahead under the input u, shape (..., 2)."""
        self._asked("predict", 0.0, u)

    def _asked(self, what: str, *given: Any) -> Array:
        self._all = self.process.ask(what, 16 + len(self.knows), *given)
        self.x = self._all[..., :8]
        return self.x

    @property
    def equivalent(self) -> Array:
        """As it says, shape (..., 8)."""
        return self._all[..., 8:16]

    @property
    def further(self) -> Array:
        """What it knows beyond the state, shape (..., len(knows))."""
        return self._all[..., 16:]


def picklable_reference(reference: Reference) -> tuple[Any, ...]:
    """What a reference is made of, to be made again in another process."""
    match reference:
        case PerRigReference():
            return PerRigReference, reference.members, reference._period
        case SampledReference():
            return SampledReference, reference.original, reference._period
    raise ScenarioError("a lab's rigs must have one law: their designer knows different balls")


def answer_class(kind: str, said: dict[str, Any]) -> tuple[type, dict[str, Any]]:
    """The class that an answer is here, and what its process says of it."""
    if kind == "law":
        needs = tuple(map(str, said["needs"]))
        return AnswerLaw, {"memory": min(int(said["memory"]), MOST_MEMORY), "needs": needs}
    knows = [Quantity(*map(str, each)) for each in said["knows"][:MOST_MEMORY]]
    return AnswerObserver, {"knows": tuple(knows)}


@contextmanager
def answering(file: Path, about: AnswerTable) -> Iterator[AnswerProcess]:
    """Have an answer's process, and its law or observer in the catalog, called ``answer``.

    Args:
        file: The answer.
        about: What it is.

    Raises:
        LawError: If it cannot be loaded: its file, its line, the error.
        ScenarioError: If the system cannot keep a process within limits, or has no such program.
    """
    if sys.platform == "win32":
        raise ScenarioError("answers in Python are judged on Linux or macOS: no limits here")
    from twin.lab import child  # noqa: PLC0415  not on Windows

    may = about.seconds
    with TemporaryDirectory(prefix="ballplate-answer-") as folder:
        here = Path(folder).resolve()
        own = here / about.file
        try:
            own.write_bytes(read_regular(file))
        except DataError as error:
            raise LawError(f"{about.file}: {error}") from None
        what = [
            str(int(may + START_TIMEOUT_S + max(may, MAX_LOADING_S))),
            about.kind,
            about.function,
        ]
        if about.command:
            name, *given = about.command
            own.chmod(0o755)
            if not (program := own if Path(name) == Path(about.file) else shutil.which(name)):
                raise ScenarioError(f"command: '{name}': no such program here")
            what += [str(Path(program).resolve()), *given]
        with ONE_AT_A_TIME, TemporaryFile() as prints:
            begun = subprocess.Popen(
                [sys.executable, "-I", "-u", child.__file__, own, *what],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=prints,
                cwd=here,
                # matplotlib, which control imports, keeps its lists there and makes no folder then
                env={"HOME": folder, "MPLCONFIGDIR": folder, "LANG": "C.UTF-8"} | CHILD_ENVIRONMENT,
                start_new_session=True,
            )
            assert begun.stdin is not None
            os.set_blocking(begun.stdin.fileno(), False)  # one that reads nothing stops nobody
            end = monotonic() + MOST_SLOWED * (START_TIMEOUT_S + max(may, MAX_LOADING_S) + may)
            process = AnswerProcess(begun, prints, here, about.file, may, START_TIMEOUT_S, end)
            process.program = bool(about.command)
            try:
                said = process.read(process.heard())
                process.left = max(may, MAX_LOADING_S) + process.at_work()[1]
                if "loading" in said:  # it is there: from here on its own lines are at work
                    said = process.read(process.heard())
                process.loading = False
                process.left = may + process.at_work()[1]
                if about.kind != "function":
                    try:
                        base, fields = answer_class(about.kind, said)
                    except (LookupError, TypeError, ValueError, OverflowError):
                        raise process.failed(STRANGE_MESSAGE) from None
                    fields |= {"name": ANSWER_NAME, "process": process, "__module__": __name__}
                    catalog.register(type("Answer", (base,), fields))
                yield process
            finally:
                catalog.unregister(ANSWER_NAME)
                with suppress(OSError):  # it has ended, and all that it may have begun
                    os.killpg(begun.pid, signal.SIGKILL)
                begun.communicate()
