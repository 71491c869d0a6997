"""What an environment of Gymnasium costs beside the study of the same rigs, within one run.

Run with ``uv run python -m benchmarks.gym_throughput``. Study and environment simulate as many rigs
of one scenario with the same effects on; the study with its controller and its record, the
environment with what it sees and rewards. They take turns every 50 control periods on one thread
and are told in processor time, so that a machine whose speed varies tells the same. Rigs whose
episode ends begin the next one in the next step; how many did is told.
"""

from __future__ import annotations

import argparse
import time
from typing import Any, Self

import gymnasium
import numpy as np

from benchmarks.throughput import ALL_EFFECTS, QUARTILES, study
from twin.sim.plant.mechanism import Mechanism

TURN = 50
"""Control ticks of a turn."""
GOAL = 85
"""Throughput in % of the study's that is aimed at."""
CASES: dict[str, tuple[float, dict[str, Any]]] = {
    "gentle actions": (0.02, {}),
    "random actions": (1.0, {}),
    "random actions, each episode another rig": (1.0, {"family": "uncertain"}),
}
"""Size of the actions, and further arguments."""


class Turns:
    """Lets an environment take turns with a study that runs in this process.

    Args:
        rigs: Rigs of each.
        size: Of the random actions.
        more: Further arguments of the environment.
    """

    def __init__(self, rigs: int, size: float, more: dict[str, Any]) -> None:
        settings = [*ALL_EFFECTS, "duration=10"]
        self._env: Any = gymnasium.make_vec(
            "ballplate.gym:ballplate/Track-v0", rigs, settings=settings, threads=1, **more
        )
        self._env.reset(seed=0)
        self._actions = size * np.random.default_rng(0).uniform(-1, 1, (97, rigs, 2))
        self._steps, self._ticks, self._begin = 0, 0, 0.0
        self.studied: list[float] = []
        """Seconds of each turn of the study."""
        self.stepped: list[float] = []
        """Seconds of the environment for as many control periods."""
        self.begun = 0
        """Episodes that ended, and so began again."""

    def __enter__(self) -> Self:
        self._advance = advance = Mechanism.advance

        def take_turns(plant: Mechanism, rate: Any, steps: int) -> None:
            Mechanism.advance = advance  # type: ignore[method-assign]
            if self._ticks % TURN == 0:
                now = time.process_time()
                if self._ticks:
                    self.studied.append(now - self._begin)
                    self._step()
                self._begin = time.process_time()
            self._ticks += 1
            advance(plant, rate, steps)
            Mechanism.advance = take_turns  # type: ignore[method-assign, assignment]

        Mechanism.advance = take_turns  # type: ignore[method-assign, assignment]
        return self

    def __exit__(self, *_: object) -> None:
        Mechanism.advance = self._advance  # type: ignore[method-assign]

    def _step(self) -> None:
        begin = time.process_time()
        for _ in range(TURN // self._env.rigs.task.hold):
            action = self._actions[self._steps % len(self._actions)]
            _, _, terminated, truncated, _ = self._env.step(action)
            self.begun += int((terminated | truncated).sum())
            self._steps += 1
        self.stepped.append(time.process_time() - begin)


def main() -> None:
    """Print what share of the study's throughput environments have."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=4.0)
    options = parser.parse_args()
    for name, (size, more) in CASES.items():
        with Turns(options.rigs, size, more) as turns:
            study(options.rigs, options.seconds, ())
        # the first turns set things up
        studied, stepped = np.array([turns.studied, turns.stepped])[:, 2:]
        low, share, high = 100 * np.quantile(studied / stepped, QUARTILES)
        whole = 100 * studied.sum() / stepped.sum()
        work = options.rigs * TURN
        print(
            f"{options.rigs} rigs, {name}: study {1e6 * np.median(studied) / work:.1f} us a rig "
            f"and tick, environment {1e6 * np.median(stepped) / work:.1f}: throughput {share:.0f} "
            f"% of the study's, half of all turns {low:.0f} to {high:.0f} %, all in all "
            f"{whole:.0f} % (goal: at least {GOAL} %); {turns.begun} episodes began in "
            f"{len(turns.stepped) * TURN // 10} steps"
        )


if __name__ == "__main__":
    main()
