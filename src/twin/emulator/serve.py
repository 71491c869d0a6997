"""The virtual rig in real time: a plant behind emulated devices with ports that a host opens.

It serves in a process of its own, which comes before every ordinary one.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator, MutableSequence, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from importlib.resources import files
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import RawArray
from string import Template
from typing import Any, NamedTuple, Protocol

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import time_constant
from twin.base.errors import RigError
from twin.base.jobs import let_go, spawn
from twin.base.settings import from_scenarios
from twin.emulator.bus_name import BusName
from twin.emulator.can_bus import (
    PseudoTerminal,
    check_pseudo_terminals,
)
from twin.emulator.control import UnknownLineError, place_of_touch
from twin.emulator.drive import EmulatedDrive, Motor
from twin.emulator.load import ShaftLoad
from twin.emulator.profile_drive import ProfileDrive
from twin.emulator.screen import Ball, ScreenLine
from twin.emulator.screen import Protocol as ScreenProtocol
from twin.emulator.virtual_bus import VirtualBus
from twin.hal.interface import Touch, Transmission
from twin.run.assemble import build_devices
from twin.run.plants import build_plant, start_plant
from twin.scenario.merging import Tables
from twin.scenario.schema import Scenario
from twin.sim.drives import DriveModel
from twin.sim.rig import SimulatedDevices
from twin.sim.sensors import EncoderModel, TouchModel

MAX_PLANT_STEP_S = 0.001
"""Longest step in s of the plant between two looks at the drives."""


STOP_MARGIN_RAD = float(np.radians(5.0))
"""How far beyond the limit of its angle a plate meets its mechanical stop, rad; assumed.

