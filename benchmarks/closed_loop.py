"""What control costs beside physics: one rig in closed loop, and a bare loop of ``mj_step``.

The bare loop goes through the very same motion on the same model. Short rounds alternate between
both, so that a busy machine slows them alike; counted is the processor time of this process. The
least of all rounds is what the code costs when nothing disturbs it, the median what it costs on the
machine as it is.

A bare loop has the processor's caches to itself: between two control periods of a closed loop its
own steps take up to twice as long, which counts as a cost of control here. The motion matters, too:
steps of a plate and ball at rest take hardly more than half as long as those of a ball that rolls,
so the first second of ``circle``, whose start is soft, is no measure. The goal is about ``sine``,
which moves at once; ``circle`` has a predictor besides and is judged over a whole start.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from twin.base.shipped import model_path
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.sim.rig import SimulatedDevices

PERIOD = 0.002
SECONDS = {"sine": 1.0, "circle": 5.0}
"""Scenarios and how long they are simulated."""


class Benchmark:
    """A closed loop of one rig and, as its baseline, bare physics of the very same motion."""

    def __init__(self, scenario: str) -> None:
        seconds = SECONDS[scenario]
        self.scenario = load(scenario, [f"duration={seconds}", "metrics.start=0"])
        self.commands: list[NDArray[np.floating]] = []
        self.closed()
        # Levelling the plate in the end counts too.
        self.steps = len(self.commands)

    def closed(self) -> float:
        """Seconds that the closed loop takes: observer, predictor, law, seam, recording."""
        rig, controller = assemble([self.scenario])
        if not self.commands:
            self._keep_commands(rig.devices)
        duration = self.scenario.duration
        record = Recorder(round(duration / PERIOD), 1, PERIOD, rig.channels)
        begin = time.process_time()
        drive(rig, controller, duration, record)
        return time.process_time() - begin

    def _keep_commands(self, devices: SimulatedDevices) -> None:
        original = devices.plant.advance

        def advance(rate: NDArray[np.floating], steps: int) -> None:
            self.commands.append(np.array(rate))
            original(rate, steps)

        devices.plant.advance = advance  # type: ignore[method-assign, assignment]

    def bare(self) -> float:
        """Seconds of a bare loop of mj_step under the same motor rates."""
        model = mujoco.MjModel.from_xml_path(str(model_path()))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        commands = [command[0, ::-1] for command in self.commands]
        begin = time.process_time()
        for command in commands:
            data.ctrl = command
            mujoco.mj_step(model, data)
            mujoco.mj_step(model, data)
        return time.process_time() - begin


def alternated(rounds: int, *jobs: Callable[[], float]) -> dict[str, list[float]]:
    """Seconds of each job over alternating rounds: the least, and the median."""
    times = np.array([[job() for job in jobs] for _ in range(rounds)])
    return {"least": times.min(axis=0).tolist(), "median": np.median(times, axis=0).tolist()}
