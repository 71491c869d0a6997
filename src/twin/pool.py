"""Independent jobs on several processes, and a clean end on Ctrl-C or a failure."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from twin.errors import TwinError

Name = TypeVar("Name")
Job = TypeVar("Job")
Result = TypeVar("Result")


def results(
    work: Callable[[Job], Result], jobs: Mapping[Name, Job], processes: int
) -> Iterator[tuple[Name, Result]]:
    """Name and result of every job, as they come.

    Args:
        work: What to do with a job; a function of a module, because it goes to other processes.
        jobs: Name to what is worked on, the longest first.
        processes: How many work side by side; 1 for this process alone.

    Raises:
        TwinError: If a job raises it, or a process is killed.
    """
    if processes == 1:
        for name, job in jobs.items():
            yield name, work(job)
        return
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, initializer=_leave_interrupts)
    try:
        waiting = {pool.submit(work, job): name for name, job in jobs.items()}
        for future in as_completed(waiting):
            yield waiting[future], future.result()
        pool.shutdown()
    except BrokenProcessPool as error:
        raise TwinError("a process of this command was killed; is there enough memory?") from error
    finally:
        # Whatever ended this early, nobody wants the rest any more.
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()


def _leave_interrupts() -> None:
    """Ctrl-C reaches every process of the terminal: let the first one end the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
