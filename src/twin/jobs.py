"""Independent jobs on several processes, and a clean end on Ctrl-C or a failure."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from twin.errors import TwinError

Name = TypeVar("Name")
Job = TypeVar("Job")
Result = TypeVar("Result")


AHEAD = 2
"""Jobs handed out for each process, so that none waits for its next one."""


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
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, initializer=_leave_interrupts)
    try:
        for name, future in handed_out(pool, work, jobs, AHEAD * processes):
            yield name, future.result()
        pool.shutdown()
    except BrokenProcessPool as error:
        raise TwinError("a process of this command was killed; is there enough memory?") from error
    finally:
        # Whatever ended this early, nobody wants the rest any more.
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()


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


def _leave_interrupts() -> None:
    """Ctrl-C reaches every process of the terminal: let the first one end the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
