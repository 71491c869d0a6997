"""Independent jobs on several processes, and a clean end on Ctrl-C or a failure."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path
from runpy import run_path
from threading import Thread
from types import ModuleType
from typing import Any, TypeVar

from twin.base.errors import TwinError

Name = TypeVar("Name")
Job = TypeVar("Job")
Result = TypeVar("Result")


WORKER_FILE = Path(__file__).with_name("worker.py")
PARENT_CHECK_INTERVAL_S = 0.5
"""Seconds between two looks whether the process that began this one is still there."""
JOBS_PER_PROCESS = 2
"""Jobs handed out for each process, so that none waits for its next one."""
_TERMINATION_SIGNALS = {
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
}


def results(
    work: Callable[[Job], Result], jobs: Iterable[tuple[Name, Job]], processes: int
) -> Iterator[tuple[Name, Result]]:
    """Name and result of every job, as they come.

    Args:
        work: What to do with a job; a function of a module, because it goes to other processes.
        jobs: Name and what is worked on, the longest first; taken as processes become free.
        processes: How many work side by side; 1 for this process alone.

    Raises:
        TwinError: If a job raises it, or a process is killed.
    """
    if processes == 1:
        for name, job in jobs:
            yield name, work(job)
        return
    try:
        with pool(processes) as executor:
            for name, future in handed_out(executor, work, jobs, JOBS_PER_PROCESS * processes):
                yield name, future.result()
            executor.shutdown()
    except BrokenProcessPool as error:
        raise TwinError(
            "a process of this command was killed, perhaps for lack of memory; use fewer processes"
        ) from error


class SecondProcess:
    """A process that works in parallel to this one; leaving the context ends it at once.

    What cannot be done there, because there is none or it was killed, is done here instead when
    its result is asked for.

    Args:
        wanted: Whether to have one.

    Attributes:
        there: Whether there is one.
    """

    def __init__(self, *, wanted: bool) -> None:
        self.there = wanted
        self._ends = ExitStack()

    def __enter__(self) -> SecondProcess:
        """Have the process; it starts with its first work."""
        self._pool = self._ends.enter_context(pool(1)) if self.there else None
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self._ends.close()

    def begin(self, work: Callable[..., Result], *given: Any) -> Callable[[], Result]:
        """Begin some work after what was begun before; what is returned waits for its result.

        Args:
            work: A function of a module.
            given: Its arguments.
        """
        here = partial(work, *given)
        if self._pool is None:
            return here
        try:
            future = self._pool.submit(work, *given)
        except (BrokenProcessPool, OSError):
            return here

        def result() -> Result:
            try:
                return future.result()
            except BrokenProcessPool:
                return here()

        return result


def cores() -> int:
    """Processors that this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)  # systems other than Linux have none
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def handed_out(
    executor: Executor,
    work: Callable[[Job], Result],
    jobs: Iterable[tuple[Name, Job]],
    most: int,
) -> Iterator[tuple[Name, Future[Result]]]:
    """Every job's name and finished future, as they come; never more of them at a time.

    Args:
        executor: Who works.
        work: What to do with a job.
        jobs: Name and what is worked on; the next one is taken when it can be handed out.
        most: Jobs under way at a time.
    """
    waiting: dict[Future[Result], Name] = {}

    def finished() -> Iterator[tuple[Name, Future[Result]]]:
        for future in wait(waiting, return_when=FIRST_COMPLETED).done:
            yield waiting.pop(future), future

    for name, job in jobs:
        waiting[executor.submit(work, job)] = name
        while len(waiting) >= most:
            yield from finished()
    while waiting:
        yield from finished()


