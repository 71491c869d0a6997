"""What an environment of Gymnasium costs beside the study of the same rigs, within one run.

Run with ``uv run python -m benchmarks.gym_throughput``. Study and environment simulate as many rigs
of one scenario with the same effects on; the study with its controller and its record, the
environment with what it sees and rewards. They take turns every 50 control periods on one thread
and are told in processor time, so that a machine whose speed varies tells the same. Rigs whose
episode ends begin the next one in the next step; how many did, and what each costs, is told.

The engine itself needs longer for rigs that are thrown about than for those of the study: nearly
all of that is its solver of the contacts. So what it needs is told of both, and beside the plain
throughput the one at equal motion, which compares what shares of their times are the engine's.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Self

import gymnasium
import numpy as np
from mujoco.batch import Batch

from benchmarks.throughput import ALL_EFFECTS, QUARTILES, study
from twin.run.episodes import Episodes
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


class Timed:
    """Seconds of the processor that a method takes."""

    def __init__(self) -> None:
        self._sum = 0.0

    def take(self) -> float:
        """Those since this was asked for last."""
        taken, self._sum = self._sum, 0.0
        return taken

    @contextmanager
    def calls(self, owner: type, name: str) -> Iterator[None]:
        """Count a method of a class."""
        method = getattr(owner, name)

        def timed(*arguments: Any, **more: Any) -> Any:
            begin = time.process_time()
            try:
                return method(*arguments, **more)
            finally:
                self._sum += time.process_time() - begin

        setattr(owner, name, timed)
        try:
            yield
        finally:
            setattr(owner, name, method)


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
        self.engine: list[tuple[float, float]] = []
        """Seconds of the engine in each turn of the study, and in that of the environment."""
        self.begun = 0
        """Episodes that ended, and so began again."""
        self.beginning = 0.0
        """Seconds that this took."""
        self._engine, self._begins = Timed(), Timed()
        self._timing = ExitStack()

    def __enter__(self) -> Self:
        self._timing.enter_context(self._engine.calls(Batch, "step"))
        self._timing.enter_context(self._begins.calls(Episodes, "begin"))
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
        self._timing.close()

    def _step(self) -> None:
        studied = self._engine.take()
        begin = time.process_time()
        for _ in range(TURN // self._env.rigs.task.hold):
            action = self._actions[self._steps % len(self._actions)]
            _, _, terminated, truncated, _ = self._env.step(action)
            self.begun += int((terminated | truncated).sum())
            self._steps += 1
        self.stepped.append(time.process_time() - begin)
        self.engine.append((studied, self._engine.take()))
        self.beginning += self._begins.take()


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
        engines = np.array(turns.engine)[2:].T
        low, share, high = 100 * np.quantile(studied / stepped, QUARTILES)
        whole = 100 * studied.sum() / stepped.sum()
        of_study, of_environment = engines.sum(axis=1) / (studied.sum(), stepped.sum())
        us = 1e6 / (options.rigs * TURN)
        print(
            f"{options.rigs} rigs, {name}: study {us * np.median(studied):.1f} us a rig and tick, "
            f"of which the engine {us * np.median(engines[0]):.1f}; environment "
            f"{us * np.median(stepped):.1f}, of which the engine {us * np.median(engines[1]):.1f}: "
            f"throughput {share:.0f} % of the study's, half of all turns {low:.0f} to {high:.0f} "
            f"%, all in all {whole:.0f} %; at equal motion, all in all, "
            f"{100 * of_environment / of_study:.0f} % (goal: at least {GOAL} %); {turns.begun} "
            f"episodes began in {len(turns.stepped) * TURN // 10} steps, "
            f"{1e3 * turns.beginning / max(1, turns.begun):.1f} ms each"
        )


if __name__ == "__main__":
    main()
