"""The grader's side of an answer: a law, observer or function that runs in a process of its own."""

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
from controllers.interfaces import Feedback, Law, Measurement, Observer, Quantity, Reference
from controllers.per_rig import PerRigReference, SampledReference
from twin.base.data_file import DataError, parse_json, read_regular
from twin.base.errors import LawError, ScenarioError, plural, printable
from twin.lab.schema import AnswerTable


@dataclass(frozen=True, kw_only=True)
class AnswerLimits:
    """Limits of the process of an answer.

    Attributes:
        start_s: Time in s within which the process must have started, whatever the machine's load.
        loading_s: Time in s that an answer's file may take to be loaded; the time of a check if
            longer.
        slowdown: Factor by which other processes may slow it.
        poll_s: Interval in s at which a process that has not answered is examined.
        folder_check_s: Shortest interval in s between two examinations of its folder.
        files: Number of files in its folder, the answer among them.
        files_bytes: Sum of their sizes without the answer, bytes.
        number: Largest number in an answer: accelerations in rad/s^2, estimates, rates of a law's
            memory.
        line_bytes: Length of a line of JSON, bytes.
        error_characters: Length of an error message.
        printed_bytes: Bytes of its printed text that are read.
        quantities: Number of integrator states of a law, and of quantities that an observer knows.
    """

    start_s: float = 20.0
    loading_s: float = 20.0
    slowdown: float = 10
    poll_s: float = 0.01
    folder_check_s: float = 0.05
    files: int = 32
    files_bytes: int = 4 * 1024**2
    number: float = 1e6
    line_bytes: int = 1 << 24
    error_characters: int = 1000
    printed_bytes: int = 1 << 20
    quantities: int = 1000

    def load_time(self, seconds: float) -> float:
        """Longest time in s for loading an answer with a check that may take ``seconds``."""
        return max(seconds, self.loading_s)


ANSWER_LIMITS = AnswerLimits()
BUSY_STATES = ("R", "D")
"""States of a process that has work to do, as Linux names them."""
ANSWER_NAME = "answer"
"""Name of an answer's law or observer in a scenario."""
STRANGE_MESSAGE = "it sent something else than an answer"
PICKLED, NUMBERS = b"*", b"="
"""Tags of a pickle and of the bytes of an array; equal to those of ``lab/child.py``."""
PROGRAM_OPCODES = {"start": 0.0, "command": 1.0, "correct": 1.0, "predict": 2.0}
"""Requests to a program in any language: the number that it receives for each."""
CHILD_ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "OPENSSL_CONF": "none",
}
"""Environment without which numpy has threads, a process that imports pandas ends because numexpr,
where it is installed, may not start any, and Node.js ends because it may not read /etc."""
ONE_AT_A_TIME = RLock()
"""Held while a process of this computer has the name ``answer``: a cluster's may have threads."""


class OutOfTimeError(LawError):
    """An answer took longer than it may."""


