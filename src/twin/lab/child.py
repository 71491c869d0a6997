"""What runs in a student's process: limits first, then their file, then one answer a period.

Run by its path, with the answer's file and the seconds of a processor it may use as arguments. It
is told on standard input and answers on what was its standard output; what the answer prints goes
to a file. Nothing of a rig but measurements and estimates comes in here, and nothing but numbers
and texts goes out.
"""

from __future__ import annotations

import ctypes
import errno
import inspect
import json
import os
import pickle
import resource
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    # a name would be looked for in the folder of this file first
    sys.path.insert(0, str(Path(__file__).parents[2]))

import numpy as np

import twin
from controllers import catalog
from controllers.interfaces import Feedback, Law

MOST_PRINTED = 256 * 1024
"""Bytes an answer may print or write."""
MEMORY = 2 * 1024**3
"""Bytes of address space."""
CLOSED = ("mujoco", "twin.sim", "twin.lab", "twin.hal", "twin.devices", "twin.emulator")
STARTING = ("os.fork", "os.exec", "os.posix_spawn", "os.system", "subprocess.", "pty.spawn")
READ_FILE, READ_FOLDER, EXECUTE = 1 << 2, 1 << 3, 1 << 0
"""Rights of Landlock (linux/landlock.h)."""


def say(**what: Any) -> None:
    """Tell the grader something: a line of JSON, in which a number keeps its bits."""
    os.write(_OUT, json.dumps(what).encode() + b"\n")


def asked() -> Iterator[list[Any]]:
    """What the grader asks, one after the other, until it has no more to ask."""
    with suppress(EOFError), open(_IN, "rb") as grader:  # noqa: PTH123  no path
        while True:
            yield pickle.load(grader)


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
    libc = ctypes.CDLL(None, use_errno=True)
    version = libc.syscall(444, None, ctypes.c_size_t(0), 1)
    if version < 1:
        return False
    every = (1 << {1: 13, 2: 14}.get(version, 15)) - 1
    # a system that knows fewer rights takes zeros for those to come
    rules = struct.pack("<QQQ", every, 3 if version >= 4 else 0, 3 if version >= 6 else 0)
    ruleset = libc.syscall(444, rules, ctypes.c_size_t(len(rules)), 0)
    home, packages = Path(twin.__file__).parent, Path(np.__file__).parents[1]
    ours = (home, home.parent / "ballplate", Path(inspect.getfile(Law)).parent, packages)
    theirs = (sys.prefix, sys.base_prefix, "/usr", "/lib", "/lib64", "/dev/urandom")
    seen = dict.fromkeys(map(str, (*ours, *theirs)), READ_FILE | READ_FOLDER | EXECUTE)
    for path, rights in {**seen, ".": every}.items():
        with suppress(OSError):
            place = os.open(path, os.O_PATH)
            given = rights if Path(path).is_dir() else rights & (READ_FILE | EXECUTE)
            libc.syscall(445, ruleset, 1, struct.pack("<Qi", given, place), 0)
            os.close(place)
    libc.prctl(38, 1, 0, 0, 0)  # no new privileges, without which nobody may be shut in
    return bool(libc.syscall(446, ruleset, 0) == 0)


def the_law(file: Path) -> Any:
    """The one law that a file defines."""
    module = catalog._imported(file)
    every = [each for each in vars(module).values() if inspect.isclass(each)]
    found = [each for each in every if issubclass(each, Law) and each.__module__ == module.__name__]
    if len(found) != 1:
        names = ", ".join(each.__name__ for each in found) or "none"
        raise TypeError(f"must define one law, a class derived from Law, defines {names}")
    return found[0]


def serve(cls: Any) -> None:
    """Say what law it is, then answer what the grader asks of it."""
    say(memory=cls.memory, needs=cls.needs)
    for what, *given in asked():
        if what == "start":
            model, x, (make, *made_of), period = given
            law, reference = cls(model=model), make(*made_of)
            if problem := catalog.wrong_answer(law):
                raise TypeError(problem)
            plan = law.start(x, reference, period)
            say(answer=[])
            continue
        time, *seen, memory = given
        found, x = [], seen[0]
        if what == "command":
            now = Feedback._make((time, *seen, reference, memory, plan))
            found, x = [catalog.commanded(law, law.command(now), now.rate)], now.equivalent
        if law.memory:
            slope = law.memory_rate(time, x, reference, memory)
            found.append(catalog.remembered(law, slope, memory))
        say(answer=np.concatenate(found, axis=-1).tolist())


def line_of(error: BaseException, file: Path) -> str:
    """An error in one line: file and line of the answer, kind and words."""
    if isinstance(error, OSError) and error.errno == errno.EFBIG:
        words = f"it prints or writes more than {MOST_PRINTED // 1024} kB"
        error = OSError(words).with_traceback(error.__traceback__)
    line = catalog._line(error, {str(file)}) or f"{file}: {catalog._words(error)}"
    return line.replace(str(file), file.name)[:1000]


def main(file: Path, seconds: int) -> None:
    """Serve an answer until the grader has no more to ask, or it fails."""
    try:
        limit(seconds)
        serve(the_law(file))
    except BaseException as error:  # noqa: BLE001 - an answer may raise anything
        with suppress(OSError):
            say(error=line_of(error, file))
    os._exit(0)


if __name__ == "__main__":
    # what it prints goes where its errors do, what it reads is nothing
    _IN, _OUT = os.dup(0), os.dup(1)
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    main(Path(sys.argv[1]), int(sys.argv[2]))