class _Pool(ProcessPoolExecutor):
    """Processes that Ctrl-C, which reaches all of a terminal, leaves to the one that began them.

    They do not run the program again that began them, as processes of Python do: what they work on
    lies in modules, and a script needs no guard ``if __name__ == "__main__"``. Where that is safe
    they are forks, which have what this process has imported.
    """

    def __init__(self, processes: int, method: str) -> None:
        context = multiprocessing.get_context(method)
        super().__init__(processes, context, run_path, (str(WORKER_FILE),))
        self._forks = method == "fork"

    def submit(self, work: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Hand out some work; starts a process if all are busy."""
        with program_left_out(), ignore_interrupts(*_TERMINATION_SIGNALS, forks=self._forks):
            return super().submit(work, *args, **kwargs)


@contextmanager
def ignore_interrupts(*more: signal.Signals, forks: bool = False) -> Iterator[None]:
    """Ctrl-C and more signals leave alone what is begun within, even before it runs a line.

    Args:
        more: Further signals.
        forks: Whether it is a fork of this process.
    """
    if sys.platform == "win32":
        yield
        return
    if not forks:
        start_resource_tracker()  # when it is started, it lets Ctrl-C through again
    # a process keeps the mask it is started with
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *more})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


TRACKER_FILTER = "ignore:resource_tracker:UserWarning"
"""Filter of warnings of Python's process that removes shared memory: of those it left behind."""


def start_resource_tracker() -> None:
    """Start Python's process that removes the shared memory of a killed one, without a word of it.

    Windows has none, and needs none.
    """
    if sys.platform == "win32":
        return
    sys.warnoptions.append(TRACKER_FILTER)  # it is started with them
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions.remove(TRACKER_FILTER)


@contextmanager
def program_left_out() -> Iterator[None]:
    """A process begun within does not run the program again that began this one."""
    program = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = program


def spawn(work: Callable[..., None], *given: Any, daemon: bool = True) -> BaseProcess:
    """A process of its own that has begun with some work, and that Ctrl-C leaves alone.

    Args:
        work: Called there.
        given: What with.
        daemon: Whether it ends with this process; it can then begin none itself.
    """
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=work, args=given, daemon=daemon)
    with ignore_interrupts(), program_left_out():
        process.start()
    return process


@contextmanager
def pool(processes: int) -> Iterator[_Pool]:
    """Processes that end, whatever they are at, when this context is left."""
    before = set(multiprocessing.active_children())
    # a fork imports nothing anew; it is safe on Linux, where there is no thread but this one
    alone = sys.platform == "linux" and len(list(Path("/proc/self/task").iterdir())) == 1
    executor = _Pool(processes, "fork" if alone else "spawn")
    try:
        yield executor
    finally:
        # whatever ended this early, nobody wants the rest any more
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        # its thread must have ended: at the end of the program Python wakes one that is ending, and
        # may then write to a pipe that it has closed
        executor.shutdown(cancel_futures=True)


def let_go(process: BaseProcess) -> None:
    """End a process, whatever it does, and let go of it.

    Args:
        process: May have ended before; it is killed a second after it was asked to end.
    """
    if process.is_alive():
        process.terminate()
        process.join(1.0)
    if process.is_alive():
        process.kill()
        process.join()
    process.close()


def settle() -> None:
    """Leave Ctrl-C to the parent process; end on its request or when it has died."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in _TERMINATION_SIGNALS:  # a fork has what the process that began it does on them
        signal.signal(number, signal.SIG_DFL)
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _TERMINATION_SIGNALS)
    Thread(target=_end_with_parent, daemon=True).start()


def is_orphan() -> bool:
    """Whether the parent process has ended, also if that was before the first line here."""
    parent = multiprocessing.parent_process()
    # a forked process itself holds open what would tell it of its parent's end
    return parent is not None and os.getppid() != parent.pid


def wait_until(done: Callable[[], bool], limit: float, every: float = 0.005) -> bool:
    """Look again and again whether something is done, for a time in s at most; whether it is.

    Args:
        done: Returns whether it is done.
        limit: Longest time, s.
        every: From one look to the next, s.
    """
    end = time.monotonic() + limit
    while not (found := done()) and time.monotonic() < end:
        time.sleep(every)
    return found


def _end_with_parent() -> None:
    if sys.platform == "win32" and (parent := multiprocessing.parent_process()):
        parent.join()
    while not is_orphan():
        time.sleep(PARENT_CHECK_INTERVAL_S)
    os._exit(1)
