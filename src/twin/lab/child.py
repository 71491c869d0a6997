"""What runs in a student's process: limits first, then their file, then one answer a period.

Run by its path, with the answer's file and the seconds of a processor it may use as arguments. It
is told on standard input and answers on what was its standard output; what the answer prints goes
to a file. Nothing of a rig but measurements and estimates comes in here, and nothing but numbers
and texts goes out.
"""

from __future__ import annotations

import ctypes
import errno
import importlib.util
import inspect
import json
import os
import pickle
import resource
import struct
import sys
import traceback
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    # a name would be looked for in the folder of this file first
    sys.path.insert(0, str(Path(__file__).parents[2]))

import numpy as np

import twin
from controllers.catalog import commanded, remembered, wrong_answer
from controllers.interfaces import Feedback, Law

HEAD = struct.Struct("<cxxxI")
"""Of every message: what it is, and how many bytes follow."""
PRINTED = "printed.txt"
MOST_PRINTED = 256 * 1024
"""Bytes an answer may print or write."""
MEMORY = 2 * 1024**3
"""Bytes of address space."""
CLOSED = ("mujoco", "twin.sim", "twin.lab", "twin.hal", "twin.devices", "twin.emulator")
STARTING = ("os.fork", "os.exec", "os.posix_spawn", "os.system", "subprocess.", "pty.spawn")
READ_FILE, READ_FOLDER, EXECUTE = 1 << 2, 1 << 3, 1 << 0
"""Rights of Landlock (linux/landlock.h)."""


def answer(kind: bytes, content: bytes = b"") -> None:
    """Send a message to the grader."""
    os.write(_OUT, HEAD.pack(kind, len(content)) + content)


def asked() -> Iterator[tuple[bytes, bytearray]]:
    """What the grader says, message by message, until it has no more to say."""
    while head := os.read(_IN, HEAD.size):
        kind, size = HEAD.unpack(head)
        content = bytearray()
        while len(content) < size:
            content += os.read(_IN, size - len(content))
        yield kind, content


def limit(seconds: int) -> None:
    """Leave this process little more than its own thoughts, for good.

    Limits of the system, where it has them: processor time, memory, length of files; on Linux,
    which files may be read (Landlock), no network and no signals to others. A hook of the
    interpreter, which gives its reasons: no processes, and no import of what simulates.
    """
    bounds = {"CPU": seconds, "FSIZE": MOST_PRINTED, "AS": MEMORY, "NPROC": 0, "CORE": 0}
    for name, bound in bounds.items():
        resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (bound, bound))
    shut_in()

    def refuse(event: str, given: tuple[Any, ...]) -> None:
        if event.startswith(STARTING):
            raise PermissionError("an answer may not start a process")
        if event == "import" and str(given[0]).startswith(CLOSED):
            raise ImportError(f"{given[0]} is the grader's: an answer may not import it")

    sys.addaudithook(refuse)


def shut_in() -> bool:
    """Let this process read Python and our packages, write in its own folder, and no more.

    Whether the system can do it: Linux of 2021 or later.
    """
    if sys.platform != "linux":
        return False
    call = ctypes.CDLL(None, use_errno=True).syscall
    version = call(444, None, ctypes.c_size_t(0), 1)
    if version < 1:
        return False
    every = (1 << {1: 13, 2: 14}.get(version, 15)) - 1
    rules = struct.pack("<QQQ", every, 3 if version >= 4 else 0, 3 if version >= 6 else 0)
    size = 24 if version >= 6 else 16 if version >= 4 else 8
    ruleset = call(444, rules, ctypes.c_size_t(size), 0)
    home = Path(twin.__file__).parent
    seen: set[str | Path] = {
        sys.prefix,
        sys.base_prefix,
        home,
        home.parent / "ballplate",
        "/usr",
        "/lib",
        "/lib64",
    }
    seen |= {
        Path(inspect.getfile(np)).parents[1],
        Path(inspect.getfile(Law)).parent,
        "/dev/urandom",
    }
    for path, rights in [
        *((each, READ_FILE | READ_FOLDER | EXECUTE) for each in seen),
        (".", every),
    ]:
        with suppress(OSError):
            place = os.open(path, os.O_PATH)
            given = rights if Path(path).is_dir() else rights & (READ_FILE | EXECUTE)
            call(445, ruleset, 1, struct.pack("<Qi", given, place), 0)
            os.close(place)
    ctypes.CDLL(None).prctl(
        38, 1, 0, 0, 0
    )  # no new privileges, without which nobody may be shut in
    return bool(call(446, ruleset, 0) == 0)


