"""The emulated bus on python-can's in-process bus, for tests."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import can

from twin.emulator.can_bus import EmulatedBus
from twin.emulator.can_faults import BusFaults
from twin.emulator.can_frame import Frame


class ErrorState:
    """What an adapter tells of the bus's state, as error frames in SocketCAN's format.

    Args:
        faults: The damage it is told of.
    """

    def __init__(self, faults: BusFaults) -> None:
        self._faults = faults
        self._off = self._passive = False

    def news(self) -> list[can.Message]:
        """Error frames for what has become worse since the last call."""
        off, passive = self._faults.bus_off, self._faults.error_passive
        found = []
        if off and not self._off:
            found.append(message(0x040, bytes(8), error=True))
        if passive and not self._passive:
            found.append(message(0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0)), error=True))
        self._off, self._passive = off, passive
        return found


class VirtualPort:
    """The emulated bus as seen on a channel of python-can's ``virtual`` interface.

    Args:
        bus: What is emulated.
        channel: Name of the channel.
    """

    def __init__(self, bus: EmulatedBus, channel: str) -> None:
        self.channel = channel
        self._bus = bus
        self._can = can.Bus(interface="virtual", channel=channel)
        self._first: can.Message | None = None
        self._state = ErrorState(bus.faults)

    def wait(self, seconds: float) -> None:
        """Wait until the host sends something, at most for a time."""
        self._first = self._first or self._can.recv(seconds)

    def pump(self) -> None:
        """Pass on what has arrived either way; never waits."""
        heard, self._first = self._first or self._can.recv(0), None
        while heard is not None:
            data, remote = bytes(heard.data), heard.is_remote_frame
            self._bus.from_host(Frame(heard.arbitration_id, data, remote))
            heard = self._can.recv(0)
        for frame in self._bus.to_host():
            self._can.send(message(frame.cob_id, frame.data))
        for news in self._state.news():
            self._can.send(news)

    def close(self) -> None:
        """Leave the channel."""
        self._can.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def message(identifier: int, data: bytes, *, error: bool = False) -> can.Message:
    """A frame of python-can's."""
    return can.Message(
        arbitration_id=identifier, data=data, is_extended_id=error, is_error_frame=error
    )
