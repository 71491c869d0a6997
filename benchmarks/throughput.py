"""What a study costs beside bare physics, as ratios within one run.

Run with ``uv run python benchmarks/throughput.py``. Everything a study does in the loop is on:
friction that depends on speed, servo lag, dead time, noise, supervisor, record. The baseline is a
bare loop of ``Batch.step`` of the same model under the very same motor rates, best of several
rounds that alternate between both. Both run on one thread and are told in processor time, so that a
busy machine tells the same. With ``--cores`` they are also compared on all cores, ``Batch.step``
with a thread on each, the study with a process on each, by the clock, which wants a quiet machine.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

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


def study(rigs: int, seconds: float, more: Sequence[str]) -> float:
    """Simulate a batch of rigs; when it was through, on the clock that all processes share."""
    one = load("circle", [*ALL_EFFECTS, *more, f"duration={seconds}"])
    scenarios = [one.model_copy(update={"seed": seed}) for seed in range(rigs)]
    simulate(scenarios, [build_controller(one)] * rigs)
    return time.monotonic()


def closed(rigs: int, seconds: float, more: Sequence[str]) -> float:
    """Processor seconds that a batch of rigs takes for simulated seconds, set-up left out."""
    times = []
    for duration in (seconds / 4, seconds):
        begin = time.process_time()
        study(rigs, duration, more)
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


class Spent(NamedTuple):
    """Seconds a piece of work took, of all processors and on the wall."""

    processor: float
    wall: float


def bare(rigs: int, motion: Sequence[NDArray[np.floating]], threads: int = 1) -> Spent:
    """A bare loop of ``Batch.step`` under the same motor rates."""
    model = mujoco.MjModel.from_xml_path(str(model_path()))
    batch = Batch(model, nsim=rigs, nthread=threads)
    batch.reset(keyframe=0)
    ctrl = batch.bind("ctrl")
    processor, wall = time.process_time(), time.monotonic()
    for rate in motion:
        ctrl[:, ::-1] = rate[0]
        batch.step(nstep=STEPS)
    return Spent(time.process_time() - processor, time.monotonic() - wall)


def alongside(processes: int, rigs: int, seconds: float, more: Sequence[str]) -> float:
    """Seconds on the wall for a batch on each of so many processes that are already up."""

    def jobs(*each: Any) -> list[list[Any]]:
        return [[argument] * processes for argument in each]

    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        list(pool.map(study, *jobs(16, 0.1, more)))
        begin = time.monotonic()
        return max(pool.map(study, *jobs(rigs, seconds, more))) - begin


def on_all_cores(options: argparse.Namespace, motion: Sequence[NDArray[np.floating]]) -> None:
    """Print how the study compares on all cores, and what they bring it, by the clock."""
    cores = os.cpu_count() or 1
    rigs, seconds = options.rigs, options.seconds
    for name, (more, goal) in STACKS.items():
        rounds = [
            (
                bare(rigs, motion, cores).wall,
                alongside(cores, rigs, seconds, more),
                alongside(1, rigs, seconds, more),
            )
            for _ in range(options.rounds)
        ]
        physics, many, one = np.array(rounds).min(axis=0)
        print(
            f"{rigs} rigs on each of {cores} cores, {name}, set-up included: throughput "
            f"{100 * cores * physics / many:.0f} % of Batch.step on {cores} threads "
            f"(goal: at least {goal} %), {cores * one / many:.2f} times that of one core "
            f"(goal with two: at least 1.8)"
        )


def main() -> None:
    """Print throughput of both stacks, and what a second core brings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--rigs", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--cores", action="store_true", help="compare on all cores, too")
    options = parser.parse_args()
    work = options.rigs * options.seconds / 0.002
    motion = commands(options.seconds)
    for name, (more, goal) in STACKS.items():
        times = np.array(
            [
                (bare(options.rigs, motion).processor, closed(options.rigs, options.seconds, more))
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
        on_all_cores(options, motion)


if __name__ == "__main__":
    main()
