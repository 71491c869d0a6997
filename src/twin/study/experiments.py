"""Experiments: scenarios times points times rigs, and a table of what each run gave.

What is missing is carried out in chunks, on processes here or on a cluster; rows lie on disk in
whole files only, and no run is made twice.
"""

from __future__ import annotations

import hashlib
import logging
import math
import socket
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, TypeVar

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from twin.base.errors import RecordError, ScenarioError, TwinError, one_line, plural
from twin.base.jobs import JOBS_PER_PROCESS, cores, handed_out, pool, results
from twin.base.parts import extra
from twin.base.writing import write_whole
from twin.run.indicators import MOTION_INDICATORS
from twin.run.record import unreadable_errors
from twin.study.work import Job, Row, ScenarioRuns, StudyTask, carry_out

if TYPE_CHECKING:
    import pandas as pd


T = TypeVar("T")

CONNECT_TIMEOUT = 5.0
"""Seconds within which a scheduler must accept a connection."""
CLUSTER_TIMEOUT_S = 30.0
"""Seconds within which it must answer, and come back after it was lost."""


class Cluster(Executor):
    """Executor of calls on the workers of a scheduler.

    A scheduler that is lost and comes back within ``TIMEOUT`` gets all unfinished calls again; if
    it stays away they fail, where Dask alone would leave them waiting for ever.

    Args:
        address: Of the scheduler, as in tcp://HOST:8786.

    Attributes:
        workers: Calls that can run at the same time, as reported when connecting; 1 if the
            scheduler had no workers.

    Raises:
        TwinError: If no scheduler answers there, or the extra is not installed.
    """

    workers: int

    def __init__(self, address: str) -> None:
        with extra("cluster", "--scheduler"):
            from distributed import Client  # noqa: PLC0415
            from distributed.comm import get_address_host_port  # noqa: PLC0415
        for name in ("distributed", "distributed.client", "tornado.application"):
            # it would log every lost connection with a traceback
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            place = get_address_host_port(address, strict=True)
            socket.create_connection(place, CONNECT_TIMEOUT).close()
            self._client = _with_timeout(
                CLUSTER_TIMEOUT_S, lambda: Client(address, timeout=CLUSTER_TIMEOUT_S)
            )
            threads = _with_timeout(CLUSTER_TIMEOUT_S, self._client.nthreads)
        except Exception as error:  # anything may listen there, and say anything
            raise ScenarioError(f"--scheduler {address}: no scheduler answers there") from error
        self.workers = max(1, sum(threads.values()))
        self._address = address
        self._executor = self._client.get_executor(pure=False, retries=2)
        self._pending: set[Future[Any]] = set()
        self._closed = Event()
        Thread(target=self._watch, name="scheduler", daemon=True).start()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Submit a call to the workers.

        Raises:
            ScenarioError: If the scheduler is lost.
        """
        try:
            future: Future[T] = self._executor.submit(fn, *args, **kwargs)
        except Exception as error:
            if self._given_up:
                raise self._lost() from error
            raise
        self._pending.add(future)
        future.add_done_callback(self._pending.discard)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Disconnect from the scheduler."""
        del wait, cancel_futures
        self._closed.set()
        self._client.close()

    def _watch(self) -> None:
        """Fail all pending calls once the client has given up on the scheduler."""
        while not self._closed.wait(1.0):
            if self._given_up:
                for future in list(self._pending):
                    with suppress(InvalidStateError):
                        future.set_exception(self._lost())

    @property
    def _given_up(self) -> bool:
        return self._client.status in {"closing", "closed"}

    def _lost(self) -> ScenarioError:
        return ScenarioError(
            f"--scheduler {self._address}: lost, and not back within {CLUSTER_TIMEOUT_S:g} s; "
            "the same command goes on from here"
        )


def _with_timeout(seconds: float, make: Callable[[], T]) -> T:
    """Result of a call in a separate thread, since Dask waits for ever for a silent scheduler.

    Raises:
        TimeoutError: If it takes longer.
    """
    made: Future[T] = Future()

    def work() -> None:
        try:
            made.set_result(make())
        except Exception as error:  # noqa: BLE001 - passed on to the waiting thread
            made.set_exception(error)

    Thread(target=work, name="connect", daemon=True).start()
    return made.result(seconds)


ROW_SCHEMA = pa.schema(
    [
        ("key", pa.string()),
        ("outcome", pa.string()),
        ("reason", pa.string()),
        *((name, pa.float64()) for name in MOTION_INDICATORS),
    ]
)


class Store:
    """The finished runs in a folder, one file a chunk, named by what is in it.

    A file is written under a temporary name and renamed, so that a killed study leaves whole chunks
    or none; what is in no file is run again.

    Args:
        folder: Where; made for the first chunk. None keeps them in memory alone.

    Raises:
        RecordError: If it cannot be read.
    """

    def __init__(self, folder: Path | None) -> None:
        self._chunks: list[pa.Table] = []
        self.folder = None if folder is None else folder / "chunks"
        if self.folder is None:
            return
        if self.folder.exists() and not self.folder.is_dir():
            raise RecordError(f"{self.folder}: is no folder")
        self._chunks = [_read(path) for path in sorted(self.folder.glob("[!.]*.parquet"))]

    def add(self, rows: Sequence[Row]) -> None:
        """Keep a chunk of finished runs."""
        name = hashlib.sha256("".join(row["key"] for row in rows).encode()).hexdigest()[:32]
        table = pa.Table.from_pylist(list(rows), ROW_SCHEMA)
        if self.folder is not None:
            write_whole(self.folder / f"{name}.parquet", lambda path: pq.write_table(table, path))
        self._chunks.append(table)

    def __str__(self) -> str:
        """The number of runs that the same command need not repeat, for a person who ends it."""
        kept = 0 if self.folder is None else sum(chunk.num_rows for chunk in self._chunks)
        return (
            f"runs kept: {kept}; the same command goes on from there" if kept else "runs kept: none"
        )

    def rows(self, keys: Sequence[str]) -> pa.Table:
        """The runs with these keys, in their order; those that are not finished are left out."""
        kept = pa.concat_tables([ROW_SCHEMA.empty_table(), *self._chunks])
        places = pc.index_in(pa.array(keys, pa.string()), kept["key"].combine_chunks())
        return kept.take(places.drop_null())