The stops of the rig, at 10 deg (thesis, chapter 3), would hide what the host does."""


LONGER_GAP_PROBABILITY = 1e-8
"""Probability that more frames of a screen in a row are lost than the limits of its host allow."""
NOTICE_DELAY_S = 0.01
"""Longest time in s until a host notices a frame that has arrived."""
BALL_TIMEOUT_S = 1.0
"""Time in s that a host in lockstep with its emulated rig waits for the ball."""


class Wiring(NamedTuple):
    """How motors and plate encoders are joined to the drives, and motors to the plate.

    Each is a pair: for the drive of phi, then of theta; of ``slip`` for the axes of the plate.

    Attributes:
        motors: Axis of the motor that the drive turns, 0 for phi.
        encoders: Axis of the plate encoder that it reads.
        motor_scale: Turn of the shaft per turn of the drive; -1 for the wrong way.
        encoder_scale: Angle that it reads per angle of the plate; -1 for the wrong way.
        slip: Share of the motor's turn that does not reach the plate.
    """

    motors: tuple[int, int] = (0, 1)
    encoders: tuple[int, int] = (0, 1)
    motor_scale: tuple[float, float] = (1.0, 1.0)
    encoder_scale: tuple[float, float] = (1.0, 1.0)
    slip: tuple[float, float] = (0.0, 0.0)


class Turning(Protocol):
    """A drive that turns a shaft of a plant."""

    @property
    def rate(self) -> float:
        """Rate in rad/s with which it turns the shaft."""

    @property
    def enabled(self) -> bool:
        """Whether it follows its commands."""

    @property
    def motor(self) -> Motor | ShaftLoad:
        """Its shaft."""


class EmulatedPlant:
    """A scenario's plant, with its noise and its drives' imperfections, for emulated devices.

    Dead time, frames and quantisation are those of the emulated devices; the screen's frames come,
    are late and get lost as the scenario's, if that has some.

    Args:
        scenario: The owner of the plant.

    Raises:
        ModelError: The mechanism or its cam table cannot be used.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        plant, self.transmission = build_plant([scenario])
        self._tick = plant.step * max(1, int(MAX_PLANT_STEP_S / plant.step + 1e-9))
        at_once: Any = {"dead_time": 0.0, "spread": 0.0, "frame_rate": 0.0, "grid": 0}
        self.devices: SimulatedDevices = build_devices(
            [scenario],
            plant,
            period=self._tick,
            touch=replace(from_scenarios(TouchModel, [scenario]), **at_once),
            encoders=EncoderModel(counts=0, variance=scenario.sensors.encoders.variance),
        )
        self.present = True
        """Whether there is a ball that the screen can sense."""
        self.shoved = np.zeros(2)
        """Rates in rad/s by which somebody turns the motor shafts besides the drives."""
        self.wiring = Wiring()
        """How drives, motors and encoders are joined; what is wrong with it may be put here."""
        self.stop = float(np.max(scenario.rig.limits.angle_deg)) * np.pi / 180 + STOP_MARGIN_RAD
        """Plate angle in rad at which each axis meets its mechanical stop."""
        self._slipped = np.zeros(2)
        """Motor angles in rad that have not reached the plate."""
        self._angles = np.zeros((2, 2))
        """Shaft and plate angle of each drive as it is joined now, rad."""
        self._shown = np.zeros((2, 2))
        """What is added to shaft and plate angle of each drive in rad, so that none has jumped."""
        self._owed = 0.0
        self._drives: Sequence[Turning] = ()

    transmission: Transmission
    """Plate angles to motor angles, as the scenario's rig knows them."""

    _touch: Touch
    """Present touch of the screen."""

    @property
    def lost(self) -> float:
        """Plate angle in rad that its drive train may take between motor and plate."""
        servo = from_scenarios(DriveModel, [self._scenario])
        soft = 0.0
        if servo.resonance:
            limits = self._scenario.rig.limits
            # twice the swing of a step of the acceleration, after one the other way
            soft = 8 * limits.acceleration / (2 * np.pi * servo.resonance) ** 2
        return float(np.max(servo.backlash + servo.hysteresis + soft))

    @property
    def kept_back(self) -> float:
        """Motor angle in rad by which its servos may stay behind the commanded one."""
        servo = from_scenarios(DriveModel, [self._scenario])
        plate = np.full((1, 2), servo.deadband + servo.resolution)
        turn = self.transmission.motor(plate) - self.transmission.motor(0 * plate)
        return float(np.abs(turn).max())

    @property
    def shaft_lag(self) -> float:
        """Time constant in s with which its shafts follow the drives' velocities."""
        servo = from_scenarios(DriveModel, [self._scenario])
        return float(servo.dead_time) + time_constant(float(servo.bandwidth))

    @property
    def longest_gap(self) -> float:
        """Longest time in s between frames of its screen, but for `LONGER_GAP_PROBABILITY`."""
        screen = from_scenarios(TouchModel, [self._scenario])
        if not screen.frame_rate:
            return 0.0
        frame = 1 / float(screen.frame_rate)
        missing = (
            math.ceil(math.log(LONGER_GAP_PROBABILITY) / math.log(screen.lost))
            if screen.lost
            else 0
        )
        early = min(3 * float(screen.jitter), frame / 2) + 3 * float(screen.spread)
        return (1 + missing) * frame + 2 * early + NOTICE_DELAY_S

    def attach(self, drives: Sequence[Turning]) -> None:
        """Let the drives, phi then theta, move the plant and read its encoders."""
        self._drives = drives[:2]
        self._sense()

    def screen_line(self, ball: Ball, protocol: ScreenProtocol) -> ScreenLine:
        """The data of a screen on it that speaks a protocol and senses the places of ``ball``."""
        seen, frames = self._scenario.sensors.touch, {}
        if rate := seen.frame_rate:
            frames = {"frame": 1 / rate, "jitter": seen.jitter, "lost": seen.lost}
        late = {"dead_time": seen.dead_time, "spread": seen.dead_time_spread}
        return ScreenLine(ball, protocol=protocol, seed=self._scenario.seed, **late, **frames)

    def advance(self, seconds: float) -> None:
        """Let time pass in whole ticks; the rest is kept for the next call."""
        self._owed += seconds
        while self._owed > self._tick - 1e-9:
            self._owed -= self._tick
            if not any(drive.enabled for drive in self._drives):
                self.devices.rest()
            self.devices.command(self._rates() + self.shoved)
            self.devices.wait()
            self._sense()

    def _rates(self) -> Array:
        """Rates in rad/s with which the drives turn the shafts, shape (1, 2).

        A plate at its stop keeps its motor, and so the drive, from turning further.
        """
        wiring, rates = self.wiring, np.zeros((1, 2))
        angles = self.devices.state[0, 2::4]
        for drive, axis, scale in zip(
            self._drives, wiring.motors, wiring.motor_scale, strict=False
        ):
            drive.motor.forced = float(self.shoved[axis]) / scale
            rate = scale * drive.rate
            if abs(angles[axis]) >= self.stop and rate * angles[axis] > 0:
                drive.motor.rate = rate = 0.0
            self._slipped[axis] += self._tick * wiring.slip[axis] * rate
            rates[0, axis] = (1 - wiring.slip[axis]) * rate
        return rates

    def restart(self) -> None:
        """Put the ball back to where the scenario starts, the plate level."""
        start_plant(self.devices.plant, [self._scenario])
        self.devices.command(np.zeros((1, 2)))
        self.devices.wait()
        self._sense()

    def ball(self) -> tuple[tuple[float, float], ...]:
        """Where the ball touches the screen, m in plate axes; empty if it does not."""
        if not self.present or not self._touch.touched[0]:
            return ()
        x, y = self._touch.position[0].tolist()
        return ((x, y),)

    def _sense(self) -> None:
        # sensors are read once a tick, however seldom a screen looks: their noise is drawn by it
        self._touch = self.devices.read()
        self._join()
        for drive, shown in zip(self._drives, self._angles + self._shown, strict=False):
            drive.motor.sense(*shown.tolist())

    def _join(self) -> None:
        """Lead the angles of shafts and plate to the drives that they are wired to."""
        wiring = self.wiring
        plate = self.devices.plate()[0].tolist()
        motor = (self.devices.motor()[0] + self._slipped).tolist()
        for index in (0, 1):
            shaft = motor[wiring.motors[index]] / wiring.motor_scale[index]
            angle = wiring.encoder_scale[index] * plate[wiring.encoders[index]]
            self._angles[index] = shaft, angle

    def rewire(self, **wiring: Any) -> None:
        """Join drives, motors and encoders otherwise from now on; no counter jumps.

        Args:
            wiring: Fields of `Wiring`.
        """
        before = self._angles.copy()
        self.wiring = self.wiring._replace(**wiring)
        self._join()
        self._shown += before - self._angles
        self._sense()


