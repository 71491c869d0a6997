"""What a study costs beside bare physics, as ratios within one run.

Run with ``uv run python benchmarks/throughput.py``. Everything a study does in the loop is on:
friction that depends on speed, servo lag, dead time, noise, supervisor, record. The baseline is a
bare loop of ``Batch.step`` of the same model under the very same motor rates. Both run on one
thread and are told in processor time, best of several rounds that alternate between both, so that a
busy machine tells the same. What a second core brings is told by the clock on the wall.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from twin.assemble import build_controller
from twin.models import model_path
from twin.plant.mechanism import Mechanism
from twin.scenario import load
from twin.study.batch import simulate

STEPS = 2
ALL_EFFECTS = (
    "plant.friction.rolling_mm=0.18",
    "plant.friction.breakaway_ratio=1.5",
    "plant.servo.bandwidth_hz=20.0",
    "metrics.start=0.0",
)
STACKS = {
    "Luenberger": (("predictor.delay=0.0",), 85),
    "EKF and predictor": (("observer.kind=ekf",), 75),
}
"""Observer, its overrides, and the throughput in % that is aimed at."""


def closed(rigs: int, seconds: float, more: Sequence[str]) -> float:
    """Processor seconds that a batch of rigs takes for simulated seconds, set-up left out."""
    times = []
    for duration in (seconds / 4, seconds):
        given = [*ALL_EFFECTS, *more, f"duration={duration}"]
        one = load("circle", given)
        scenarios = [one.model_copy(update={"seed": seed}) for seed in range(rigs)]
        controllers = [build_controller(one)] * rigs
        begin = time.process_time()
        simulate(scenarios, controllers)
        times.append(time.process_time() - begin)
    return (times[1] - times[0]) * 4 / 3


def commands(seconds: float) -> list[NDArray[np.floating]]:
    """The motor rates of one rig of such a batch."""
    kept: list[NDArray[np.floating]] = []
    original = Mechanism.advance

    def advance(self: Mechanism, rate: NDArray[np.floating], steps: int) -> None:
        kept.append(np.array(rate))
        original(self, rate, steps)

    Mechanism.advance = advance  # type: ignore[method-assign]
    scenario = load("circle", [*ALL_EFFECTS, f"duration={seconds}"])
    simulate([scenario], [build_controller(scenario)])
    Mechanism.advance = original  # type: ignore[method-assign]
    return kept[: round(seconds / 0.002)]


def bare(rigs: int, motion: Sequence[NDArray[np.floating]]) -> float:
    """Processor seconds of a bare loop of ``Batch.step`` under the same motor rates."""
    model = mujoco.MjModel.from_xml_path(str(model_path()))
    batch = Batch(model, nsim=rigs, nthread=1)
    batch.reset(keyframe=0)
    ctrl = batch.bind("ctrl")
    begin = time.process_time()
    for rate in motion:
        ctrl[:, ::-1] = rate[0]
        batch.step(nstep=STEPS)
    return time.process_time() - begin


def job(index: int) -> float:
    """One of several equal jobs on processes side by side: when it ended."""
    closed(64, 1.0, ())
    return time.perf_counter() + 0 * index


def cores(processes: int, jobs: int) -> float:
    """Seconds that jobs take on so many processes that are already up."""
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        list(pool.map(closed, [16] * processes, [0.1] * processes, [()] * processes))
        begin = time.perf_counter()
        list(pool.map(job, range(jobs)))
        return time.perf_counter() - begin


def main() -> None:
    """Print throughput of both stacks, and what a second core brings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--rigs", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--cores", action="store_true", help="measure what two cores bring, too")
    options = parser.parse_args()
    work = options.rigs * options.seconds / 0.002
    motion = commands(options.seconds)
    for name, (more, goal) in STACKS.items():
        times = np.array(
            [
                (bare(options.rigs, motion), closed(options.rigs, options.seconds, more))
                for _ in range(options.rounds)
            ]
        )
        physics, loop = times.min(axis=0)
        print(
            f"{options.rigs} rigs, {name}: Batch.step alone {1e6 * physics / work:.1f} us a rig "
            f"and tick, study {1e6 * loop / work:.1f}: throughput {100 * physics / loop:.0f} % "
            f"(goal: at least {goal} %); a run of 25 s takes {12500 * loop / work:.2f} s"
        )
    if options.cores:
        one, two = (cores(n, 4) for n in (1, 2))
        print(f"two cores of {os.cpu_count()}: {one / two:.2f} times one (goal: at least 1.8)")


if __name__ == "__main__":
    main()
