"""What a study costs beside bare physics, as ratios within one run.

Run with ``uv run python benchmarks/throughput.py``. Everything a study does in the loop is on:
friction that depends on speed, servo lag, dead time, noise, supervisor, record. The baseline is a
bare loop of ``Batch.step`` of the same model under the very motor rates of the study. Both take
turns every 25 ticks on one thread and are told in processor time, so that a machine whose speed
varies tells the same; set-up and evaluation, once a run, are told apart. With ``--cores`` as many
processes as there are cores do that at the same time, told by the clock, which wants a quiet
machine.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Self

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
TURN = 25
"""Control ticks of a turn."""
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


class Turns:
    """Lets bare physics take turns with a study that runs in this process.

    Args:
        rigs: Rigs of the study.
        clock: Tells seconds.
    """

    def __init__(self, rigs: int, clock: Callable[[], float]) -> None:
        self.studied: list[float] = []
        """Seconds of each turn of the study."""
        self.bare: list[float] = []
        """Seconds of ``Batch.step`` under the same motor rates."""
        self._clock = clock
        self._turn: list[NDArray[np.floating]] = []
        model = mujoco.MjModel.from_xml_path(str(model_path()))
        self._batch = Batch(model, nsim=rigs, nthread=1)
        self._batch.reset(keyframe=0)
        self._ctrl = self._batch.bind("ctrl")
        self._begin = 0.0

    def __enter__(self) -> Self:
        self._advance = advance = Mechanism.advance

        def take_turns(plant: Mechanism, rate: NDArray[np.floating], steps: int) -> None:
            if len(self._turn) == TURN:
                self._physics()
            if not self._turn:
                self._begin = self._clock()
            self._turn.append(np.array(np.broadcast_to(rate, (plant.rigs, 2))))
            advance(plant, rate, steps)

        Mechanism.advance = take_turns  # type: ignore[method-assign, assignment]
        return self

    def __exit__(self, *_: object) -> None:
        Mechanism.advance = self._advance  # type: ignore[method-assign]

    def _physics(self) -> None:
        end = self._clock()
        self.studied.append(end - self._begin)
        for rate in self._turn:
            self._ctrl[:, ::-1] = rate
            self._batch.step(nstep=STEPS)
        self.bare.append(self._clock() - end)
        self._turn.clear()


Job = tuple[int, float, Sequence[str]]
"""Rigs, simulated seconds and overrides of a study."""


def compare(
    rigs: int, seconds: float, more: Sequence[str], clock: Callable[[], float]
) -> NDArray[np.floating]:
    """Seconds of every turn but the first, of the study and of bare physics, shape (2, turns)."""
    one = load("circle", [*ALL_EFFECTS, *more, f"duration={seconds}"])
    scenarios = [one.model_copy(update={"seed": seed}) for seed in range(rigs)]
    with Turns(rigs, clock) as turns:
        simulate(scenarios, [build_controller(one)] * rigs)
    return np.array([turns.studied, turns.bare])[:, 1:]


def on_all_cores(rigs: int, seconds: float, rounds: int) -> None:
    """Print how the study compares on all cores, and what they bring it, by the clock."""
    cores = os.cpu_count() or 1

    def together(processes: int, pool: Executor, job: Job) -> NDArray[np.floating]:
        """Seconds of study and physics of the slowest of so many processes at the same time."""
        running = [pool.submit(compare, *job, time.monotonic) for _ in range(processes)]
        slowest: NDArray[np.floating] = np.max([done.result().sum(axis=1) for done in running], 0)
        return slowest

    for name, (more, goal) in STACKS.items():
        with ProcessPoolExecutor(cores, get_context("spawn")) as pool:
            together(cores, pool, (16, 0.2, more))
            job = rigs, seconds, more
            times = np.array(
                [(together(cores, pool, job), together(1, pool, job)) for _ in range(rounds)]
            )
        studied, physics = times[:, 0].sum(axis=0)
        gains = cores * times[:, 1, 0] / times[:, 0, 0]
        print(
            f"{rigs} rigs on each of {cores} cores, {name}: throughput "
            f"{100 * physics / studied:.1f} % of Batch.step (goal: at least {goal} %), "
            f"{np.median(gains):.2f} times that of one core, {gains.min():.2f} to "
            f"{gains.max():.2f} in {rounds} rounds (goal with two: at least 1.8)"
        )


def main() -> None:
    """Print throughput of both stacks, and what a second core brings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--cores", action="store_true", help="compare on all cores, too")
    parser.add_argument("--rounds", type=int, default=5, help="of the comparison on all cores")
    options = parser.parse_args()
    for name, (more, goal) in STACKS.items():
        begin = time.process_time()
        studied, physics = compare(options.rigs, options.seconds, more, time.process_time)
        once = time.process_time() - begin - (studied + physics).sum()
        low, high = 100 * np.quantile(physics / studied, (0.25, 0.75))
        work = options.rigs * TURN * len(studied)
        print(
            f"{options.rigs} rigs, {name}: Batch.step alone {1e6 * physics.sum() / work:.1f} us "
            f"a rig and tick, study {1e6 * studied.sum() / work:.1f}: throughput "
            f"{100 * physics.sum() / studied.sum():.1f} %, half of all turns {low:.0f} to "
            f"{high:.0f} % (goal: at least {goal} %); a run of 25 s takes "
            f"{12500 * studied.sum() / work:.2f} s, all else in this run "
            f"{1e3 * once / options.rigs:.0f} ms a rig"
        )
    if options.cores:
        on_all_cores(options.rigs, options.seconds, options.rounds)


if __name__ == "__main__":
    main()
