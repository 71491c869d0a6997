"""Runs of a study in an hour of one core: the first chunk of the shipped study ``tournament``.

As it would be handed out, in this process; told in processor time, set-up and evaluation of the
runs included.
"""

from __future__ import annotations

import time

from twin.study.experiments import missing
from twin.study.schema import read
from twin.study.work import Work, carry_out

SECONDS = 16.0
"""How long each run of the study lasts."""


def runs_per_hour(*given: str) -> float:
    """Runs that are carried out in an hour of one core, with further settings of all."""
    study = read("tournament")
    fixed = (*study.set, f"duration={SECONDS}", f"metrics.start={SECONDS / 2}", *given)
    work = Work(study.model_copy(update={"set": fixed}))
    jobs = work.jobs(missing(work.tasks, (), 2)[0])
    begin = time.process_time()
    rows = carry_out(jobs)
    spent = time.process_time() - begin
    assert all(row["outcome"] == "finished" for row in rows), rows
    return 3600 * len(jobs) / spent


def most(rounds: int) -> tuple[float, float]:
    """The most runs an hour of several turns, and the same at a step of 1 ms."""
    turns = [(runs_per_hour(), runs_per_hour("plant.step=0.001")) for _ in range(rounds)]
    now, fine = map(max, zip(*turns, strict=True))
    return now, fine
