"""Carrying a study out: what is missing, in chunks, on processes here or on a cluster."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Executor
from functools import partial

import pyarrow as pa

from twin.errors import TwinError
from twin.jobs import AHEAD, cores, handed_out, results
from twin.study.store import Store
from twin.study.work import Job, Row, ScenarioRuns, Task, carry_out

LARGE = 256
"""Most runs that share a batch and are kept together: what a kill may cost, on every processor."""
TURNS = 8
"""So many chunks every processor has at least where they have more than ``CHUNK`` runs."""
CHUNK = 64
"""Runs from which on a larger batch is hardly faster."""
WHOLE = 512
"""Most runs of a batch where a kill may cost all: of 12 s each they take 0.25 GB."""
LEAST = 16
"""Fewest that are worth a batch of their own."""
MOST = 256
"""Chunks that are under way on other machines even if few workers are known: more may join."""
RETRIES = 3
"""So often a chunk is tried whose worker was lost."""

Do = Callable[[Sequence[Job]], list[Row]]


def missing(
    tasks: Sequence[Task], done: Collection[str], processes: int = 1, *, whole: bool = False
) -> list[list[Task]]:
    """The runs that are not finished, each once, in chunks of such as can share a batch.

    Chunks are smaller where there are not enough runs for every process to have one, and larger
    where there are very many. With ``whole`` they are as large as they can be with one for every
    process, up to ``WHOLE``: the fastest for runs on the exact equations, of which a kill then
    costs all.
    """
    left: dict[str, dict[str, Task]] = {}
    for task in tasks:
        if task.key not in done:
            left.setdefault(task.alike, {})[task.key] = task
    total = sum(map(len, left.values()))
    share = math.ceil(total / processes)
    most = max(LEAST, min(share, WHOLE if whole else CHUNK), min(share // TURNS, LARGE))
    chunks = []
    for alike in left.values():
        # runs under one law side by side: they are calculated together
        some = sorted(alike.values(), key=lambda task: task.variant)
        chunks += [some[i : i + most] for i in range(0, len(some), most)]
    return sorted(chunks, key=len, reverse=True)


def carry(
    work: ScenarioRuns,
    store: Store,
    *,
    executor: Executor | None = None,
    processes: int | None = None,
    do: Do | None = None,
    progress: Callable[[int, int], None] = lambda *_: None,
    whole: bool = False,
) -> pa.Table:
    """Finish all runs and return their rows, in the order of the tasks.

    Args:
        work: The runs.
        store: Where finished ones are, and are put.
        executor: Anything with the interface of ``concurrent.futures``; None for processes here.
        processes: So many of them, or of its workers; None for one a processor.
        do: What carries out a chunk in place of ``carry_out``; a function of a module, because it
            goes to other processes.
        progress: Told how many runs are finished, and how many of those did not end well.
        whole: Whether chunks are as large as can be, see ``missing``.

    Raises:
        TwinError: If a process is killed, or a chunk is lost too often.
    """
    count, do = processes or cores(), do or partial(carry_out, seen=work.seen)
    known, chunks = remaining(work.tasks, store, count, whole=whole)
    finished = known.num_rows
    failed = finished - known["outcome"].to_pylist().count("finished")
    progress(finished, failed)
    found: Iterator[list[Row]]
    if executor is None:
        jobs = enumerate(map(work.jobs, chunks))
        found = (rows for _, rows in results(do, jobs, min(count, max(1, len(chunks)))))
    else:
        found = _elsewhere(work, chunks, do, executor, max(AHEAD * count, MOST))
    for rows in found:
        store.add(rows)
        finished += len(rows)
        failed += sum(row["outcome"] != "finished" for row in rows)
        progress(finished, failed)
    return store.rows([task.key for task in work.tasks])


def remaining(
    tasks: Sequence[Task], store: Store, processes: int, *, whole: bool = False
) -> tuple[pa.Table, list[list[Task]]]:
    """The rows of the runs that are finished, each once, and the chunks that are left."""
    known = store.rows(list({task.key for task in tasks}))
    return known, missing(tasks, set(known["key"].to_pylist()), processes, whole=whole)


def _elsewhere(
    work: ScenarioRuns, chunks: Sequence[list[Task]], do: Do, executor: Executor, most: int
) -> Iterator[list[Row]]:
    left, why = list(chunks), ""
    for _ in range(RETRIES):
        lost = []
        for number, future in handed_out(executor, do, enumerate(map(work.jobs, left)), most):
            try:
                rows = future.result()
            except TwinError:
                raise
            except Exception as error:  # noqa: BLE001 - every kind of cluster loses work in its own way
                why = f"{type(error).__name__}: {error}".splitlines()[0]
                lost.append(left[number])
            else:
                yield rows
        if not lost:
            return
        left = lost
    raise TwinError(f"{len(left)} chunks of runs were lost {RETRIES} times; the last one: {why}")
