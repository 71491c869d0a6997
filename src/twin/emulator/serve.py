"""The virtual rig in real time, or in a separate process: its adapter and screen are ports."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from twin.emulator.can_bus import BusServer, EmulatedBus
from twin.emulator.can_slcan import SlcanPort
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_settings import DriveSettings
from twin.emulator.pseudo_terminal import check_pseudo_terminals
from twin.emulator.screen import EmulatedScreen, ScreenLine
from twin.emulator.screen_bytes import Protocol
from twin.emulator.virtual import TICK, EmulatedPlant
from twin.errors import RigError
from twin.scenario.load import Tables
from twin.scenario.schema import Scenario

STARVED = 0.001
"""Lag in s of every hundredth round from which the emulator is too slow for periods of 2 ms."""
PRIORITY = 70
"""Of SCHED_FIFO: before every ordinary process, after the host's loop (80)."""
BEGIN = "begin"
"""Word that says that the run's time is zero now; it has no answer."""
START = 60.0
"""Longest time in s that the process may take to start."""


class VirtualRig:
    """Two drives on an adapter, a screen on a port, and the plant between them; a context manager.

    Args:
        scenario: Whose plant it is.
        protocol: What the screen speaks.

    Raises:
        ModelError: The mechanism or its cam table cannot be used.
        RigError: This system has no pseudo-terminals.
    """

    def __init__(self, scenario: Scenario, protocol: Protocol = Protocol.MICROTOUCH) -> None:
        self.plant = EmulatedPlant(scenario)
        self.drives = [EmulatedDrive(DriveSettings(node=node)) for node in (1, 2)]
        self.bus = EmulatedBus(self.drives)
        self.adapter = SlcanPort(self.bus)
        self.server = BusServer(self.bus, self.adapter, step=TICK)
        self.screen = EmulatedScreen(
            ScreenLine(
                self._ball,
                protocol=protocol,
                dead_time=lambda: self.plant.dead_time,
                seed=scenario.seed,
            )
        )
        self._finger: tuple[float, float] | None = None
        self.plant.attach(self.drives)
        self.bus.moved = self.plant.advance
        self._open = ExitStack()

    def __enter__(self) -> VirtualRig:
        with ExitStack() as opened:
            opened.enter_context(self.adapter)
            opened.enter_context(self.screen)
            self._open = opened.pop_all()
        gc.collect()
        gc.freeze()  # a collection of everything takes longer than a period
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()
        gc.unfreeze()

    def tables(self) -> Tables:
        """The rig file that a host needs to find it."""
        serial = self.screen.protocol in {Protocol.MICROTOUCH, Protocol.ELO}
        return {
            "title": "emulated",
            "bus": {
                "interface": "slcan",
                "channel": str(self.adapter.channel),
                "options": {"sleep_after_open": 0.0},
            },
            # A process answers less steadily than a drive does.
            "drives": {"watch": {"unsteady": 25, "stale": 25}},
            "touch": {
                "port": str(self.screen.path),
                "transport": "serial" if serial else "hidraw",
                "protocol": str(self.screen.protocol),
            },
        }

    def obey(self, word: str) -> str:
        """Do something to it while it runs: press its STO button, take the ball away, ...

        Args:
            word: sto, release, lift, put, unplug, plug, or touch and where, in mm; lag; watch and
                edge: the ball is lifted, and which edges of the plate dipped since, short or long.

        Returns:
            What was done or seen, or for an unknown word what can be.
        """
        if word == "lag":
            return self.lag
        if word in {"watch", "edge"}:
            with self.server.lock:
                self.plant.present = False
                return self.plant.edge()
        known: dict[str, tuple[str, Callable[[], None]]] = {
            "sto": ("STO open: both drives without torque", self._open_sto),
            "release": ("STO closed; reset the faults to go on", self._close_sto),
            "lift": ("ball lifted", partial(self._put, False)),
            "put": ("ball put back", partial(self._put, True)),
            "unplug": ("touch screen unplugged", self.screen.unplug),
            "plug": ("touch screen plugged in", self.screen.replug),
            BEGIN: ("the run begins", self.plant.begin),
        }
        text, act = known.get(word) or self._touch(word)
        with self.server.lock:
            act()
        return text or f"known: {', '.join(known)}, touch X Y"

    def _touch(self, word: str) -> tuple[str, Callable[[], None]]:
        """What ``touch X Y`` does; nothing if it says something else."""
        match word.split():
            case ["touch", x, y]:
                with suppress(ValueError):
                    place = float(x) / 1e3, float(y) / 1e3
                    return f"touched at x {x}, y {y} mm", partial(self._put, False, place)
        return "", lambda: None

    @property
    def lag(self) -> str:
        """How far the emulated bus was behind the clock, in words."""
        with self.server.lock:
            late = self.server.lag.as_dict()
        p99, longest = late["p99_us"] / 1e3, late["max_us"] / 1e3
        starved = "; it starved, so answers came late" if p99 > 1e3 * STARVED else ""
        return f"emulated rig behind the clock: p99 {p99:.2f} ms, at most {longest:.1f} ms{starved}"

    def _open_sto(self) -> None:
        for drive in self.drives:
            drive.open_sto()

    def _close_sto(self) -> None:
        for drive in self.drives:
            drive.close_sto()

    def _put(self, present: bool, finger: tuple[float, float] | None = None) -> None:
        back = present and not self.plant.present
        self.plant.present = present
        self._finger = finger
        if back and not any(drive.enabled for drive in self.drives):
            self.plant.restart()  # whoever puts it back puts it where it was, on a level plate

    def _ball(self) -> tuple[tuple[float, float], ...]:
        with self.server.lock:
            return self.plant.ball() if self._finger is None else (self._finger,)


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
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            return
    with suppress(OSError, AttributeError):
        os.nice(-10)