def _read(path: Path) -> pa.Table:
    try:
        table = pq.read_table(path)
    except unreadable_errors() as error:
        raise RecordError(f"{path}: not a readable chunk; delete it: {one_line(error)}") from error
    if table.schema != ROW_SCHEMA or table["key"].null_count or table["outcome"].null_count:
        raise RecordError(
            f"{path}: from another version, or damaged; delete it, or give another --out"
        )
    return table


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


MAX_BATCH_RUNS = 256
"""Most runs that share a batch and are kept together: what a kill may cost, on every processor."""
MIN_CHUNKS_PER_PROCESS = 8
"""So many chunks every processor has at least where they have more than ``CHUNK`` runs."""
CHUNK_RUNS = 64
"""Number of runs above which a larger batch is hardly faster."""
MAX_UNKEPT_RUNS = 512
"""Most runs of a batch where a kill may cost all: of 12 s each they take 0.25 GB."""
MIN_BATCH_RUNS = 16
"""Fewest that are worth a batch of their own."""
MAX_PENDING_CHUNKS = 256
"""Chunks that are under way on other machines even if few workers are known: more may join."""
MAX_RETRIES = 3
"""Number of times that a chunk is tried again after its worker was lost."""

Do = Callable[[Sequence[Job]], list[Row]]


def missing(
    tasks: Sequence[StudyTask], done: Collection[str], processes: int = 1, *, whole: bool = False
) -> list[list[StudyTask]]:
    """The runs that are not finished, each once, in chunks of such as can share a batch.

    Chunks are smaller where there are not enough runs for every process to have one, and larger
    where there are very many. With ``whole`` they are as large as they can be with one for every
    process, up to ``WHOLE``: the fastest for runs on the exact equations, of which a kill then
    costs all.
    """
    left: dict[str, dict[str, StudyTask]] = {}
    for task in tasks:
        if task.key not in done:
            left.setdefault(task.alike, {})[task.key] = task
    total = sum(map(len, left.values()))
    share = math.ceil(total / processes)
    most = max(
        MIN_BATCH_RUNS,
        min(share, MAX_UNKEPT_RUNS if whole else CHUNK_RUNS),
        min(share // MIN_CHUNKS_PER_PROCESS, MAX_BATCH_RUNS),
    )
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
        progress: Called with the number of finished runs, and how many of those did not end well.
        whole: Whether chunks are as large as can be, see ``missing``.

    Raises:
        TwinError: If a process is killed, or a chunk is lost too often.
        KeyboardInterrupt: If the user interrupts; its message has how much is kept.
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
        found = _elsewhere(
            work, chunks, do, executor, max(JOBS_PER_PROCESS * count, MAX_PENDING_CHUNKS)
        )
    try:
        for rows in found:
            store.add(rows)
            finished += len(rows)
            failed += sum(row["outcome"] != "finished" for row in rows)
            progress(finished, failed)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(str(store)) from None
    return store.rows([task.key for task in work.tasks])


def remaining(
    tasks: Sequence[StudyTask], store: Store, processes: int, *, whole: bool = False
) -> tuple[pa.Table, list[list[StudyTask]]]:
    """The rows of the runs that are finished, each once, and the chunks that are left."""
    known = store.rows(list({task.key for task in tasks}))
    return known, missing(tasks, set(known["key"].to_pylist()), processes, whole=whole)


def _elsewhere(
    work: ScenarioRuns, chunks: Sequence[list[StudyTask]], do: Do, executor: Executor, most: int
) -> Iterator[list[Row]]:
    left, why = list(chunks), ""
    for _ in range(MAX_RETRIES):
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
    raise TwinError(
        f"{plural(len(left), 'chunk')} of runs lost {plural(MAX_RETRIES, 'time')}; the last one: "
        f"{why}"
    )


def evaluate(
    runs: ScenarioRuns, labels: Mapping[str, Any], store: Store, **how: Any
) -> pd.DataFrame:
    """Finish runs: a row for each, with its labels, outcome, reason and every indicator.

    Args:
        runs: What to run.
        labels: Columns that tell what each run is, as its candidate, task and rig.
        store: Where finished ones are, and are put.
        how: Who carries them out, and how, as for ``carry``.

    Raises:
        TwinError: If a process is killed, or a chunk of runs is lost too often.
    """
    return label_rows(labels, carry(runs, store, **how)).to_pandas()


def label_rows(labels: Mapping[str, Any], rows: pa.Table) -> pa.Table:
    """Rows of runs behind their labels, without their keys."""
    return pa.table({**labels, **{name: rows[name] for name in rows.column_names if name != "key"}})
