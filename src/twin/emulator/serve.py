"""The virtual rig in real time: its adapter and screen are ports."""

from __future__ import annotations

import gc
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial

from twin.emulator.can_bus import EmulatedBus
from twin.emulator.can_server import BusServer
from twin.emulator.can_slcan import SlcanPort
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_settings import DriveSettings
from twin.emulator.screen import EmulatedScreen, ScreenLine
from twin.emulator.screen_bytes import Protocol
from twin.emulator.virtual import TICK, EmulatedPlant
from twin.scenario.load import Tables
from twin.scenario.schema import Scenario

STARVED = 0.001
"""Lag in s of every hundredth round from which the emulator is too slow for periods of 2 ms."""
BEGIN = "begin"
"""Word that says that the run's time is zero now; it has no answer."""


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
