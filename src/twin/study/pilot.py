"""How long runs will take, from short ones."""

from __future__ import annotations

import json
from time import perf_counter

from twin.study.work import Job, carry_out

PILOT = (0.1, 0.5)
"""Simulated seconds of the two short batches from which the time of a study is estimated."""


def seconds(chunk: list[Job]) -> float:
    """Time per run of a chunk in s, from two short ones: set-up, and the rest by its duration.

    On a machine so busy that the longer one took no longer, all of its time counts as simulating.
    """
    carry_out([_short(chunk[0], PILOT[0])])  # what is loaded on first use is no time of a run
    times = []
    for length in PILOT:
        begin = perf_counter()
        carry_out([_short(job, length) for job in chunk])
        times.append(perf_counter() - begin)
    if times[1] <= times[0]:
        times = [0.0, times[1]]
    rate = (times[1] - times[0]) / (PILOT[1] - PILOT[0])
    whole = float(json.loads(chunk[0].scenario)["duration"])
    return (times[0] + rate * (whole - PILOT[0])) / len(chunk)


def _short(job: Job, length: float) -> Job:
    scenario = json.loads(job.scenario)
    scenario |= {"duration": length, "metrics": {"start": 0.0}}
    return job._replace(scenario=json.dumps(scenario))
