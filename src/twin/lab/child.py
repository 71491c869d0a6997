"""The script of a student's process: limits first, then their file, then one answer a period.

Run by its path; the arguments are the answer's file, its processor time in s, its kind, the name of
a function, and for a language other than Python the program and its arguments, which replaces this
process. Requests come on standard input, answers leave on what was its standard output; printed
text goes to a file. Nothing of a rig but measurements and estimates comes in here, and nothing but
numbers and texts goes out.
"""

from __future__ import annotations

import errno
import inspect
import io
import json
import math
import os
import pickle
import resource
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, BinaryIO, cast

if __name__ == "__main__":
    # a name would be looked for in the folder of this file first
    sys.path.insert(0, str(Path(__file__).parents[2]))

import numpy as np

import twin
from controllers import catalog
from controllers.interfaces import DelayedObserver, Feedback, Law, Measurement, Observer
from twin.lab.confinement import be_nobody, refuse_calls, shut_in

MAX_WRITTEN_BYTES = 256 * 1024
"""Bytes that an answer may print or write to one file."""
MAX_MEMORY_BYTES = 2 * 1024**3
"""Bytes of address space of an answer."""
MAX_OPEN_FILES = 128
"""Files that an answer may have open."""
MAX_ERROR_CHARACTERS = 1000
"""Length of an error message."""
CLOSED_MODULES = ("mujoco", "twin.sim", "twin.lab", "twin.hal", "twin.devices", "twin.emulator")
"""Beginnings of the modules that an answer may not import."""
STARTING_EVENTS = ("os.fork", "os.exec", "os.posix_spawn", "os.system", "subprocess.", "pty.spawn")
"""Beginnings of the audit events of a new process."""
PICKLED, NUMBERS = b"*", b"="
"""Tags of a pickle and of the bytes of an array; equal to those of ``lab/process.py``. A request of
every period begins with its first letter."""


class Printed(io.RawIOBase):
    """Text that an answer prints: as much as its file may hold; the rest is dropped."""

    def writable(self) -> bool:
        """It can be written to."""
        return True

    def write(self, data: Any) -> int:
        """Write bytes, up to the limit of the file."""
        rest = memoryview(data).cast("B")
        length = len(rest)
        try:
            while rest:
                rest = rest[os.write(1, rest) :]
        except OSError as error:
            if error.errno != errno.EFBIG:
                raise
        return length


def send_line(**content: Any) -> None:
    """Send the grader a line of JSON."""
    line = json.dumps(content, default=lambda value: value.tolist()).encode() + b"\n"
    while line:
        line = line[os.write(_OUT, line) :]


def send_numbers(*arrays: Any) -> None:
    """Send the grader the numbers of arrays, joined along their last axis: their very bits."""
    os.write(_OUT, NUMBERS + np.concatenate(arrays, axis=-1, dtype=float).tobytes())


def receive_requests(**widths: Sequence[int]) -> Iterator[list[Any]]:
    """The requests of the grader, one after the other, until it closes the pipe.

    Args:
        widths: For each request of every period the lengths of the last axes of its arrays, which
            come joined, after the time, for as many rigs as the state that a run was begun with.
    """
    periodic, rigs = {name[:1].encode(): name for name in widths}, ()
    with suppress(EOFError), open(_IN, "rb") as grader:  # noqa: PTH123  no path
        while first := grader.read(1):
            if first == PICKLED:
                what, *given = pickle.load(grader)
                rigs = np.shape(given[0])[:-1]
                yield [what, *given]
                continue
            ends = [*accumulate(widths[periodic[first]], initial=0)]
            text = bytearray(grader.read(8 + 8 * math.prod(rigs) * ends[-1]))
            both = np.frombuffer(text, offset=8).reshape(*rigs, ends[-1])
            parts = [np.ascontiguousarray(both[..., a:b]) for a, b in pairwise(ends)]  # same bits
            yield [periodic[first], *struct.unpack("d", text[:8]), *parts]


def limit(seconds: int, program: Sequence[str] = ()) -> None:
    """Confine this process, for good.

    Limits of the system, where it has them: processor time, memory, length and number of files; on
    Linux, those of ``confinement``. A hook of the interpreter, which gives reasons: no
    processes, and no import of the simulator. A program has no such hook, and may have threads.

    Args:
        seconds: Processor time in s.
        program: The program and its arguments of an answer that is not in Python.
    """
    bounds = {
        "CPU": seconds,
        "FSIZE": MAX_WRITTEN_BYTES,
        "AS": MAX_MEMORY_BYTES,
        "NOFILE": MAX_OPEN_FILES,
        "NPROC": 0,
        "CORE": 0,
    }
    if program:
        del bounds["NPROC"]  # which counts threads, and those of all processes of this user
    for name, bound in bounds.items():
        resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (bound, bound))
    places = readable(*program[:1])
    be_nobody(places)
    shut_in(places)
    refuse_calls(program=bool(program))

    def refuse(event: str, given: tuple[Any, ...]) -> None:
        if event.startswith(STARTING_EVENTS):
            raise PermissionError("an answer may not start a process")
        if event == "import" and str(given[0]).startswith(CLOSED_MODULES):
            raise ImportError(f"{given[0]} is the grader's: an answer may not import it")

    if not program:
        sys.addaudithook(refuse)