def the_law(file: Path) -> Any:
    """The one law that a file defines."""
    spec = importlib.util.spec_from_file_location("answer", file)
    assert spec is not None and spec.loader is not None  # noqa: PT018
    module = sys.modules["answer"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    every = [each for each in vars(module).values() if inspect.isclass(each)]
    found = [each for each in every if issubclass(each, Law) and each.__module__ == "answer"]
    if len(found) != 1:
        names = ", ".join(each.__name__ for each in found) or "none"
        raise TypeError(f"must define one law, a class derived from Law, defines {names}")
    return found[0]


def serve(cls: Any) -> None:
    """Say what law it is, then give a command and a rate of its memory for what is known."""
    answer(b"h", json.dumps({"memory": cls.memory, "needs": list(cls.needs)}).encode())
    for kind, content in asked():
        if kind == b"s":
            given = pickle.loads(content)  # the grader's own
            law, shapes, make = cls(model=given["model"]), given["shapes"], given["reference"]
            if problem := wrong_answer(law):
                raise TypeError(problem)
            reference = make[0](*make[1:])
            plan = law.start(given["x"], reference, given["period"])
            answer(b"k")
            continue
        time, *parts = parted(content, shapes)
        x, equivalent, needed, rate, requested, memory = parts
        now = Feedback(time, x, equivalent, needed, rate, requested, reference, memory, plan)
        u = commanded(law, law.command(now), rate) if kind == b"c" else rate
        slope = memory
        if law.memory:
            slope = remembered(law, law.memory_rate(time, equivalent, reference, memory), memory)
        answer(b"u", u.astype(float).tobytes() + np.asarray(slope, float).tobytes())


def parted(content: bytearray, shapes: list[tuple[int, ...]]) -> list[Any]:
    """A time, then arrays of some shapes, out of one row of numbers."""
    numbers = np.frombuffer(content)
    found: list[Any] = [float(numbers[0])]
    at = 1
    for shape in shapes:
        size = int(np.prod(shape))
        found.append(numbers[at : at + size].reshape(shape))
        at += size
    return found


def line_of(error: BaseException, file: Path) -> str:
    """An error in one line: file and line of the answer, kind and words."""
    words = f"{type(error).__name__}: {' '.join(str(error).split())}".replace(f"{file}", file.name)
    if isinstance(error, OSError) and error.errno == errno.EFBIG:
        words = f"it prints or writes more than {MOST_PRINTED // 1024} kB"
    if isinstance(error, SyntaxError) and error.lineno:
        return f"{file.name}, line {error.lineno}: {type(error).__name__}: {error.msg}"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.filename == str(file):
            return f"{file.name}, line {frame.lineno}: {words}"
    return words if isinstance(error, MemoryError) else f"{file.name}: {words}"


def main(file: Path, seconds: int) -> None:
    """Serve an answer until the grader has no more to ask, or it fails."""
    try:
        limit(seconds)
        serve(the_law(file))
    except BaseException as error:  # noqa: BLE001 - an answer may raise anything
        with suppress(OSError):
            answer(b"e", line_of(error, file).encode()[:1000])
    os._exit(0)


if __name__ == "__main__":
    _IN, _OUT = os.dup(0), os.dup(1)
    _printed = os.open(PRINTED, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    _nothing = os.open(os.devnull, os.O_RDONLY)
    for _number, _place in enumerate((_nothing, _printed, _printed)):
        os.dup2(_place, _number)
    main(Path(sys.argv[1]), int(sys.argv[2]))
