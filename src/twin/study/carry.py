"""Carrying a study out: what is missing, in chunks, on processes here or on a cluster."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Executor, as_completed

from twin.errors import TwinError
from twin.pool import results
from twin.study.store import Store
from twin.study.work import Row, Task, carry_out

LARGE = 256
"""Most runs that share a batch and are kept together: what a kill may cost, on every processor."""
TURNS = 8
"""So many chunks every processor has at least where they have more than ``CHUNK`` runs."""
CHUNK = 64
"""Runs from which on a larger batch is hardly faster."""
LEAST = 16
"""Fewest that are worth a batch of their own."""
RETRIES = 3
"""So often a chunk is tried whose worker was lost."""

Work = Callable[[Sequence[Task]], list[Row]]


def missing(tasks: Sequence[Task], done: Collection[str], processes: int = 1) -> list[list[Task]]:
    """The runs that are not finished, each once, in chunks of such as can share a batch.

    Chunks are smaller where there are not enough runs for every process to have one, and larger
    where there are very many.
    """
    left: dict[str, dict[str, Task]] = {}
    for task in tasks:
        if task.key not in done:
            left.setdefault(task.alike, {})[task.key] = task
    total = sum(map(len, left.values()))
    share = math.ceil(total / processes)
    most = max(LEAST, min(share, CHUNK), min(share // TURNS, LARGE))
    chunks = []
    for alike in left.values():
        # runs under one law side by side: they are calculated together
        some = sorted(alike.values(), key=lambda task: task.variant)
        chunks += [some[i : i + most] for i in range(0, len(some), most)]
    return sorted(chunks, key=len, reverse=True)


def carry(
    tasks: Sequence[Task],
    store: Store,
    *,
    executor: Executor | None = None,
    processes: int | None = None,
    work: Work = carry_out,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> dict[str, Row]:
    """Finish all runs and return their rows by key.

    Args:
        tasks: The runs.
        store: Where finished ones are, and are put.
        executor: Anything with the interface of ``concurrent.futures``; None for processes here.
        processes: So many of them, or of its workers; None for one a processor.
        work: What carries out a chunk; a function of a module, because it goes to other processes.
        progress: Told how many runs are finished, and how many of those did not end well.

    Raises:
        TwinError: If a process is killed, or a chunk is lost too often.
    """
    done = store.rows
    wanted = {task.key for task in tasks}
    count = processes or os.cpu_count() or 1
    chunks = missing(tasks, done, count)
    finished = len(wanted & done.keys())
    failed = sum(done[key]["outcome"] != "finished" for key in wanted & done.keys())
    progress(finished, failed)
    found = _here(chunks, work, count) if executor is None else _elsewhere(chunks, work, executor)
    for rows in found:
        store.add(rows)
        finished += len(rows)
        failed += sum(row["outcome"] != "finished" for row in rows)
        progress(finished, failed)
    return {key: done[key] for key in wanted}


def _here(chunks: Sequence[list[Task]], work: Work, processes: int) -> Iterator[list[Row]]:
    jobs = dict(enumerate(chunks))
    return (rows for _, rows in results(work, jobs, min(processes, max(1, len(jobs)))))


def _elsewhere(chunks: Sequence[list[Task]], work: Work, executor: Executor) -> Iterator[list[Row]]:
    left, why = list(chunks), ""
    for _ in range(RETRIES):
        waiting = {executor.submit(work, chunk): chunk for chunk in left}
        left = []
        for future in as_completed(waiting):
            try:
                rows = future.result()
            except TwinError:
                raise
            except Exception as error:  # noqa: BLE001 - every kind of cluster loses work in its own way
                why = f"{type(error).__name__}: {error}".splitlines()[0]
                left.append(waiting[future])
            else:
                yield rows
        if not left:
            return
    raise TwinError(f"{len(left)} chunks of runs were lost {RETRIES} times; the last one: {why}")