@dataclass
class AnswerProcess:
    """Sandboxed subprocess that runs a student's answer.

    It receives pickles and arrays that the grader made, and sends lines of JSON and bytes of
    numbers, which are read here and never executed. A program in any language receives and sends
    numbers alone: their count, then the numbers.

    Attributes:
        process: The process.
        prints: Its printed text: a file without a name, which no answer can replace by a link.
        folder: Its own folder.
        name: Name of the answer's file.
        seconds: Time in s that it may take.
        left: Remaining processor time in s: ``seconds`` and its use until it was ready, less the
            time in which it slept.
        end: Monotonic time in s at which it must have ended, whatever the machine's load.
        most_printed: Bytes of its printed text that are kept.
        limits: Limits of its resources and messages.
        failure: Why it ended, in one line.
        out_of_time: Whether it ended because it took too long.
        program: Whether it is a program that receives numbers alone.
        loading: Whether it has not come to its first answer.
        checked: Monotonic time in s of the last examination of its folder.
        slope: The last time in s of a command, and the rate of the law's memory then.
    """

    process: subprocess.Popen[bytes]
    prints: IO[bytes]
    folder: Path
    name: str
    seconds: float
    left: float
    end: float
    most_printed: int
    limits: AnswerLimits = ANSWER_LIMITS
    failure: str | None = None
    out_of_time: bool = False
    program: bool = False
    loading: bool = True
    checked: float = 0.0
    slope: tuple[float, Array] = (np.nan, np.zeros(0))

    def ask(self, what: str, width: int, time: float, *given: Array) -> Array:
        """Send a request of every period and receive its answer, an array (..., width).

        Args:
            what: The request, as ``command``.
            width: Length of the answer's last axis.
            time: Time in s.
            given: Arrays of the same rigs, joined along their last axis.

        Raises:
            LawError: If it fails, is too late, sends something else, or a number is not finite or
                too large.
        """
        both = np.concatenate(given, axis=-1)
        self.send(self.message(what, time, both))
        shape = (*both.shape[:-1], width)
        count = math.prod(shape)
        tag = np.float64(count).tobytes() if self.program else NUMBERS
        received = self.receive(8 * count, tag)
        if not received.startswith(tag):
            if received.startswith(b"{"):
                self.read(received)
            raise self.fail(f"{STRANGE_MESSAGE} of {plural(count, 'number')}")
        got = np.frombuffer(received[len(tag) :]).reshape(shape).copy()
        largest = np.abs(got).max(initial=0.0)
        if not largest < self.limits.number:
            what = f"is {largest:.3g}" if np.isfinite(largest) else "is not finite"
            raise self.fail(
                f"a number that it gives {what}; at most {self.limits.number:.0e} is allowed"
            )
        return got

    def message(self, what: str, time: float, numbers: Array) -> bytes:
        """A request with its time in s or the period, and the numbers of all rigs, as bytes."""
        if self.program:
            return (
                np.array([2 + numbers.size, PROGRAM_OPCODES[what], time]).tobytes()
                + numbers.tobytes()
            )
        return what[:1].encode() + np.float64(time).tobytes() + numbers.tobytes()

    def begin(self, x: Array, *others: Any, period: float) -> None:
        """Begin a run at states x; a program receives x and the period. Errors as of ``ask``."""
        if self.program:
            self.send(self.message("start", period, x))
        else:
            self.call("start", x, *others, period)

    def call(self, what: str, *given: Any) -> Any:
        """Send any other request and receive its answer; errors as of ``ask``."""
        self.send(PICKLED + pickle.dumps((what, *given)))
        received = self.read(self.receive())
        if "answer" not in received:
            raise self.fail(STRANGE_MESSAGE)
        return received["answer"]

    def send(self, text: bytes) -> None:
        """Send bytes to it; errors as of ``ask``."""
        if self.failure is not None:
            raise LawError(self.failure)
        if monotonic() - self.checked > self.limits.folder_check_s:
            self.check_files()
        assert self.process.stdin is not None
        pipe, rest = self.process.stdin.fileno(), memoryview(text)
        with suppress(BrokenPipeError):  # it has ended: its last line is still to be read
            while rest:
                self.wait([], [pipe])
                rest = rest[os.write(pipe, rest) :]

    def receive(self, size: int = 0, tag: bytes = b"{") -> bytes:
        """A line, or, where a number of bytes is expected, the tag and these; errors as of ``ask``.

        Args:
            size: Number of bytes after the tag; 0 for a line.
            tag: The bytes that begin it.
        """
        assert self.process.stdout is not None
        received, pipe = b"", self.process.stdout.fileno()
        while True:
            self.wait([pipe], [])
            if not (part := os.read(pipe, 1 << 16)):
                why = f"its process ended by itself ({self.process.wait()})"
                lines = self.last_printed(100)  # of a stack of calls, the line that has the error
                last = ([line for line in lines if "rror" in line] or lines)[-1:]
                raise self.fail(": ".join([why, *last]))
            received += part
            if size and received[: len(tag)] == tag[: len(received)]:
                if len(received) >= size + len(tag):
                    break
            elif (
                not received.startswith(b"{")
                or b"\n" in received
                or len(received) > self.limits.line_bytes
            ):
                return received
        if len(received) != size + len(tag):
            raise self.fail(STRANGE_MESSAGE)
        return received

    def wait(self, reads: list[int], writes: list[int]) -> None:
        """Wait for it, as long as it still may take.

        Its processor time counts, and time in which it sleeps; not time in which it is ready to
        run but other processes have the processors.
        """
        poll = self.limits.poll_s
        while not (ready := any(select(reads, writes, [], poll))) or monotonic() > self.end:
            state, used = self.processor_time()
            self.left -= 0.0 if state in BUSY_STATES else poll
            if ready or used > self.left or monotonic() > self.end:
                self.out_of_time = True
                raise self.fail(self.describe_timeout())
            self.check_files()

    def describe_timeout(self) -> str:
        """The message that it took too long, and for what."""
        if not self.loading:
            return f"it took longer than {self.seconds:g} s"
        longest = self.limits.load_time(self.seconds)
        return f"it took longer than {longest:g} s to be loaded: a loop outside of its functions?"

    def check_files(self) -> None:
        """Make sure that it has not filled its folder; errors as of ``ask``."""
        self.checked, count, total, limits = monotonic(), 0, 0, self.limits
        with suppress(OSError), os.scandir(self.folder) as entries:
            for entry in entries:
                count += 1
                if entry.name != self.name:
                    total += entry.stat(follow_symlinks=False).st_size
                if count > limits.files or total > limits.files_bytes:
                    allowed = f"{limits.files} files of {limits.files_bytes // 1024**2} MB together"
                    raise self.fail(f"it writes more than {allowed}")

    def processor_time(self) -> tuple[str, float]:
        """Its state, and its processor time in s, on Linux; elsewhere it always sleeps."""
        with suppress(OSError):
            text = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="utf-8")
            state, *others = text.rpartition(")")[2].split()
            return state, sum(map(int, others[10:12])) / os.sysconf("SC_CLK_TCK")
        return "S", 0.0

    def read(self, line: bytes) -> dict[str, Any]:
        """The content of a line of JSON; errors as of ``ask``."""
        try:
            content = parse_json(line.splitlines()[-1])  # a program that cannot be begun sends two
        except DataError:
            content = None
        if not isinstance(content, dict):
            raise self.fail(STRANGE_MESSAGE)
        if "error" in content:
            text = str(content["error"]).encode("utf-8", "replace").decode()
            self.failure = printable(text)[: self.limits.error_characters]
            raise LawError(self.failure)
        return content

    def prints_too_much(self) -> bool:
        """Whether a part of its printed text was dropped."""
        return os.fstat(self.prints.fileno()).st_size >= self.most_printed

    def last_printed(self, most: int = 5) -> list[str]:
        """The last lines that the answer printed."""
        text = os.pread(self.prints.fileno(), self.limits.printed_bytes, 0)
        decoded = text.decode(errors="replace")
        lines = [printable(line)[:200] for line in decoded.splitlines() if line.strip()]
        return lines[-most:]

    def fail(self, why: str) -> LawError:
        """The error that it did not answer as it must; it receives no request after it."""
        self.failure = printable(f"{self.name}: {why}")
        return self.error()

    def error(self) -> LawError:
        """The error of its failure."""
        return (OutOfTimeError if self.out_of_time else LawError)(str(self.failure))


