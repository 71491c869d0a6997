"""What a study costs beside bare physics, as ratios within one run.

Run with ``uv run python -m benchmarks.throughput``. Everything a study does in the loop is on:
friction that depends on speed, servo lag, dead time, noise, supervisor, record. The baseline is a
bare loop of ``Batch.step`` of the same model under the very motor rates of the study. Both take
turns every 25 ticks on one thread and are told in processor time, so that a machine whose speed
varies tells the same; set-up and evaluation, once a run, are told apart. With ``--cores`` the same
is told by the clock while a process on every other core carries out the same study, and rests every
second time.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from typing import Self

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from twin.paths import model_path
from twin.run.batch import simulate
from twin.scenario import load
from twin.sim.plant.mechanism import Mechanism

STEPS = 2
TURN = 25
"""Control ticks of a turn."""
QUARTILES = (0.25, 0.5, 0.75)
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
        over: Called when both have had a turn.
    """

    def __init__(self, rigs: int, clock: Callable[[], float], over: Callable[[], None]) -> None:
        self.studied: list[float] = []
        """Seconds of each turn of the study."""
        self.bare: list[float] = []
        """Seconds of ``Batch.step`` under the same motor rates."""
        self._clock, self._over = clock, over
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
        self._over()


def study(rigs: int, seconds: float, more: Sequence[str]) -> None:
    """A batch of rigs under one controller."""
    one = load("circle", [*ALL_EFFECTS, *more, f"duration={seconds}"])
    scenarios = [one.model_copy(update={"seed": seed}) for seed in range(rigs)]
    simulate(scenarios)


def compare(
    rigs: int,
    seconds: float,
    more: Sequence[str],
    clock: Callable[[], float],
    over: Callable[[], None] = lambda: None,
) -> NDArray[np.floating]:
    """Seconds of every turn but the first, of the study and of bare physics, shape (2, turns)."""
    with Turns(rigs, clock, over) as turns:
        study(rigs, seconds, more)
    return np.array([turns.studied, turns.bare])[:, 1:]


def accompany(rigs: int, seconds: float, more: Sequence[str], work: Event, ready: Event) -> None:
    """Carry out a study, but only while there is to be work."""
    advance = Mechanism.advance

    def wait_for_work(plant: Mechanism, rate: NDArray[np.floating], steps: int) -> None:
        ready.set()
        work.wait()
        advance(plant, rate, steps)

    Mechanism.advance = wait_for_work  # type: ignore[method-assign, assignment]
    # long enough that nobody is setting up another one while it should rest
    study(rigs, 10 * seconds, more)


@contextmanager
def company(rigs: int, seconds: float, more: Sequence[str]) -> Iterator[Event]:
    """Processes on all other cores that study while the event is set."""
    spawn = get_context("spawn")
    work = spawn.Event()
    ready = [spawn.Event() for _ in range((os.cpu_count() or 1) - 1)]
    others = [
        spawn.Process(target=accompany, args=(rigs, seconds, more, work, each), daemon=True)
        for each in ready
    ]
    for other in others:
        other.start()
    for each in ready:
        each.wait()
    try:
        yield work
    finally:
        for other in others:
            other.terminate()


def on_all_cores(rigs: int, seconds: float) -> None:
    """Print how the study compares on all cores, and what they bring it, by the clock."""
    cores = os.cpu_count() or 1
    for name, (more, goal) in STACKS.items():
        with company(rigs, seconds, more) as work:

            def take_turns(work: Event = work) -> None:
                (work.clear if work.is_set() else work.set)()

            studied, physics = compare(rigs, seconds, more, time.monotonic, take_turns)
        # the first turn, which is left out, was alone
        together, alone = slice(0, None, 2), slice(1, None, 2)
        low, share, high = 100 * np.quantile((physics / studied)[together], QUARTILES)
        times = np.stack((studied, physics))
        gain = cores * np.median(times[:, alone], axis=1) / np.median(times[:, together], axis=1)
        print(
            f"{rigs} rigs on each of {cores} cores, {name}: throughput {share:.1f} %, half of all "
            f"turns {low:.0f} to {high:.0f} % (goal: at least {goal} %), {gain[0]:.2f} times that "
            f"of one core (goal with two: at least 1.8), Batch.step {gain[1]:.2f} times"
        )


def main() -> None:
    """Print throughput of both stacks, and what a second core brings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--cores", action="store_true", help="compare on all cores, too")
    options = parser.parse_args()
    for name, (more, goal) in STACKS.items():
        begin = time.process_time()
        studied, physics = compare(options.rigs, options.seconds, more, time.process_time)
        once = time.process_time() - begin - (studied + physics).sum()
        low, share, high = 100 * np.quantile(physics / studied, QUARTILES)
        work = options.rigs * TURN
        print(
            f"{options.rigs} rigs, {name}: Batch.step alone {1e6 * np.median(physics) / work:.1f} "
            f"us a rig and tick, study {1e6 * np.median(studied) / work:.1f}: throughput "
            f"{share:.1f} %, half of all turns {low:.0f} to {high:.0f} % (goal: at least {goal} "
            f"%); a run of 25 s takes {12500 * np.median(studied) / work:.2f} s, all else in this "
            f"run {1e3 * once / options.rigs:.0f} ms a rig"
        )
    if options.cores:
        on_all_cores(options.rigs, options.seconds)


if __name__ == "__main__":
    main()
