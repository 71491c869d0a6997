"""What a study costs beside its runs: time and memory of the process that hands them out.

Run with ``uv run python -m benchmarks.bookkeeping``. The shipped study ``what_matters`` goes
through the whole pipeline with made-up rows in the place of the twin, in two sizes; the difference
leaves out what does not depend on the number of runs.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from twin.study.answers import answers
from twin.study.carry import carry
from twin.study.report import write
from twin.study.schema import METRICS, read
from twin.study.store import Store
from twin.study.work import Job, Row, Work

KIB = 1 if sys.platform == "darwin" else 1024
"""Bytes of the unit in which the system gives a process's largest size."""


class Cost(NamedTuple):
    """Of a study of so many runs: s to check them, s to hand out and keep, bytes in each stage."""

    runs: int
    checking: float
    handing_out: float
    held: int
    carrying: int
    telling: int
    disk: int


def made_up(jobs: Sequence[Job]) -> list[Row]:
    """Rows that differ, made without a simulation."""
    return [
        {"key": job.key, "outcome": "finished", "reason": ""}
        | {name: int(job.key[i : i + 6], 16) / 2**24 for i, name in enumerate(METRICS)}
        for job in jobs
    ]


def largest() -> int:
    """Most memory this process had so far, in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KIB


def cost(samples: int) -> Cost:
    """Take a study with so many base samples through the pipeline."""
    about = read("what_matters", samples=samples)
    begin = time.perf_counter()
    work = Work(about)
    checking, held = time.perf_counter() - begin, largest()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begin = time.perf_counter()
        rows = carry(work, Store(folder), processes=1, do=made_up)
        handing_out, carrying = time.perf_counter() - begin, largest()
        write(work, rows, answers(work, rows), folder)
        disk = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return Cost(len(work.tasks), checking, handing_out, held, carrying, largest(), disk)


def main() -> None:
    """Print what one more run costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=4096, help="of the larger study [4096]")
    samples = parser.parse_args().samples
    found = []
    for each in (samples // 8, samples):
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:  # its size is its own
            found.append(pool.submit(cost, each).result())
    small, large = found
    runs = large.runs - small.runs
    more = Cost(*(b - a for a, b in zip(small, large, strict=True)))
    print(f"{large.runs} and {small.runs} runs; one more costs:")
    print(f"{1e3 * more.checking / runs:.2f} ms to check, before the first is handed out")
    print(f"{1e3 * more.handing_out / runs:.2f} ms to hand out and keep")
    print(f"{more.held / runs:.0f} bytes of memory from then on")
    print(f"{more.carrying / runs:.0f} bytes at most until all are finished")
    print(f"{more.telling / runs:.0f} bytes at most until the report is written")
    print(f"{more.disk / runs:.0f} bytes on disk")


if __name__ == "__main__":
    main()
