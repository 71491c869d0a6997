"""What control costs beside physics, as ratios within one run.

Run with ``uv run python benchmarks/closed_loop.py``. Baselines: a bare loop of ``mj_step`` and a
bare loop of ``Batch.step`` through the very same motion, on the same model and threads. Short
rounds alternate between baseline and closed loop, so that a busy machine slows both alike; counted
is the processor time of this process. The least of all rounds is what the code costs when nothing
disturbs it, the median what it costs on the machine as it is.

A bare loop has the processor's caches to itself: between two control periods of a closed loop its
own steps take up to twice as long, which counts as a cost of control here. The motion matters, too:
steps of a plate and ball at rest take hardly more than half as long as those of a ball that rolls,
so the first second of ``circle``, whose start is soft, is no measure. The goal is about ``sine``,
which moves at once; ``circle`` has a predictor besides and is judged over a whole start.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable, Sequence
from functools import partial

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from twin.paths import model_path
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.scenario.clean import clean
from twin.scenario.schema import Scenario
from twin.sim.rig import SimulatedDevices

PERIOD, STEPS = 0.002, 2
SECONDS = {"sine": 1.0, "circle": 5.0}
"""Scenarios and how long they are simulated."""
PARTS = {
    "law, observer, predictor": ("controller.command", "controller.applied"),
    "record": ("record.append", "rig.telemetry"),
    "sensors, watching the limits": ("rig.read",),
    "limits of the command, cams": ("rig.write",),
}
"""What a control period is made of beside physics, and the calls that do it."""


class Benchmark:
    """A closed loop of N rigs and, as its baseline, bare physics of the very same motion."""

    def __init__(self, rigs: int, seconds: float, scenario: str = "sine") -> None:
        self.rigs, self.seconds, self.scenario = rigs, seconds, scenario
        self.ticks = round(seconds / PERIOD)
        self.commands: list[NDArray[np.floating]] = []
        self.closed()
        # Levelling the plates in the end counts too.
        self.steps = len(self.commands)

    def closed(self) -> float:
        """Seconds that the closed loop takes: observer, predictor, law, seam, recording."""
        return self._closed(self._loaded())

    def clean(self) -> float:
        """The same on the exact equations, as every run does for comparison."""
        return self._closed(clean(self._loaded()))

    def without(self, count: int) -> float:
        """The closed loop with so many of the ``PARTS`` costing nothing: what is left of it."""
        free = [name for part in list(PARTS)[:count] for name in PARTS[part]]
        return self._closed(self._loaded(), free)

    def _loaded(self) -> Scenario:
        return load(self.scenario, [f"duration={self.seconds}", "metrics.start=0"])

    def _closed(self, scenario: Scenario, free: Sequence[str] = ()) -> float:
        rig, controller = assemble(
            [scenario.model_copy(update={"seed": seed}) for seed in range(self.rigs)]
        )
        if not self.commands:
            self._keep_commands(rig.devices)
        record = Recorder(self.ticks, self.rigs, PERIOD, rig.channels)
        for owner, name in (each.split(".") for each in free):
            _set_free({"rig": rig, "controller": controller, "record": record}[owner], name)
        begin = time.process_time()
        drive(rig, controller, self.seconds, record)
        return time.process_time() - begin

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
            begin = time.process_time()
            for command in commands:
                data.ctrl = command
                mujoco.mj_step(model, data)
                mujoco.mj_step(model, data)
            return time.process_time() - begin
        batch = Batch(model, nsim=self.rigs)
        batch.reset(keyframe=0)
        ctrl = batch.bind("ctrl")
        begin = time.process_time()
        for command in self.commands:
            ctrl[:, ::-1] = command
            batch.step(nstep=STEPS)
        return time.process_time() - begin


def _set_free(owner: object, name: str) -> None:
    """Let a method do its work once and from then on only give that result again."""
    work, found = getattr(owner, name), []

    def again(*given: object) -> object:
        if not found:
            found.append(work(*given))
        return found[0]

    setattr(owner, name, again)


def parts(one: Benchmark, rounds: int) -> None:
    """Print what each part costs: the difference when it, after those before it, is free."""
    counts = range(len(PARTS) + 1)
    jobs = [one.bare, *(partial(one.without, count) for count in counts)]
    bare, *left = (1e6 * seconds / one.steps for seconds in alternated(rounds, *jobs)["least"])
    print(f"whole closed loop: {left[0]:.1f} us a control period, {left[0] / bare:.2f} times bare")
    for name, before, after in zip(PARTS, left, left[1:], strict=False):
        print(
            f"  {name}: {before - after:.1f} us; without it {after:.1f}, {after / bare:.2f} times"
        )
    print(
        f"  two physics steps with sensors, between all this: {left[-1]:.1f} us; bare {bare:.1f} us"
    )


def alternated(rounds: int, *jobs: Callable[[], float]) -> dict[str, list[float]]:
    """Seconds of each job over alternating rounds: the least, and the median."""
    times = np.array([[job() for job in jobs] for _ in range(rounds)])
    return {"least": times.min(axis=0).tolist(), "median": np.median(times, axis=0).tolist()}


def main() -> None:
    """Print both ratios and, on request, where the time of one rig goes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--profile", action="store_true", help="show where one rig's time goes")
    parser.add_argument("--parts", action="store_true", help="show what each part of it costs")
    options = parser.parse_args()
    one = Benchmark(1, SECONDS["sine"])
    if options.parts:
        parts(one, options.rounds)
        return
    for case in (one, Benchmark(1, SECONDS["circle"], "circle")):
        for kind, times in alternated(options.rounds, case.bare, case.closed, case.clean).items():
            bare, loop, exact = (1e6 * seconds / case.steps for seconds in times)
            print(
                f"one rig, {case.scenario}, {kind}: mj_step alone {bare:.1f} us a control period, "
                f"closed loop {loop:.1f} us: ratio {loop / bare:.2f} (goal of sine: at most 4.2); "
                f"on the exact equations {exact:.1f} us"
            )
    many = Benchmark(256, 0.2)
    work = 256 * many.steps
    for kind, (bare, loop) in alternated(
        max(1, options.rounds // 4), many.bare, many.closed
    ).items():
        print(
            f"256 rigs, {kind}: Batch.step alone {1e6 * bare / work:.2f} us a rig and control "
            f"period, closed loop {1e6 * loop / work:.2f}: throughput {100 * bare / loop:.0f} % "
            f"(goal: at least 80 %)"
        )
    if options.profile:
        profile = cProfile.Profile()
        profile.runcall(one.closed)
        pstats.Stats(profile).sort_stats("tottime").print_stats(25)


if __name__ == "__main__":
    main()
