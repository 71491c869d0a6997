"""Bring-up traffic over `canopen` without a receiving thread: every request pumps the bus."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import can
import canopen
from serial import SerialException

from twin.devices.akd import frames
from twin.devices.akd.conditions import (
    ADAPTER_GONE,
    NODE_ABSENT,
    SDO_ABORT,
    SDO_TIMEOUT,
    WRONG_SETTING,
    DriveError,
)
from twin.devices.akd.config import AxisConfig
from twin.devices.akd.dictionary import kept

BUS_ERRORS = (can.CanError, OSError, SerialException)
"""What python-can and the drivers below it raise when an adapter goes."""

AT_EVERY_SYNC = 1
"""Transmission type of a PDO that is exchanged at every SYNC."""
FIRST_TRANSMIT = 0x1800
"""Index of the parameters of the first PDO that a drive sends."""

_SERVICES = (frames.HEARTBEAT, frames.SDO_RESPONSE, frames.TPDO1, frames.TPDO2)


class Network(canopen.Network):  # type: ignore[misc]
    """A CANopen network that reads the bus only while it waits for something.

    canopen's receiving thread would compete with the control loop, and an adapter that goes would
    end it with a traceback.
    """

    def __init__(self, bus: can.BusABC, answer: float, now: Callable[[], float]) -> None:
        super().__init__(bus)
        self.answer = answer
        """Longest wait for an SDO answer in s."""
        self.now = now
        """Monotonic time in s."""
        self.heard: set[int] = set()
        """Nodes that have sent anything."""
        self.states: dict[int, int] = {}
        """NMT states from heartbeats, by node."""
        self.answers: dict[int, int] = {}
        """Number of SDO answers, by node."""
        self.identifiers: set[int] = set()
        """Of all frames that others have sent."""
        self.bus_errors = 0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send, and for an SDO request wait until its answer is in; an abort has none."""
        super().send_message(can_id, data, remote)
        if can_id & ~frames.NODE_MASK == frames.SDO_REQUEST and data[0] != frames.SDO_ABORT:
            node = can_id & frames.NODE_MASK
            before = self.answers.get(node, 0)
            self.pump(self.answer, lambda: self.answers.get(node, 0) > before)

    def pump(self, seconds: float, done: Callable[[], bool] = lambda: False) -> bool:
        """Read the bus until something is done, at most for s; return whether it was done.

        What arrived in time counts even if the computer was busy elsewhere until after it; a bus
        that does not become quiet is read for twice the time.
        """
        deadline = self.now() + seconds
        while not done():
            left = deadline - self.now()
            message = self.bus.recv(min(max(left, 0.0), 0.02))
            if message is not None:
                self._take(message)
            if left <= 0 and (message is None or left < -seconds):
                return False
        return True

    def _take(self, message: can.Message) -> None:
        if message.is_error_frame:
            self.bus_errors += 1
        elif message.is_rx and not message.is_remote_frame and not message.is_extended_id:
            self.identifiers.add(message.arbitration_id)
            node = message.arbitration_id & frames.NODE_MASK
            service = message.arbitration_id - node
            if node and service in _SERVICES:
                self.heard.add(node)
            if service == frames.SDO_RESPONSE and len(message.data) == 8:
                self.answers[node] = self.answers.get(node, 0) + 1
                self.notify(message.arbitration_id, message.data, message.timestamp)
            state = frames.decode_nmt_state(bytes(message.data))
            if service == frames.HEARTBEAT and state is not None:
                self.states[node] = state


class Remote:
    """One drive during bring-up: reads and writes that end in a value or one clear line."""

    def __init__(self, network: Network, axis: AxisConfig, dictionary: Any) -> None:
        self.axis = axis
        self.network = network
        self.node = canopen.RemoteNode(axis.node, dictionary)
        self.node.sdo.RESPONSE_TIMEOUT = 0.001  # the network has waited already
        network.add_node(self.node)

    def read(self, index: int, sub: int = 0) -> int:
        """The value of an object.

        Raises:
            DriveError: If the drive does not answer, or refuses.
        """
        with self._errors(f"reading {index:04X}h:{sub}"):
            return int(self._variable(index, sub).raw)

    def read_if_there(self, index: int, sub: int = 0) -> int | None:
        """The value of an object; None if the drive refuses it.

        Raises:
            DriveError: If the drive does not answer.
        """
        try:
            return self.read(index, sub)
        except DriveError as error:
            if error.fault.condition is not SDO_ABORT:
                raise
            return None

    def write(self, index: int, sub: int, value: int) -> None:
        """Write an object and read it back; ``objects.toml`` says how exactly it must be kept.

        Raises:
            DriveError: If the drive does not answer, refuses, or keeps another value.
        """
        with self._errors(f"writing {value} to {index:04X}h:{sub}"):
            variable = self._variable(index, sub)
            variable.raw = value
            read = int(variable.raw)
        if not kept(index, value, read):
            what = f"{index:04X}h:{sub} ({variable.od.name}) keeps {read}, not {value}"
            raise DriveError(WRONG_SETTING, self.axis.where, what)

    def map_pdo(self, parameters: int, cob_id: int, entries: Sequence[tuple[int, int]]) -> None:
        """Map a PDO that is switched off, in the order of CiA 301, and switch it on.

        Args:
            parameters: Index of its parameters; its mapping lies 200h above.
            cob_id: Its identifier.
            entries: Index and subindex of what it carries.

        Raises:
            DriveError: If the drive does not answer, refuses, or keeps something else.
        """
        mapping = parameters + 0x200
        self.write(parameters, 2, AT_EVERY_SYNC)
        if parameters >= FIRST_TRANSMIT:
            self.write(parameters, 3, 0)  # no inhibit time
            self.write(parameters, 5, 0)  # no event timer
        self.write(mapping, 0, 0)
        for place, (index, sub) in enumerate(entries, 1):
            bits = len(self._variable(index, sub).od)
            self.write(mapping, place, index << 16 | sub << 8 | bits)
        self.write(mapping, 0, len(entries))
        self.write(parameters, 1, cob_id)

    def _variable(self, index: int, sub: int) -> Any:
        item = self.node.sdo[index]
        return item[sub] if hasattr(item, "__getitem__") and not hasattr(item, "raw") else item

    @contextmanager
    def _errors(self, what: str) -> Iterator[None]:
        try:
            yield
        except canopen.SdoAbortedError as error:
            detail = f"{what} refused: {error}"
            raise DriveError(SDO_ABORT, self.axis.where, detail) from error
        except canopen.SdoCommunicationError as error:
            known = self.axis.node in self.network.answers
            detail = f"{what}: no answer" if known else absent(self.network, self.axis)
            condition = SDO_TIMEOUT if known else NODE_ABSENT
            raise DriveError(condition, self.axis.where, detail) from error
        except BUS_ERRORS as error:
            detail = f"{what}: adapter gone ({error})"
            raise DriveError(ADAPTER_GONE, self.axis.where, detail) from error
        except (KeyError, ValueError, canopen.ObjectDictionaryError) as error:
            detail = f"{what}: not in the object dictionary, or out of range ({error})"
            raise DriveError(WRONG_SETTING, self.axis.where, detail) from error


def absent(network: Network, axis: AxisConfig) -> str:
    """Why a drive may be silent, in one line."""
    others = sorted(network.heard - {axis.node})
    heard = f"heard nodes {', '.join(map(str, others))}" if others else "heard nobody"
    return f"does not answer ({heard}); check power, cable, bit rate and node switches"
