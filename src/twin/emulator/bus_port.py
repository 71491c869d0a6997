"""The emulated bus on a bus of python-can: SocketCAN, UDP multicast, an adapter, any by name."""

from __future__ import annotations

from collections import deque
from typing import Any, Self

import can

from twin.base.errors import RigError, one_line
from twin.devices.common import error_number, in_words
from twin.emulator.bus_name import BusName
from twin.emulator.can_bus import EmulatedBus, Passing, nothing
from twin.emulator.direct_bus import message
from twin.emulator.drive_objects import Frame

_SYNC_ID = 0x080
_OWN_FRAMES = 256
"""Frames of its own that a bus may still bring back."""
_MAX_FRAMES = 1024
"""Frames that are taken at once."""


def open_bus(name: BusName) -> can.BusABC:
    """Open a bus for emulated drives.

    Raises:
        RigError: It cannot be opened.
    """
    options: dict[str, Any] = {"channel": name.channel} if name.channel else {}
    if name.interface == "udp_multicast":
        options |= {"fd": False} if name.port is None else {"fd": False, "port": name.port}
    elif name.interface not in {"socketcan", "virtual"}:
        options["bitrate"] = 1_000_000
    try:
        return can.Bus(interface=name.interface, **options)
    except Exception as error:
        why = in_words("bus", error_number(error), channel=name.channel) or one_line(error)
        if name.interface == "udp_multicast" and isinstance(
            error, can.CanInterfaceNotImplementedError
        ):
            why = f"{why}; pip install 'python-can[multicast]'"
        raise RigError(f"--bus {name}: cannot be opened: {why}") from error


class BusPort:
    """Where hosts reach the emulated bus by a bus of python-can; a context manager.

    Args:
        bus: The emulated bus.
        name: What the other one is called.

    Raises:
        RigError: It cannot be opened.
    """

    def __init__(self, bus: EmulatedBus, name: BusName) -> None:
        self.name = name
        self._bus = bus
        self._opened = open_bus(name)
        self._arrived: deque[Frame] = deque()
        self._sent: deque[Frame] = deque(maxlen=_OWN_FRAMES)

    def wait(self, seconds: float) -> None:
        """Wait until a frame arrives, at most for a time in s."""
        if not self._arrived:
            self._take(seconds)

    def pump(self, passing: Passing = nothing) -> None:
        """Pass on what has arrived either way; never waits.

        Args:
            passing: Called after each of the SYNCs that have waited, with the share of them so far.

        Raises:
            RigError: The bus is lost.
        """
        while len(self._arrived) < _MAX_FRAMES and self._take(0.0):
            pass
        waited = sum(frame.cob_id == _SYNC_ID for frame in self._arrived)
        syncs = 0
        while self._arrived:
            frame = self._arrived.popleft()
            self._bus.from_host(frame)
            self._send()
            if frame.cob_id == _SYNC_ID:
                syncs += 1
                passing(syncs / waited)
        self._send()

    def _take(self, seconds: float) -> bool:
        """Take a frame that arrives within a time in s; whether one did."""
        try:
            heard = self._opened.recv(seconds)
        except (can.CanError, OSError) as error:
            raise RigError(f"--bus {self.name}: lost: {one_line(error)}") from error
        if heard is None:
            return False
        frame = _frame(heard)
        if frame is None:
            return True
        if frame in self._sent:  # some buses bring one's own frames back
            self._sent.remove(frame)
        else:
            self._arrived.append(frame)
        return True

    def _send(self) -> None:
        for frame in self._bus.to_host():
            self._sent.append(frame)
            try:
                self._opened.send(
                    message(frame.cob_id, frame.data, remote=frame.remote, extended=frame.extended)
                )
            except (can.CanError, OSError) as error:
                raise RigError(f"--bus {self.name}: lost: {one_line(error)}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.shutdown()


def _frame(heard: can.Message) -> Frame | None:
    """A frame of python-can; None for an error frame and for CAN FD."""
    if heard.is_error_frame or heard.is_fd:
        return None
    return Frame(
        heard.arbitration_id, bytes(heard.data), heard.is_remote_frame, heard.is_extended_id
    )
