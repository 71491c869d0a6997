"""Jobs on all processors, with progress, and a clean end when one fails or the user has enough."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from twin.errors import TwinError
from twin.reproduce.work import Finding, Job, carry_out

WORTH_PROCESSES = 15.0
"""Seconds of work from which starting further processes saves time."""
MOST_PROCESSES = 8


def findings(
    jobs: Sequence[Job], processes: int | None = None, progress: Callable[[float], None] = print
) -> Iterator[Finding]:
    """Carry the jobs out and hand over what they found, as it comes.

    Args:
        jobs: What to do, the longest first.
        processes: On how many processors; None for all, or for one if there is little to do.
        progress: Told the cost of what is done so far.

    Raises:
        TwinError: If a job fails.
    """
    total = sum(job.cost for job in jobs)
    if processes is None:
        few = total < WORTH_PROCESSES
        processes = 1 if few else min(os.cpu_count() or 1, MOST_PROCESSES, len(jobs))
    done = 0.0
    for job, found in _one_by_one(jobs) if processes == 1 else _in_parallel(jobs, processes):
        done += job.cost
        progress(done)
        yield from found


def _one_by_one(jobs: Sequence[Job]) -> Iterator[tuple[Job, list[Finding]]]:
    for job in jobs:
        yield job, _tried(job)


def _in_parallel(jobs: Sequence[Job], processes: int) -> Iterator[tuple[Job, list[Finding]]]:
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, initializer=_leave_interrupts)
    try:
        waiting = {pool.submit(_tried, job): job for job in jobs}
        for future in as_completed(waiting):
            yield waiting[future], future.result()
        pool.shutdown()
    except BrokenProcessPool as error:
        raise TwinError(
            "a process of the reproduction was killed; is there enough memory?"
        ) from error
    finally:
        # Whatever ended this early, nobody wants the rest any more.
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()


def _leave_interrupts() -> None:
    """Ctrl-C reaches every process of the terminal: let the first one end the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _tried(job: Job) -> list[Finding]:
    """The job's findings, or one line that says which job failed."""
    try:
        return carry_out(job)
    except TwinError:
        raise
    except Exception as error:
        where = ", ".join(sorted({table for table, _ in job.places}))
        raise TwinError(f"table {where}, {job.way}: {type(error).__name__}: {error}") from error