class VirtualRig(VirtualBus):
    """Two drives on a bus, a screen on a port, and the plant between them; a context manager.

    Args:
        scenario: The owner of the plant.
        protocol: What the screen speaks.
        drives: The drives of phi and theta; two AKD drives, nodes 1 and 2, by default.
        name: A bus of python-can that hosts use; None for an adapter on a pseudo-terminal.

    Raises:
        ModelError: The mechanism or its cam table cannot be used.
        RigError: The bus cannot be opened, or this system has no pseudo-terminals.
    """

    def __init__(
        self,
        scenario: Scenario,
        protocol: ScreenProtocol = ScreenProtocol.MICROTOUCH,
        drives: Sequence[EmulatedDrive | ProfileDrive[ShaftLoad]] | None = None,
        name: BusName | None = None,
    ) -> None:
        self.plant = EmulatedPlant(scenario)
        turning = drives or [EmulatedDrive(node) for node in (1, 2)]
        super().__init__(turning, name, MAX_PLANT_STEP_S)
        self.line = self.plant.screen_line(self._ball, protocol)
        self.screen = PseudoTerminal("lumio")
        self.server.second_port = self._show
        self._finger: tuple[float, float] | None = None
        self.plant.attach(turning)
        self.bus.moved = self.plant.advance

    def _enter(self, opened: ExitStack) -> None:
        opened.enter_context(self.screen).plug()

    def rig_file(self) -> str:
        """The text of the rig file that a host needs to find it."""
        serial = self.line.protocol in {ScreenProtocol.MICROTOUCH, ScreenProtocol.ELO}
        interface, channel, _ = self.place
        return Template((files("twin.emulator") / "rig.toml").read_text("utf-8")).substitute(
            phi=self.drives[0].node,
            theta=self.drives[1].node,
            interface=interface,
            channel=channel,
            options="{ sleep_after_open = 0.0 }" if interface == "slcan" else "{}",
            screen=self.screen.path,
            transport="serial" if serial else "hidraw",
            protocol=self.line.protocol,
            travel=min(0.005 + self.plant.kept_back, 0.1),  # its default, and the most it may be
            lost=min(0.6 + float(np.degrees(self.plant.lost)), 5.0),
            shaft_lag=min(self.plant.shaft_lag, 0.5),
            stale=min(max(0.06, self.plant.longest_gap), 1.0),
            gone=min(max(0.1, self.plant.longest_gap + 0.04), 1.0),
        )

    def tables(self) -> Tables:
        """The tables of that file."""
        return tomllib.loads(self.rig_file())

    def control(self, line: str) -> str:
        """Do something to it while it runs: press its STO button, take the ball away, ...

        Args:
            line: sto, release, lift, put, unplug, plug, or touch and where, in mm; lag; or a line
                of `twin.emulator.control`.

        Returns:
            What was done or seen.

        Raises:
            ControlError: The line cannot be obeyed.
        """
        known: dict[str, tuple[str, Callable[[], None]]] = {
            "sto": ("STO open: both drives without torque", partial(self._close_sto, False)),
            "release": ("STO closed; reset the faults to go on", partial(self._close_sto, True)),
            "lift": ("ball lifted", partial(self._put, False)),
            "put": ("ball put back", partial(self._put, True)),
            "unplug": ("touch screen unplugged", self.screen.unplug),
            "plug": ("touch screen plugged in", self.screen.plug),
        }
        text, act = known.get(line) or self._touch(line)
        if text:
            with self.server.lock:
                act()
            return text
        try:
            return super().control(line)
        except UnknownLineError as error:
            more = str(error).removeprefix("known: ")
            raise UnknownLineError(f"known: {', '.join(known)}, touch X Y, lag; {more}") from None

    def _touch(self, word: str) -> tuple[str, Callable[[], None]]:
        """The effect of ``touch X Y``; none of any other text.

        Raises:
            ControlError: It has not two numbers of -1000 to 1000.
        """
        if word.split()[:1] != ["touch"]:
            return "", lambda: None
        x, y = place = place_of_touch(word)
        text = f"touched at x {1e3 * x:g}, y {1e3 * y:g} mm"
        return text, partial(self._put, False, place)

    def _close_sto(self, closed: bool) -> None:
        for drive in self.drives:
            drive.power.sto_closed = closed

    def _put(self, present: bool, finger: tuple[float, float] | None = None) -> None:
        back = present and not self.plant.present
        self.plant.present = present
        self._finger = finger
        if back and not any(drive.enabled for drive in self.drives):
            self.plant.restart()  # whoever puts it back puts it where it was, on a level plate

    def _ball(self) -> tuple[tuple[float, float], ...]:
        return self.plant.ball() if self._finger is None else (self._finger,)

    def _show(self, now: float) -> None:
        """Send what the screen has to say by a time in s.

        A pseudo-terminal knows no baud rate: bytes are sent at their pace. A reader that does not
        read loses the newest, as on a real line.
        """
        for part in self.line.step(now):
            self.screen.write(part)


