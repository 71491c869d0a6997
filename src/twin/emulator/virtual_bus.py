"""Emulated drives on a bus that hosts reach, in real time, and what can be done to them."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

from twin.emulator.bus_name import BusName
from twin.emulator.can_bus import BusServer, EmulatedBus, SlcanPort
from twin.emulator.control import BusControl, ControlError
from twin.emulator.node import EmulatedNode

if TYPE_CHECKING:
    from twin.emulator.bus_port import BusPort

STARVED_LAG_S = 0.001
"""Lag in s of every hundredth round from which the emulator is too slow for periods of 2 ms."""


class VirtualBus:
    """A bus with drives, where hosts reach it, and who obeys about it; a context manager.

    Args:
        drives: The drives.
        name: A bus of python-can that hosts use; None for an adapter on a pseudo-terminal.
        step: Step in s.

    Raises:
        RigError: The bus cannot be opened, or this system has no pseudo-terminals.
    """

    def __init__(
        self,
        drives: Sequence[EmulatedNode],
        name: BusName | None = None,
        step: float = 0.0005,
    ) -> None:
        self.drives = list(drives)
        self.bus = EmulatedBus(self.drives)
        self.adapter = SlcanPort(self.bus) if name is None else _bus_port(self.bus, name)
        self.server = BusServer(self.bus, self.adapter, step=step)
        self._control = BusControl(self.bus)
        self._open = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(self.adapter)
            self._enter(opened)
            self._open = opened.pop_all()
        gc.collect()
        gc.freeze()  # a collection of everything takes longer than a period
        return self

    def _enter(self, opened: ExitStack) -> None:
        """Bring up what else is served."""

    def __exit__(self, *_: object) -> None:
        self._open.close()
        gc.unfreeze()

    @property
    def place(self) -> BusName:
        """Where a host reaches the bus."""
        if isinstance(self.adapter, SlcanPort):
            return BusName("slcan", str(self.adapter.path))
        return self.adapter.name

    def control(self, line: str) -> str:
        """Do something to drives or bus while they run, by a line of `twin.emulator.control`.

        Raises:
            ControlError: The line cannot be obeyed.
        """
        if line == "lag":
            return self.lag
        with self.server.lock:
            return self._control.obey(line)

    def obey(self, word: str) -> str:
        """Result of `control`, or why it did nothing."""
        try:
            return self.control(word)
        except ControlError as error:
            return str(error)

    @property
    def lag(self) -> str:
        """How far the emulated bus was behind the clock, in words."""
        with self.server.lock:
            late = self.server.lag.as_dict()
        p99, longest = late["p99_us"] / 1e3, late["max_us"] / 1e3
        starved = "; it starved, so answers came late" if p99 > 1e3 * STARVED_LAG_S else ""
        return f"emulated rig behind the clock: p99 {p99:.2f} ms, at most {longest:.1f} ms{starved}"


def _bus_port(bus: EmulatedBus, name: BusName) -> BusPort:
    from twin.emulator.bus_port import BusPort  # noqa: PLC0415  loads python-can

    return BusPort(bus, name)
