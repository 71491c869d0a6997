"""What a study costs beside bare physics, as ratios within one run.

Run with ``uv run python -m benchmarks.throughput``. Everything a study does in the loop is on:
friction that depends on speed, servo lag, dead time, noise, supervisor, record. The baseline is a
bare loop of ``Batch.step`` of the same model under the very motor rates of the study. Both take
turns every 25 ticks on one thread and are told in processor time, so that a machine whose speed
varies tells the same; set-up and evaluation, once a run, are told apart.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
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
    """

    def __init__(self, rigs: int) -> None:
        self.studied: list[float] = []
        """Seconds of each turn of the study."""
        self.bare: list[float] = []
        """Seconds of ``Batch.step`` under the same motor rates."""
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
                self._begin = time.process_time()
            self._turn.append(np.array(np.broadcast_to(rate, (plant.rigs, 2))))
            advance(plant, rate, steps)

        Mechanism.advance = take_turns  # type: ignore[method-assign, assignment]
        return self

    def __exit__(self, *_: object) -> None:
        Mechanism.advance = self._advance  # type: ignore[method-assign]

    def _physics(self) -> None:
        end = time.process_time()
        self.studied.append(end - self._begin)
        for rate in self._turn:
            self._ctrl[:, ::-1] = rate
            self._batch.step(nstep=STEPS)
        self.bare.append(time.process_time() - end)
        self._turn.clear()


def compare(rigs: int, seconds: float, more: Sequence[str]) -> NDArray[np.floating]:
    """Seconds of every turn but the first, of the study and of bare physics, shape (2, turns)."""
    one = load("circle", [*ALL_EFFECTS, *more, f"duration={seconds}"])
    with Turns(rigs) as turns:
        simulate([one.model_copy(update={"seed": seed}) for seed in range(rigs)])
    return np.array([turns.studied, turns.bare])[:, 1:]


def main() -> None:
    """Print throughput of both stacks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=2.0)
    options = parser.parse_args()
    for name, (more, goal) in STACKS.items():
        begin = time.process_time()
        studied, physics = compare(options.rigs, options.seconds, more)
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


if __name__ == "__main__":
    main()