EMULATOR_PRIORITY = 70
"""Of SCHED_FIFO: before every ordinary process, after the host's loop (80)."""
ENDED_MESSAGE = "emulated rig: its process has ended; was it killed?"
EMULATOR_START_TIMEOUT_S = 60.0
"""Longest time in s that the process may take to start."""


class PauseWatch:
    """Shared times of two processes in real time, to find out when their computer paused.

    One that does not come round may have computed for long. Where the other did not come round
    either, the computer had no time for both. The host, side 0, waits for an emulator that has no
    processor: drives of a real rig need none.

    Args:
        cells: Six numbers that both share.
        side: 0 or 1.
    """

    LONG = 0.004
    """Time in s without coming round that may be a pause."""
    MOST = 0.1
    """Longest time in s that the host waits; who has not come round then has ended or hangs."""

    def __init__(self, cells: MutableSequence[float], side: int) -> None:
        self._cells, self._own, self._other = cells, 3 * side, 3 - 3 * side
        self._waits, self._left = side == 0, 0.0

    def paused(self, begin: float, end: float) -> float:
        """How long, s, neither loop came round; 0 where one's own did within ``LONG``.

        Args:
            begin: When one's own loop came round last, s.
            end: Now, s.
        """
        cells, own = self._cells, self._own
        if self._waits:
            end = self._waited(end)
        late = end - begin > self.LONG
        if late:
            if begin - cells[own + 2] > self.LONG:  # else one gap: who looks late sees it whole
                cells[own + 1] = begin
            cells[own + 2] = end
        cells[own] = end  # last: a reader that sees the buffer wrap then finds this end
        if not late:
            return 0.0
        seen, since, until = (cells[self._other + each] for each in range(3))
        lost = max(0.0, min(end, until) - max(begin, since))  # missed by the other's own report
        if seen and end - seen > self.LONG:
            lost += end - max(begin, seen)
        return lost

    def _waited(self, now: float) -> float:
        """The time in s when the other one has come round lately, or is waited for no longer."""
        seen, until = self._cells[self._other], now + self.MOST
        if not seen or seen == self._left or now - seen <= self.LONG:
            return now
        while self._cells[self._other] == seen and now < until:
            time.sleep(2e-4)
            now = time.monotonic()
        self._left = seen if now >= until else 0.0
        return now