def readable(program: str = "") -> list[str]:
    """Paths that it needs to read: Python, its packages, ours, and the folder of a program."""
    home, packages = Path(twin.__file__).parent, Path(np.__file__).parents[1]
    ours = (home, home.parent / "ballplate", Path(inspect.getfile(Law)).parent, packages)
    theirs = (sys.prefix, sys.base_prefix, "/usr", "/lib", "/lib64", "/dev/urandom")
    return [*map(str, ours), *theirs, *([str(Path(program).parent)] if program else [])]


def load_class(file: Path, base: type) -> Any:
    """The one law or observer that a file defines.

    Raises:
        TypeError: If it defines none, or several.
    """
    module = catalog.import_file(file)
    every = [each for each in vars(module).values() if inspect.isclass(each)]
    found = [
        each for each in every if issubclass(each, base) and each.__module__ == module.__name__
    ]
    if len(found) != 1:
        names, kind = ", ".join(each.__name__ for each in found) or "none", base.__name__
        raise TypeError(
            f"must define one {kind.lower()}, a class derived from {kind}, defines {names}"
        )
    return found[0]


def serve_law(file: Path) -> None:
    """Describe the law of a file, then answer the grader's requests."""
    cls = load_class(file, Law)
    send_line(memory=cls.memory, needs=cls.needs)
    memory, needs = cls.memory, len(cls.needs)
    for what, *given in receive_requests(
        command=(8, 8, needs, 2, 2, memory), memory_rate=(8, memory)
    ):
        if what == "start":
            x, model, (make, *made_of), period = given
            law, reference = cls(model=model), make(*made_of)
            if problem := catalog.wrong_answer(law):
                raise TypeError(problem)
            plan = law.start(x, reference, period)
            send_line(answer=None)
            continue
        found, (time, x, *others, q) = [], given
        if what == "command":
            equivalent, needed, rate, requested = others
            now = Feedback(
                time=time,
                x=x,
                equivalent=equivalent,
                needed=needed,
                rate=rate,
                requested=requested,
                reference=reference,
                memory=q,
                plan=plan,
            )
            found, x = [catalog.check_command(law, law.command(now), now.rate)], now.equivalent
        if law.memory:
            slope = law.memory_rate(time, x, reference, q)
            found.append(catalog.check_memory_rate(law, slope, q))
        send_numbers(*found)


def serve_observer(file: Path) -> None:
    """Describe the observer of a file, then answer the grader's requests."""
    cls = load_class(file, Observer)
    if issubclass(cls, DelayedObserver):
        raise TypeError("must be an Observer: the lab compensates the dead time")
    send_line(knows=cls.knows)
    for what, *given in receive_requests(correct=(4, 1, 1), predict=(2,)):
        if what == "start":
            x, model, period = given
            observer = cls(model=model, period=period)
            observer.start(x)
            send_line(answer=None)
            continue
        if what == "correct":
            time, y, age, touched = given
            seen = Measurement(time, y, age[..., 0], touched[..., 0] > 0.5)
            catalog.check_estimate(observer, observer.correct(seen), y)
        else:
            observer.predict(given[1])
        x, further = catalog.check_estimate(observer, observer.x, given[1]), observer.further
        if further.shape[-1] != len(cls.knows):
            raise TypeError(f"{cls.__name__}.further must have as many numbers as knows has names")
        send_numbers(x, observer.equivalent, further)


def serve_function(file: Path, name: str) -> None:
    """Answer the grader's requests with what a function returns for its arguments by name."""
    call = getattr(catalog.import_file(file), name, None)
    if not callable(call):
        raise TypeError(f"must define a function {name}")
    send_line(ready=True)
    for _, given in receive_requests():
        found = call(**given)
        if not isinstance(found, dict):
            raise TypeError(f"{name} must return a dict, gave {type(found).__name__}")
        send_line(answer=found)


def line_of(error: BaseException, file: Path) -> str:
    """An error in one line: file and line of the answer, kind and words."""
    if isinstance(error, OSError) and error.errno == errno.EFBIG:
        words = f"it writes more than {MAX_WRITTEN_BYTES // 1024} kB"
        error = OSError(words).with_traceback(error.__traceback__)
    line = catalog.failed_line(error, {str(file)}) or f"{file}: {catalog.error_words(error)}"
    return line.replace(str(file), file.name)[:MAX_ERROR_CHARACTERS]


def main(file: Path, seconds: int, kind: str, function: str, *program: str) -> None:
    """Serve an answer until the grader has no more requests, or it fails."""
    try:
        limit(seconds, program)
        send_line(loading=True)
        if program:
            send_line(memory=0, needs=(), knows=())
            os.dup2(_IN, 0)
            os.dup2(_OUT, 1)
            os.execv(program[0], program)
        elif function:
            serve_function(file, function)
        else:
            (serve_law if kind == "law" else serve_observer)(file)
    except BaseException as error:  # noqa: BLE001 - an answer may raise anything
        with suppress(OSError):
            send_line(error=line_of(error, file))
    os._exit(0)


if __name__ == "__main__":
    # its printed text goes where its errors do; its standard input is empty
    _IN, _OUT = os.dup(0), os.dup(1)
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.stdout = sys.stderr = io.TextIOWrapper(
        cast(BinaryIO, Printed()), "utf-8", "backslashreplace", write_through=True
    )
    main(Path(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
