"""Emulated rigs in virtual time, and what they truly do: the same on every run.

No thread and no real time: the host's clock is the clock of the emulated bus, which advances when
the host waits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import NamedTuple

import can
import numpy as np

from controllers.arrays import Array
from twin.devices.akd.config import AkdConfig, BusConfig
from twin.devices.akd.recording import Hear, TracedBus
from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.config import HID_PANELS, LumioConfig, ScreenError, Transport
from twin.devices.lumio.screen import LumioScreen
from twin.devices.realtime import RealTimeClock, Scheduling
from twin.devices.rig import HardwareRig
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.direct_bus import DirectBus
from twin.emulator.drive import EmulatedDrive
from twin.emulator.power_stage import Power
from twin.emulator.screen import Protocol, ScreenLine
from twin.emulator.serve import BALL_TIMEOUT_S, EmulatedPlant
from twin.hal.interface import PoweredScreen, Touch
from twin.hal.supervisor import State
from twin.run.controller_building import build_limits
from twin.scenario.schema import Scenario

_PLATE_ANGLE_INDICES, _PLATE_RATE_INDICES, _BALL_INDICES = [2, 6], [3, 7], [0, 4]


class PowerChange(NamedTuple):
    """A drive's power stage changes its state.

    Attributes:
        time: Bus time in s.
        axis: 0 for phi, 1 for theta.
        before: The state it was in.
        after: The state it is in now.
        lost: Whether it lost its torque by that.
        fault: Number of its newest fault, 0 if it has none.
        injected: Whether it was done to it, and is no answer of the rig.
    """

    time: float
    axis: int
    before: Power
    after: Power
    lost: bool
    fault: int
    injected: bool


class MotionTrace:
    """Follows a rig in lockstep from now on, through every step and frame of its bus.

    Args:
        rig: The rig; its first two drives are phi and theta.
    """

    def __init__(self, rig: LockstepRig) -> None:
        self.changes: list[PowerChange] = []
        """Events of the power stages, oldest first."""
        self._rig = rig
        self._drives = tuple(rig.lockstep.drives[:2])
        self._states = [drive.state for drive in self._drives]
        self._live = [drive.power.live for drive in self._drives]
        self._rows: list[tuple[float, Array]] = []
        self._moved = rig.lockstep.bus.moved
        rig.lockstep.bus.moved = self._step
        rig.lockstep.bus.heard = self._look

    def note_injection(self) -> None:
        """Take what the power stages did since the last frame for done to them."""
        self._look(injected=True)

    def state(self, axis: int, time: float) -> Power:
        """State of the axis 0 (phi) or 1 (theta) at a bus time in s."""
        changes = [each for each in self.changes if each.axis == axis]
        until = [each.after for each in changes if each.time <= time]
        if until:
            return until[-1]
        return changes[0].before if changes else self._states[axis]

    @property
    def live(self) -> bool:
        """Whether a drive has torque."""
        return any(drive.power.live for drive in self._drives)

    def between(self, begin: float, end: float = np.inf) -> TrueMotion:
        """The motion between two bus times, both in s."""
        rows = [(time, state) for time, state in self._rows if begin <= time <= end]
        state = np.array([state for _, state in rows]).reshape(len(rows), 8)
        time = np.array([time for time, _ in rows])
        return TrueMotion(
            time,
            *(
                state[:, each]
                for each in (_PLATE_ANGLE_INDICES, _PLATE_RATE_INDICES, _BALL_INDICES)
            ),
        )

    def _step(self, dt: float) -> None:
        self._moved(dt)
        self._look()
        self._rows.append((self._rig.now(), self._rig.plant.devices.state[0]))

    def _look(self, *, injected: bool = False) -> None:
        for axis, drive in enumerate(self._drives):
            before, after = self._states[axis], drive.state
            if after is not before:
                self._states[axis] = after
                fault = drive.power.faults[-1] if drive.power.faults else 0
                lost = self._live[axis] and not drive.power.live
                self._live[axis] = drive.power.live
                change = PowerChange(self._rig.now(), axis, before, after, lost, fault, injected)
                self.changes.append(change)


class TrueMotion(NamedTuple):
    """The true motion of plate and ball, one row per step of the bus.

    Attributes:
        time: Bus time in s, shape (n,).
        plate: Plate angles (phi, theta) in rad, shape (n, 2).
        rate: Plate rates in rad/s, shape (n, 2).
        ball: Position (x, y) of the ball in m in plate axes, shape (n, 2).
    """

    time: Array
    plate: Array
    rate: Array
    ball: Array

    @property
    def tilt(self) -> Array:
        """The larger plate angle of both axes in rad, shape (n,)."""
        return np.asarray(np.abs(self.plate).max(axis=1))

    @property
    def speed(self) -> Array:
        """The larger plate rate of both axes in rad/s, shape (n,)."""
        return np.asarray(np.abs(self.rate).max(axis=1))


class LockstepDrives:
    """Two emulated drives, the host's servos on them, in bus time.

    Args:
        config: The host's settings; the bus in them is not used.
        drives: Who is on the bus; phi and theta of the configuration by default.
    """

    STEPS = 4
    """Steps of the drives per control period."""

    def __init__(
        self, config: AkdConfig | None = None, drives: list[EmulatedDrive] | None = None
    ) -> None:
        self.config = replace(config or AkdConfig(), bus=BusConfig(interface="emulated"))
        nodes = [axis.node for axis in self.config.axes]
        self.drives = drives or [EmulatedDrive(node) for node in nodes]
        self.bus = EmulatedBus(self.drives)
        self.adapter = DirectBus(self.bus, self.config.period / self.STEPS)
        self.servos = AkdServos(
            self.config, opener=self._open, now=self.adapter.now, sleep=self.adapter.sleep
        )
        self.missing: Exception | None = None
        """With what opening the adapter fails; None where it is there."""
        self.heard: Hear | None = None
        """Receiver of every frame that the host sends or receives, in bus time."""

    def _open(self, _: BusConfig) -> can.BusABC:
        """Bus that the host opens.

        Raises:
            Exception: The adapter is not there.
        """
        if self.missing is not None:
            raise self.missing
        self.adapter.shutdown()
        self.bus.to_host()  # what went by before the adapter was there
        self.adapter = DirectBus(self.bus, self.config.period / self.STEPS)
        if self.heard is None:
            return self.adapter
        return TracedBus(self.adapter, self.heard, lambda: self.bus.time)

    def add_drive(self, node: int) -> None:
        """Put a further drive with a node on the bus."""
        self.bus.drives.append(EmulatedDrive(node))


class LockstepScreenPort(Transport):
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
        self._open()

    def _open(self) -> int:
        self.read(0.0)
        return -1

    def read(self, timeout: float) -> bytes:
        """Bytes that have arrived; never waits.

        Raises:
            ScreenError: It is unplugged.
        """
        data = b"".join(self._line.step(self._now()))
        if not self.plugged:
            raise ScreenError("touch screen emulated: hung up; was it unplugged?")
        return data

    def close(self) -> None:
        """Nothing to close."""


class LockstepScreen(LumioScreen):
    """The driver of the screen; it reads its port when it is asked, instead of in a thread."""

    def start(self) -> None:
        """Open the port."""
        self._begin()

    def stop(self) -> None:
        """Close the port."""
        super().stop()
        self._port.close()
        self.connected = False

    def read(self) -> Touch:
        """The newest plausible position, after reading the port."""
        self.listen()
        return super().read()


class LockstepRig(HardwareRig):
    """The hardware's rig on two emulated drives and an emulated screen around a simulated plant.

    Args:
        scenario: Its plant with its drives' and sensors' imperfections, the limits of what may be
            commanded, and the seed of everything random in the faults injected.
        config: The host's settings of the drives.
        touch: The host's settings of the screen; the port in them is not used.
        protocol: What the screen speaks.
        relaxed: Safety nets that are wider than by default, in words.
        other_screen: Makes a screen of a new kind on the plant, in bus time; a Lumio screen that
            speaks ``protocol`` by default.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        config: AkdConfig | None = None,
        touch: LumioConfig | None = None,
        protocol: Protocol = Protocol.MICROTOUCH,
        relaxed: Sequence[str] = (),
        other_screen: Callable[[EmulatedPlant, Callable[[], float]], PoweredScreen] | None = None,
    ) -> None:
        self.lockstep = LockstepDrives(config)
        self.plant = plant = EmulatedPlant(scenario)
        self.now, self.sleep = self.lockstep.adapter.now, self.lockstep.adapter.sleep
        """Bus time in s; lets some s of it pass."""
        self.line = plant.screen_line(plant.ball, protocol)
        self.touch = touch or LumioConfig(
            port="emulated",
            transport="hidraw" if protocol in HID_PANELS else "serial",
            protocol=str(protocol),
        )
        self.port = LockstepScreenPort(self.line, self.now)
        screen: PoweredScreen = LockstepScreen(self.touch, self.now, port=self.port)
        if other_screen is not None:
            screen = other_screen(plant, self.now)
        clock = RealTimeClock(self.lockstep.config.period, now=self.now, sleep=self.sleep, spin=0.0)
        super().__init__(
            servos=self.lockstep.servos,
            screen=screen,
            clock=clock,
            transmission=plant.transmission,
            limits=build_limits(scenario),
            patience=BALL_TIMEOUT_S,
            relaxed=relaxed,
            plate_lag=scenario.rig.plate_lag,
            axes=scenario.plant.axes,
            scheduling=lambda: nullcontext(Scheduling(False, False, ("bus time",))),
        )
        plant.attach(self.lockstep.drives)
        self.lockstep.bus.moved = plant.advance
        self.asked: Array | None = None
        """What the controller asks for from now on, whatever it is: plate rates in rad/s, (1, 2);
        None for its own."""
        self.stall = 0.0
        """Extra time in s that each period takes from now on."""
        self.uneven = 0.0
        """Extra time in s that every other command takes to be computed from now on."""
        self.hang = 0.0
        """Time in s for which the host does nothing at all, once."""

    def meanwhile(self, work: Callable[[], None]) -> None:
        """Do it in no time of the bus."""
        work()

    def write(self, rate: Array) -> Array:
        """Command plate rates in rad/s, shape (1, 2); return those applied."""
        if self.asked is not None and self.supervisor.state[0] == State.RUNNING:
            rate = self.asked
        if self.uneven and self.clock.tick % 2:
            self.sleep(self.uneven)
        return super().write(rate)

    def wait(self) -> None:
        """Return at the beginning of the next control period."""
        if self.stall or self.hang:
            idle, self.hang = self.stall + self.hang, 0.0
            self.sleep(idle)
        super().wait()