def _work(pipe: Connection, scenario: Scenario, protocol: Protocol) -> None:
    """The body of the process: serve until the pipe is closed, obeying what comes through it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the host
    come_forward()
    with VirtualRig(scenario, protocol) as rig:
        pipe.send(rig.tables())
        listener = threading.Thread(target=_listen, args=(pipe, rig), daemon=True)
        listener.start()
        rig.server.run()


def _listen(pipe: Connection, rig: VirtualRig) -> None:
    """Obey what comes through the pipe until its other end is closed."""
    while True:
        try:
            word = pipe.recv()
            answer = rig.obey(word)
            if word != BEGIN:
                pipe.send(answer)
        except (EOFError, OSError):
            rig.server.stop()
            return


class Emulator:
    """A virtual rig in another process.

    Args:
        process: The process.
        pipe: The way to it.
        tables: The rig file that a host needs.
    """

    def __init__(
        self, process: multiprocessing.context.SpawnProcess, pipe: Connection, tables: Tables
    ) -> None:
        self.tables = tables
        self._process, self._pipe = process, pipe

    def tell(self, word: str) -> str:
        """Do something to the rig, as ``VirtualRig.obey`` says; what was done."""
        self._pipe.send(word)
        answer: Any = self._pipe.recv()
        return str(answer)

    def begin(self) -> None:
        """Say that the run's time is zero now; waits for nothing."""
        self._pipe.send(BEGIN)

    @property
    def pid(self) -> int:
        """Its process."""
        return self._process.pid or os.getpid()


@contextmanager
def emulated(scenario: Scenario, protocol: Protocol = Protocol.MICROTOUCH) -> Iterator[Emulator]:
    """A virtual rig in a separate process, for as long as the context lasts.

    Raises:
        RigError: It does not start, or this system has no pseudo-terminals.
    """
    check_pseudo_terminals()
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, scenario, protocol), daemon=True)
    process.start()
    theirs.close()
    try:
        with _apart(process.pid or 0):
            yield Emulator(process, ours, _rig_file(ours))
    finally:
        ours.close()
        process.join(2.0)
        if process.is_alive():
            process.kill()
            process.join()


def _rig_file(pipe: Connection) -> Tables:
    """What the process sends when it serves.

    Raises:
        RigError: It has ended, or takes too long.
    """
    with suppress(EOFError):
        if pipe.poll(START):
            tables: Tables = pipe.recv()
            return tables
    raise RigError("emulated rig: its process did not start; run ballplate emulate to see why")
