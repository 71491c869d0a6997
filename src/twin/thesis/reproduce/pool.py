"""The jobs of a reproduction on all processors, with progress by what they cost."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence

from twin.errors import TwinError
from twin.jobs import results
from twin.thesis.reproduce.work import Finding, Job, carry_out

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
    for index, found in results(_tried, enumerate(jobs), processes):
        done += jobs[index].cost
        progress(done)
        yield from found


def _tried(job: Job) -> list[Finding]:
    """The job's findings, or one line that says which job failed."""
    try:
        return carry_out(job)
    except TwinError:
        raise
    except Exception as error:
        where = ", ".join(sorted({table for table, _ in job.places}))
        raise TwinError(f"table {where}, {job.way}: {type(error).__name__}: {error}") from error
