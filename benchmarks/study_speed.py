"""Runs of a study in an hour of one core, and how many times those of an earlier checkout.

    git worktree add ../before 95b7a20 && (cd ../before && uv sync)
    uv run python -m benchmarks --only study --before ../before

The first chunk of the shipped study ``tournament``, as it would be handed out, in one process each,
turn by turn; told in processor time, set-up and evaluation of the runs included. Each has as many
threads of linear algebra as its own commands give it: one here, all that there are before.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

PIECE = """
import sys, time
try:
    from twin.study.experiments import missing
except ImportError:  # an earlier checkout
    from twin.study.carry import missing
from twin.study.schema import read
from twin.study.work import Work, carry_out

seconds = sys.argv[1]
study = read("tournament")
given = (*study.set, f"duration={seconds}", f"metrics.start={float(seconds) / 2}")
work = Work(study.model_copy(update={"set": given + tuple(sys.argv[2:])}))
jobs = work.jobs(missing(work.tasks, (), 2)[0])
begin = time.process_time()
rows = carry_out(jobs)
spent = time.process_time() - begin
assert all(row["outcome"] == "finished" for row in rows), rows
print(3600 * len(jobs) / spent)
"""
"""What both checkouts carry out."""
SECONDS = 16.0
"""How long each run of the study lasts."""


def runs_per_hour(python: str, folder: Path, *given: str) -> float:
    """Runs that a checkout carries out in an hour of one core.

    Args:
        python: Its interpreter.
        folder: The checkout.
        given: Further settings of all runs.
    """
    command = (python, "-c", PIECE, str(SECONDS), *given)
    own = folder == Path(__file__).parent.parent
    threads = {"OPENBLAS_NUM_THREADS": "1"} if own else {}
    others = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    found = subprocess.run(
        command, cwd=folder, env=others | threads, capture_output=True, text=True, check=True
    )
    return float(found.stdout)


def most(before: Path | None, rounds: int) -> list[float]:
    """The most runs an hour of several turns: here, at a step of 1 ms, and of an earlier checkout.

    Args:
        before: That checkout, with its environment; without one the list ends before it.
        rounds: How often each has its turn.
    """
    here = Path(__file__).parent.parent
    turns = [(sys.executable, here), (sys.executable, here, "plant.step=0.001")]
    if before is not None:
        turns.append((str((before / ".venv" / "bin" / "python").absolute()), before))
    found = [
        [runs_per_hour(python, folder, *given) for python, folder, *given in turns]
        for _ in range(rounds)
    ]
    return np.max(found, axis=0).tolist()
