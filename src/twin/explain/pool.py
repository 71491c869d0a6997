"""Independent runs on several processes, with progress, and a clean end on Ctrl-C or a failure."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from twin.errors import TwinError

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_all(
    work: Callable[[Job], Result],
    jobs: Mapping[str, Job],
    processes: int,
    progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Result]:
    """Results by the names of the jobs.

    Args:
        work: What to do with a job; a function of a module, because it goes to other processes.
        jobs: Name to what is worked on.
        processes: How many work side by side; 1 for this process alone.
        progress: Told how many jobs are done.

    Raises:
        TwinError: If a job raises it, or a process is killed.
    """
    if processes == 1:
        done = {}
        for name, job in jobs.items():
            done[name] = work(job)
            progress(len(done))
        return done
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, initializer=_leave_interrupts)
    results: dict[str, Result] = {}
    try:
        waiting = {pool.submit(work, job): name for name, job in jobs.items()}
        for future in as_completed(waiting):
            results[waiting[future]] = future.result()
            progress(len(results))
        pool.shutdown()
    except BrokenProcessPool as error:
        raise TwinError(
            "a process was killed while it ran a case; is there enough memory?"
        ) from error
    finally:
        # Whatever ended this early, nobody wants the rest any more.
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
    return results


def _leave_interrupts() -> None:
    """Ctrl-C reaches every process of the terminal: let the first one end the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
