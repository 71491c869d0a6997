"""A whole rig on emulated devices in bus time: no threads, no real time, the same every time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

from twin.devices.akd.config import AkdConfig
from twin.devices.lumio.config import LumioConfig
from twin.devices.lumio.screen import LumioScreen
from twin.devices.lumio.transports import ScreenError
from twin.devices.realtime import RealTimeClock
from twin.devices.rig import HardwareRig
from twin.devices.scheduling import Scheduling
from twin.emulator.can_rehearsal import Rehearsal
from twin.emulator.screen_bytes import Protocol
from twin.emulator.screen_faults import ScreenFault
from twin.emulator.screen_line import ScreenLine
from twin.emulator.virtual import VirtualBench
from twin.hal.interface import Touch
from twin.hal.limits import Limits
from twin.hal.rig import Transmission


class RehearsedPort:
    """The port of a screen in bus time.

    Args:
        line: The screen's end.
        now: Bus time in s.
    """

    def __init__(self, line: ScreenLine, now: Callable[[], float]) -> None:
        self.plugged = True
        self._line = line
        self._now = now

    def open(self) -> None:
        """Drop what has waited.

        Raises:
            ScreenError: It is unplugged.
        """
        self.read(0.0)

    def read(self, timeout: float) -> bytes:
        """What has arrived; never waits.

        Raises:
            ScreenError: It is unplugged.
        """
        data = b"".join(self._line.step(self._now()))
        if not self.plugged:
            raise ScreenError("touch screen emulated: hung up; was it unplugged?")
        return data

    def close(self) -> None:
        """Nothing to close."""


class RehearsedScreen(LumioScreen):
    """The driver of the screen, which listens when it is looked at instead of in a thread."""

    def start(self) -> None:
        """Open the port."""
        self._begin()

    def read(self) -> Touch:
        """The newest plausible position, after listening."""
        self.listen()
        return super().read()


class RehearsedRig(HardwareRig):
    """The hardware's rig on two emulated drives and an emulated screen around a simulated plant.

    Args:
        bench: The plant with its drives' and sensors' imperfections.
        transmission: Plate angles to motor angles.
        limits: What may be commanded.
        config: The host's settings of the drives.
        touch: The host's settings of the screen; the port in them is not looked at.
        protocol: What the screen speaks.
        seed: Of everything random in the faults injected.
    """

    def __init__(
        self,
        bench: VirtualBench,
        *,
        transmission: Transmission,
        limits: Limits,
        config: AkdConfig | None = None,
        touch: LumioConfig | None = None,
        protocol: Protocol = Protocol.MICROTOUCH,
        seed: int = 0,
    ) -> None:
        self.rehearsal = Rehearsal(config)
        self.bench = bench
        adapter = self.rehearsal.adapter
        self.line = ScreenLine(bench.ball, protocol=protocol, seed=seed, dead_time=bench.dead_time)
        now = adapter.now
        chosen = touch or LumioConfig(port="emulated", protocol=str(protocol))
        self.port = RehearsedPort(self.line, now)
        screen = RehearsedScreen(chosen, now, port=self.port)
        clock = RealTimeClock(
            self.rehearsal.config.period, now=self.now, sleep=self.sleep, spin=0.0
        )
        super().__init__(
            servos=self.rehearsal.servos,
            screen=screen,
            clock=clock,
            transmission=transmission,
            limits=limits,
            patience=1.0,
            scheduling=lambda: nullcontext(Scheduling(False, False, ("bus time",))),
        )
        bench.attach(self.rehearsal.drives)
        self.rehearsal.bus.moved = bench.advance
        self.stall = 0.0
        """Extra time in s that each period takes from now on."""

    def now(self) -> float:
        """Bus time in s."""
        return self.rehearsal.adapter.now()

    def sleep(self, seconds: float) -> None:
        """Let the bus's time pass."""
        self.rehearsal.adapter.sleep(seconds)

    def wait(self) -> None:
        """Return at the beginning of the next control period."""
        if self.stall:
            self.sleep(self.stall)
        super().wait()

    def inject(self, fault: ScreenFault, lasting: float) -> None:
        """Put a fault of the screen in force from now on, for a time in s."""
        self.line.damage.inject(fault, self.now() + lasting)