class AnswerLaw(Law):
    """The law of an answer; a subclass is made for each.

    Attributes:
        process: The process that runs it.
    """

    process: ClassVar[AnswerProcess]

    def start(self, x: Array, reference: Reference, period: float) -> None:
        """Begin a run in the process."""
        self.process.begin(x, self.model, picklable_reference(reference), period=period)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2); the memory's rate comes with them."""
        arrays = now.x, now.equivalent, now.needed, now.rate, now.requested, now.memory
        given: list[Any] = [now.time, *arrays]
        if self.process.program:  # without a reference to evaluate: position, four derivatives
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
        process: The process that runs it.
    """

    process: ClassVar[AnswerProcess]

    def start(self, x: Array) -> None:
        """Begin at the state x in the process."""
        super().start(x)
        self.process.begin(x, self.model, period=self.period)

    def correct(self, measurement: Measurement) -> Array:
        """The estimate at a measurement; its true state is not sent to the process."""
        flags = measurement.age, measurement.touched
        columns = (each[..., np.newaxis] for each in flags)
        return self._request("correct", measurement.time, measurement.y, *columns)

    def predict(self, u: Array) -> None:
        """One period ahead under the input u, shape (..., 2)."""
        self._request("predict", 0.0, u)

    def _request(self, what: str, *given: Any) -> Array:
        self._all = self.process.ask(what, 16 + len(self.knows), *given)
        self.x = self._all[..., :8]
        return self.x

    @property
    def equivalent(self) -> Array:
        """The estimate as ``Feedback.equivalent`` has it, shape (..., 8)."""
        return self._all[..., 8:16]

    @property
    def further(self) -> Array:
        """The quantities that it knows beyond the state, shape (..., len(knows))."""
        return self._all[..., 16:]


def picklable_reference(reference: Reference) -> tuple[Any, ...]:
    """The class of a reference and its arguments, from which a process makes it again.

    Raises:
        ScenarioError: If the rigs have more than one law.
    """
    match reference:
        case PerRigReference():
            return PerRigReference, reference.members, reference._period
        case SampledReference():
            return SampledReference, reference.original, reference._period
    raise ScenarioError(
        "a lab's rigs must have one law, but its design depends on the ball, which differs"
    )


def answer_class(kind: str, described: dict[str, Any], most: int) -> tuple[type, dict[str, Any]]:
    """The base class of an answer here, and the class variables that its process describes.

    Args:
        kind: ``law`` or ``observer``.
        described: The first line of the process.
        most: Largest number of integrator states or known quantities.
    """
    if kind == "law":
        needs = tuple(map(str, described["needs"]))
        return AnswerLaw, {"memory": min(int(described["memory"]), most), "needs": needs}
    knows = [Quantity(*map(str, each)) for each in described["knows"][:most]]
    return AnswerObserver, {"knows": tuple(knows)}


@contextmanager
def answering(
    file: Path, about: AnswerTable, limits: AnswerLimits = ANSWER_LIMITS
) -> Iterator[AnswerProcess]:
    """The process of an answer, with its law or observer in the catalog, called ``answer``.

    Args:
        file: The answer.
        about: Its kind, name and time.
        limits: What its process may use and send.

    Raises:
        LawError: If it cannot be loaded: its file, its line, the error.
        ScenarioError: If the system cannot keep a process within limits, or has no such program.
    """
    if sys.platform == "win32":
        raise ScenarioError(
            "answers in Python are graded on Linux or macOS only; this system has no limits"
        )
    from twin.lab import child  # noqa: PLC0415  not on Windows

    seconds, loading = about.seconds, limits.load_time(about.seconds)
    with TemporaryDirectory(prefix="ballplate-answer-") as folder:
        here = Path(folder).resolve()
        own = here / about.file
        try:
            own.write_bytes(read_regular(file))
        except DataError as error:
            raise LawError(f"{about.file}: {error}") from None
        what = [str(int(seconds + limits.start_s + loading)), about.kind, about.function]
        if about.command:
            name, *given = about.command
            own.chmod(0o755)
            if not (program := own if Path(name) == Path(about.file) else shutil.which(name)):
                raise ScenarioError(f"command: '{name}': no such program here")
            what += [str(Path(program).resolve()), *given]
        with ONE_AT_A_TIME, TemporaryFile() as prints:
            child_process = subprocess.Popen(
                [sys.executable, "-I", "-u", child.__file__, own, *what],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=prints,
                cwd=here,
                # matplotlib, which control imports, keeps its lists there and makes no folder then
                env={"HOME": folder, "MPLCONFIGDIR": folder, "LANG": "C.UTF-8"} | CHILD_ENVIRONMENT,
                start_new_session=True,
            )
            assert child_process.stdin is not None
            # one that reads nothing must not block the grader
            os.set_blocking(child_process.stdin.fileno(), False)
            process = AnswerProcess(
                process=child_process,
                prints=prints,
                folder=here,
                name=about.file,
                seconds=seconds,
                left=limits.start_s,
                end=monotonic() + limits.slowdown * (limits.start_s + loading + seconds),
                most_printed=child.MAX_WRITTEN_BYTES,
                limits=limits,
                program=bool(about.command),
            )
            try:
                described = process.read(process.receive())
                process.left = loading + process.processor_time()[1]
                if "loading" in described:  # it has started: its own lines are executed from here
                    described = process.read(process.receive())
                process.loading = False
                process.left = seconds + process.processor_time()[1]
                if about.kind != "function":
                    try:
                        base, fields = answer_class(about.kind, described, limits.quantities)
                    except (LookupError, TypeError, ValueError, OverflowError):
                        raise process.fail(STRANGE_MESSAGE) from None
                    fields |= {"name": ANSWER_NAME, "process": process, "__module__": __name__}
                    catalog.register(type("Answer", (base,), fields))
                yield process
            finally:
                catalog.unregister(ANSWER_NAME)
                with suppress(OSError):  # it has ended, and every process of its group
                    os.killpg(child_process.pid, signal.SIGKILL)
                child_process.communicate()
