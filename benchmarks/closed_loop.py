"""What control costs beside physics, as ratios within one run.

Run with ``uv run python benchmarks/closed_loop.py``. Baselines: a bare loop of ``mj_step`` and a
bare loop of ``Batch.step`` through the very same motion, on the same model and threads. Best of
several rounds that alternate between baseline and closed loop, so that a busy machine slows both
alike.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from twin.paths import model_path
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.sim.rig import SimulatedDevices

PERIOD, STEPS = 0.002, 2


class Benchmark:
    """A closed loop of N rigs and, as its baseline, bare physics of the very same motion."""

    def __init__(self, rigs: int, seconds: float) -> None:
        self.rigs, self.seconds = rigs, seconds
        self.ticks = round(seconds / PERIOD)
        self.commands: list[NDArray[np.floating]] = []
        self.closed()
        # Levelling the plates in the end counts too.
        self.steps = len(self.commands)

    def closed(self) -> float:
        """Seconds that the closed loop takes: observer, law, seam and recording on."""
        scenario = load("sine", [f"duration={self.seconds}", "metrics.start=0"])
        rig, controller = assemble(
            [scenario.model_copy(update={"seed": seed}) for seed in range(self.rigs)]
        )
        if not self.commands:
            self._keep_commands(rig.devices)
        record = Recorder(self.ticks, self.rigs, PERIOD, rig.channels)
        begin = time.perf_counter()
        drive(rig, controller, self.seconds, record)
        return time.perf_counter() - begin

    def _keep_commands(self, devices: SimulatedDevices) -> None:
        original = devices.plant.advance

        def advance(rate: NDArray[np.floating], steps: int) -> None:
            self.commands.append(np.array(rate))
            original(rate, steps)

        devices.plant.advance = advance  # type: ignore[method-assign]

    def bare(self) -> float:
        """Seconds of a bare mj_step (one rig) or Batch.step loop under the same motor rates."""
        model = mujoco.MjModel.from_xml_path(str(model_path()))
        if self.rigs == 1:
            data = mujoco.MjData(model)
            mujoco.mj_resetDataKeyframe(model, data, 0)
            commands = [command[0, ::-1] for command in self.commands]
            begin = time.perf_counter()
            for command in commands:
                data.ctrl = command
                mujoco.mj_step(model, data)
                mujoco.mj_step(model, data)
            return time.perf_counter() - begin
        batch = Batch(model, nsim=self.rigs)
        batch.reset(keyframe=0)
        ctrl = batch.bind("ctrl")
        begin = time.perf_counter()
        for command in self.commands:
            ctrl[:, ::-1] = command
            batch.step(nstep=STEPS)
        return time.perf_counter() - begin


def best(rounds: int, *jobs: Callable[[], float]) -> list[float]:
    """The least time of each job over alternating rounds."""
    times = np.array([[job() for job in jobs] for _ in range(rounds)])
    return times.min(axis=0).tolist()


def main() -> None:
    """Print both ratios and, on request, where the time of one rig goes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--profile", action="store_true", help="show where one rig's time goes")
    options = parser.parse_args()
    one = Benchmark(1, 4.0)
    bare, loop = best(options.rounds, one.bare, one.closed)
    print(
        f"one rig: mj_step alone {1e6 * bare / one.steps:.1f} us a tick, closed loop "
        f"{1e6 * loop / one.steps:.1f} us: ratio {loop / bare:.2f} (goal: at most 7), "
        f"{one.seconds / loop:.1f} times faster than real time"
    )
    many = Benchmark(256, 0.5)
    bare, loop = best(options.rounds, many.bare, many.closed)
    work = 256 * many.steps
    print(
        f"256 rigs: Batch.step alone {1e6 * bare / work:.2f} us a rig and tick, closed loop "
        f"{1e6 * loop / work:.2f}: throughput {100 * bare / loop:.0f} % (goal: at least 80 %)"
    )
    if options.profile:
        profile = cProfile.Profile()
        profile.runcall(one.closed)
        pstats.Stats(profile).sort_stats("tottime").print_stats(25)


if __name__ == "__main__":
    main()
