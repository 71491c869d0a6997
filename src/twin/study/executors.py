"""What carries out the generations of a search: processes that stay, or those of a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, nullcontext

from twin.jobs import cores, pool
from twin.study.cluster import Cluster


@contextmanager
def executors(
    processes: int | None, scheduler: str | None = None
) -> Iterator[tuple[Executor | None, int]]:
    """The executor that was asked for, and how many runs it carries out side by side.

    Args:
        processes: How many; None for the cores there are, or all workers of the scheduler. One is
            this process, which needs no executor.
        scheduler: Address of a Dask scheduler; None for processes of this machine.

    Raises:
        ScenarioError: If no scheduler answers there.
    """
    if scheduler is not None:
        with Cluster(scheduler) as cluster:
            yield cluster, processes or cluster.workers
        return
    count = processes or cores()
    with nullcontext() if count == 1 else pool(count) as executor:
        yield executor, count
