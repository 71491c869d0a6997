"""From a rig file to a rig: the real one, or whatever speaks its bytes."""

from __future__ import annotations

import time
from math import radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from can import BusABC

from twin.devices.akd.bus import open_bus
from twin.devices.akd.config import BusConfig
from twin.devices.akd.servos import AkdServos
from twin.devices.akd.traces import Hear, TracedBus
from twin.devices.lumio.screen import LumioScreen
from twin.devices.own import Direct, OwnConfig, OwnScreen, OwnServos, load_backend
from twin.devices.realtime import LatencyHistogram, Paused, RealTimeClock, never
from twin.devices.rig import HardwareRig
from twin.devices.scheduling import real_time
from twin.hal.cams import CamTable
from twin.hal.interface import Limits, Transmission
from twin.run.assemble import assemble, build_limits, own_errors
from twin.scenario.rig import RigFile, built
from twin.scenario.schema import Scenario


def connect(
    scenario: Scenario,
    rig: RigFile,
    *,
    reset: bool = False,
    transmission: Transmission | None = None,
    paused: Paused = never,
    hear: Hear | None = None,
) -> HardwareRig:
    """The rig of a file, to run a scenario's controller on; nothing is opened yet.

    Args:
        scenario: Period and limits.
        rig: What is connected where.
        reset: Whether faults found in the drives are reset when they are switched on.
        transmission: Of a virtual rig that has another; that of the rig file by default.
        paused: Tells how long this computer paused, for which a virtual rig's time stands still.
        hear: Is given every frame on the bus of the drives; must not wait.

    Raises:
        TwinError: If the settings do not go together.
    """
    period, allowed = scenario.rig.period, rig.late_periods
    limits = narrower(build_limits(scenario.rig.limits), build_limits(rig.limits))
    common: dict[str, Any] = {
        "limits": limits,
        "home": (radians(rig.home_deg[0]), radians(rig.home_deg[1])),
        "patience": rig.patience,
        "reset": reset,
        "relaxed": rig.relaxed(period),
    }
    if rig.backend is not None:
        config = built(OwnConfig, rig.own)
        hardware = load_backend(rig.backend, config)
        own = OwnServos(hardware, config, limits, period)
        return HardwareRig(
            servos=own,
            screen=OwnScreen(own),
            clock=RealTimeClock(
                period, allowed=allowed, spin=0.0, now=hardware.time, sleep=hardware.wait
            ),
            transmission=Direct(),
            **common,
        )

    def opened(config: BusConfig) -> BusABC:
        bus = open_bus(config)
        return bus if hear is None else TracedBus(bus, hear)

    return HardwareRig(
        servos=AkdServos(rig.servos(period), opener=opened),
        screen=LumioScreen(rig.screen()),
        clock=RealTimeClock(period, allowed=allowed, paused=paused),
        transmission=transmission or cams_of(rig),
        **common,
    )


FULL = 0.8
"""Share of a period that a controller may take: reading, writing and recording need the rest."""
HALF = 0.5
"""Share above which the median leaves too little for what else a computer does."""


class ComputingTime(NamedTuple):
    """How long a controller computes for a period, on this computer.

    Attributes:
        law: Whose.
        period: Control period in s.
        median: In s.
        worst: Exceeded by one period of a thousand, s.
    """

    law: str
    period: float
    median: float
    worst: float

    @classmethod
    def measured(cls, scenario: Scenario, seconds: float = 2.0) -> ComputingTime:
        """Run a scenario's controller on its simulated rig, with the priority of a real one.

        Args:
            scenario: Whose.
            seconds: Simulated time, after a tenth of it.

        Raises:
            TwinError: If the scenario cannot be assembled.
        """
        rig, controller = assemble(scenario.without_computing_time)
        times, ticks = LatencyHistogram(), round(seconds / rig.period)
        with own_errors(), real_time(), rig:
            measurement = rig.read()
            controller.start(measurement)
            rig.start()
            for tick in range(ticks + ticks // 10):
                begin = time.perf_counter()
                step = controller.command(measurement)
                passed = time.perf_counter() - begin
                rate = rig.write(step.rate)
                begin = time.perf_counter()
                controller.applied(rate)
                if tick >= ticks // 10:
                    times.add(passed + time.perf_counter() - begin)
                rig.wait()
                measurement = rig.read()
        return cls(scenario.controller.kind, rig.period, times.quantile(0.5), times.quantile(0.999))

    @property
    def never(self) -> bool:
        """Whether no run in real time can keep its periods."""
        return self.median > FULL * self.period

    @property
    def enough(self) -> bool:
        """Whether a run in real time can be expected to keep its periods."""
        return self.median <= HALF * self.period and self.worst <= FULL * self.period

    @property
    def text(self) -> str:
        """The shares of a period in words."""
        return (
            f"{self.law} computes for {self.median / self.period:.2f} of the period of "
            f"{1e3 * self.period:g} ms on this computer, {self.worst / self.period:.2f} at worst"
        )

    @property
    def advice(self) -> str:
        """What to do where that is too much."""
        return "close other programs, or choose a law and an observer that compute for less long"


def cams_of(rig: RigFile) -> CamTable:
    """The cam table of a real rig: the one its file names, or the one of the packaged model.

    Raises:
        ModelError: If it cannot be used.
    """
    return CamTable.from_file(Path(rig.cams)) if rig.cams else CamTable.packaged()


def narrower(one: Limits, other: Limits) -> Limits:
    """Limits that keep both."""
    pairs = vars(other)
    kept: dict[str, Any] = {
        name: tuple(np.minimum(value, pairs[name]).tolist())
        if name == "area"
        else min(value, pairs[name])
        for name, value in vars(one).items()
    }
    return Limits(**kept)
