"""The host's servos on emulated drives, cycle by cycle and without real time: repeatable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

from twin.devices.akd.config import AkdConfig, BusConfig
from twin.devices.akd.servos import AkdServos
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.can_direct import DirectBus
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_settings import DriveSettings
from twin.hal.faults import Fault

Rates = Callable[[float], tuple[float, float]]


class Seen(NamedTuple):
    """A fault, and the bus time in s at which it was reported."""

    time: float
    fault: Fault

    @property
    def name(self) -> str:
        """Name of the condition."""
        return self.fault.condition.name


def still(_: float) -> tuple[float, float]:
    """No motion."""
    return 0.0, 0.0


class Rehearsal:
    """Two emulated drives, the host's servos on them, and one loop; a context manager.

    Args:
        config: The host's settings; the bus in them is not looked at.
        drives: Who is on the bus; phi and theta of the configuration by default.
    """

    STEPS = 4
    """Steps of the drives in a control period."""

    def __init__(
        self, config: AkdConfig | None = None, drives: list[EmulatedDrive] | None = None
    ) -> None:
        self.config = replace(config or AkdConfig(), bus=BusConfig(interface="emulated"))
        nodes = [axis.node for axis in self.config.axes]
        self.drives = drives or [EmulatedDrive(DriveSettings(node=node)) for node in nodes]
        self.bus = EmulatedBus(self.drives)
        self.adapter = DirectBus(self.bus, self.config.period / self.STEPS)
        self.servos = AkdServos(
            self.config, opener=self._open, now=self.adapter.now, sleep=self.adapter.sleep
        )
        self.seen: list[Seen] = []
        """All faults so far."""

    def _open(self, _: BusConfig) -> DirectBus:
        self.adapter.shutdown()
        self.adapter = DirectBus(self.bus, self.config.period / self.STEPS)
        return self.adapter

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.servos.stop()
        self.adapter.shutdown()

    def enabled(self) -> Self:
        """Start and enable, and run until both drives follow.

        Raises:
            DriveError: If a drive cannot be brought up.
        """
        self.servos.start()
        self.servos.enable()
        for _ in range(50):
            if self.servos.enabled:
                break
            self.run(self.config.period)
        return self

    def run(self, seconds: float, rates: Rates = still) -> list[Seen]:
        """Run the loop; rates: motor rates in rad/s by bus time. The faults that came up."""
        before = len(self.seen)
        for _ in range(round(seconds / self.config.period)):
            self.servos.receive()
            self.servos.command(np.array([rates(self.bus.time)]))
            self.servos.send()
            time = self.bus.time
            self.seen.extend(Seen(time, fault) for fault in self.servos.faults())
            self.adapter.sleep(self.config.period)
        return self.seen[before:]
