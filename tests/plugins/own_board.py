"""The board of examples/own_rig as hardware of one's own, in virtual time."""

import importlib.util
import math
from contextlib import nullcontext
from pathlib import Path

from twin.devices.own import OwnScreen, OwnServos
from twin.devices.own_config import OwnConfig
from twin.devices.own_hardware import Hardware, Reading
from twin.devices.realtime import RealTimeClock, Scheduling
from twin.devices.rig import HardwareRig
from twin.hal.cams import FixedRatio
from twin.run.controller_building import build_limits

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_rig"


def example(name):
    """A program of the example, which is in no package, as a module."""
    spec = importlib.util.spec_from_file_location(f"own_example_{name}", EXAMPLE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


board = example("board")


class VirtualBoard(Hardware):
    """Frames of the board's camera, commands to its servos; time passes when the host waits."""

    def __init__(self, *, encoder=True, **given):
        self.board = board.Board(1, **{"lag": 0.004, "late": 0.0, "noise": 0.0, **given})
        self.board.ball = [0.0, 0.0]
        self.encoder = encoder
        self.now, self.steps = 0.0, 0
        self.stopped = 0
        self.words = ()
        self.reading = Reading(math.nan, math.nan, 0.0)

    def start(self):
        self.wait(0.1)

    def measure(self):
        angles = tuple(self.board.angle) if self.encoder else (None, None)
        return self.reading._replace(phi=angles[0], theta=angles[1])

    def command(self, rates, angles):
        self.rates = rates
        self.board.goal, self.board.heard = list(angles), self.now

    def stop(self):
        self.stopped += 1

    def time(self):
        return self.now

    def wait(self, seconds):
        self.now += seconds + 1e-9
        while (self.steps + 1) * board.STEP <= self.now:
            self.steps += 1
            for line in self.board.step(self.steps * board.STEP):
                _, x, y = line.split()
                seen = [math.nan if each == "-" else float(each) / 1000 for each in (x, y)]
                self.reading = Reading(*seen, at=self.now)

    def faults(self):
        return self.words


def own_rig(hardware, scenario, **thresholds):
    """The rig of some hardware, as `connect` builds it, without real-time scheduling."""
    limits = build_limits(scenario)
    servos = OwnServos(hardware, OwnConfig(**thresholds), limits, scenario.rig.period)
    return HardwareRig(
        servos=servos,
        screen=OwnScreen(servos),
        clock=RealTimeClock(scenario.rig.period, spin=0.0, now=hardware.time, sleep=hardware.wait),
        transmission=FixedRatio(),
        limits=limits,
        patience=1.0,
        axes=scenario.plant.axes,
        scheduling=lambda: nullcontext(Scheduling(False, False, ("virtual time",))),
    )