@contextmanager
def _apart(process: int) -> Iterator[None]:
    """Meanwhile, keep a process and this one on different processors, where that is possible."""
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if len(allowed) < 2:
        yield
        return
    own = max(allowed)
    os.sched_setaffinity(process, {own})
    os.sched_setaffinity(0, allowed - {own})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def come_forward() -> None:
    """Raise this process's priority where that is permitted: real devices need no processor.

    Its later threads have it, too. Otherwise a busy machine would let the emulated drives answer
    late, which looks like an overloaded host.
    """
    if sys.platform == "linux":
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(EMULATOR_PRIORITY))


def _work(pipe: Connection, scenario: Scenario, cells: MutableSequence[float]) -> None:
    """The body of the process: serve until the pipe is closed, obeying what comes through it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the host
    come_forward()
    with VirtualRig(scenario) as rig:
        try:
            pipe.send(rig.tables())
        except OSError:
            return  # the host has ended meanwhile
        listener = threading.Thread(target=_listen, args=(pipe, rig), daemon=True)
        listener.start()
        rig.server.paused = PauseWatch(cells, 1).paused
        rig.server.run()


def _listen(pipe: Connection, rig: VirtualRig) -> None:
    """Obey what comes through the pipe until its other end is closed."""
    while True:
        try:
            pipe.send(rig.obey(pipe.recv()))
        except (EOFError, OSError):
            rig.server.stop()
            return


class Emulator:
    """A virtual rig in a process of its own.

    Args:
        pipe: The way to it.
        tables: The rig file that a host needs.
        pauses: Tells when the computer paused.
    """

    def __init__(self, pipe: Connection, tables: Tables, pauses: PauseWatch) -> None:
        self._pipe, self.tables, self.pauses = pipe, tables, pauses

    def tell(self, word: str) -> str:
        """Pass a word to ``VirtualRig.obey``; return the effect.

        Raises:
            RigError: Its process has ended.
        """
        try:
            self._pipe.send(word)
            return str(self._pipe.recv())
        except (EOFError, OSError) as error:
            raise RigError(ENDED_MESSAGE) from error

    def lag(self) -> str:
        """How far it lagged behind real time, or that it has ended, in words."""
        try:
            return self.tell("lag")
        except RigError as error:
            return str(error)


@contextmanager
def serve_rig(scenario: Scenario) -> Iterator[Emulator]:
    """A virtual rig in a separate process, for as long as the context lasts.

    Raises:
        RigError: It does not start, or this system has no pseudo-terminals.
    """
    check_pseudo_terminals()
    ours, theirs = multiprocessing.Pipe()
    cells = RawArray("d", 6)
    process = spawn(_work, theirs, scenario, cells)
    theirs.close()
    try:
        with _apart(process.pid or 0):
            yield Emulator(ours, _rig_file(ours), PauseWatch(cells, 0))
    finally:
        ours.close()
        process.join(2.0)
        let_go(process)


def _rig_file(pipe: Connection) -> Tables:
    """What the process sends when it serves.

    Raises:
        RigError: It has ended, or takes too long.
    """
    with suppress(EOFError):
        if pipe.poll(EMULATOR_START_TIMEOUT_S):
            return pipe.recv()
    raise RigError("emulated rig: its process did not start; run ballplate emulate to see why")
