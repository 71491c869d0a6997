"""How long runs will take, from short ones."""

from __future__ import annotations

import json
from time import perf_counter

from twin.study.work import Job, carry_out

PILOT = (0.1, 0.5)
"""Simulated seconds of the two short batches from which the time of a study is estimated."""


def seconds(chunk: list[Job]) -> float:
    """Time per run of a chunk in s, from two short ones: set-up, and the rest by its duration."""
    times = []
    for length in PILOT:
        begin = perf_counter()
        carry_out([_short(job, length) for job in chunk])
        times.append(perf_counter() - begin)
    # on a busy machine the longer one may take less
    rate = max(times[1] - times[0], 0.0) / (PILOT[1] - PILOT[0])
    whole = float(json.loads(chunk[0].scenario)["duration"])
    return (times[0] + rate * (whole - PILOT[0])) / len(chunk)


def _short(job: Job, length: float) -> Job:
    scenario = json.loads(job.scenario)
    scenario |= {"duration": length, "metrics": {"start": 0.0}}
    return job._replace(scenario=json.dumps(scenario))
