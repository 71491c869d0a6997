"""Drives asked over SDO before the control loop: objects read and written, PDOs mapped.

Requests wait for their answer, and the bus is read only meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import can

from twin.base.errors import plural
from twin.devices.akd import conditions as c
from twin.devices.akd import protocol
from twin.devices.akd.bus import BUS_ERRORS
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AxisConfig
from twin.devices.akd.protocol import AT_EVERY_SYNC, Object

FIRST_TRANSMIT = 0x1800
"""Index of the parameters of the first PDO that a drive sends."""

_DRIVE_SERVICES = (protocol.HEARTBEAT, protocol.SDO_RESPONSE, protocol.TPDO1, protocol.TPDO2)


class Network:
    """A CANopen network that reads the bus only while it waits for something.

    A receiving thread would compete with the control loop, and an adapter that goes would end it
    with a traceback.

    Args:
        bus: The open bus.
        answer: Longest wait for an SDO answer in s.
        now: Monotonic time in s.
    """

    def __init__(self, bus: can.BusABC, answer: float, now: Callable[[], float]) -> None:
        self.bus = bus
        self.answer = answer
        """Longest wait for an SDO answer in s."""
        self.now = now
        """Monotonic time in s."""
        self.states: dict[int, int] = {}
        """NMT states from heartbeats, by node."""
        self.answers: dict[int, int] = {}
        """Number of SDO answers, by node."""
        self._answer: dict[int, protocol.SdoAnswer | None] = {}
        self.identifiers: set[int] = set()
        """Of all frames that others have sent."""
        self.bus_errors = 0

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        self.bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    def request(self, node: int, index: int, sub: int, data: bytes) -> protocol.SdoAnswer | None:
        """Send an SDO request, and wait for its answer; None if there is none in time."""

        def answered() -> protocol.SdoAnswer | None:
            answer = self._answer.get(node)
            return answer if answer and answer.key == (index, sub) else None

        self._answer.pop(node, None)
        self.send(protocol.SDO_REQUEST + node, data)
        self.pump(self.answer, lambda: answered() is not None)
        return answered()

    def answered_otherwise(self, node: int, index: int, sub: int) -> str:
        """Message of a node instead of an answer to the newest request; empty if none."""
        if node not in self._answer:
            return ""
        return protocol.answers_otherwise((index, sub), self._answer[node])

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
            node = message.arbitration_id & protocol.NODE_MASK
            service = message.arbitration_id - node
            if service == protocol.SDO_RESPONSE and len(message.data) == 8:
                self.answers[node] = self.answers.get(node, 0) + 1
                self._answer[node] = protocol.decode_sdo(bytes(message.data))
            state = protocol.decode_nmt_state(bytes(message.data))
            if service == protocol.HEARTBEAT and state is not None:
                self.states[node] = state


class Remote:
    """One drive during bring-up: reads and writes that end in a value or one clear line.

    Args:
        network: The bus.
        axis: The axis of the drive.
    """

    def __init__(self, network: Network, axis: AxisConfig) -> None:
        self.axis = axis
        self.network = network

    def read(self, index: int, sub: int = 0) -> int:
        """The value of an object.

        Raises:
            DriveError: If the drive does not answer, or refuses.
        """
        what, known = f"reading {index:04X}h:{sub}", self._known(index, sub)
        data = self._asked(what, index, sub, protocol.encode_sdo_read(index, sub))
        if len(data) != known.bits // 8:
            detail = f"{what}: {plural(len(data), 'byte')}, an AKD has {known.bits // 8}"
            raise self.wrong(detail)
        return known.decode(data)

    def read_if_there(self, index: int, sub: int = 0) -> int | None:
        """The value of an object; None if the drive refuses it.

        Raises:
            DriveError: If the drive does not answer.
        """
        try:
            return self.read(index, sub)
        except DriveError as error:
            if error.fault.condition is not c.SDO_ABORT:
                raise
            return None

    def write(self, index: int, sub: int, value: int) -> None:
        """Write an object and read it back; ``objects.toml`` gives the allowed difference.

        Raises:
            DriveError: If the drive does not answer, refuses, or keeps a different value.
        """
        what, known = f"writing {value} to {index:04X}h:{sub}", self._known(index, sub)
        try:
            data = known.encode(value)
        except OverflowError as error:
            raise self.wrong(f"{what}: out of range") from error
        self._asked(what, index, sub, protocol.encode_sdo_write(index, sub, data))
        read = self.read(index, sub)
        if not protocol.is_kept(index, value, read):
            raise self.wrong(f"{index:04X}h:{sub} ({known.name}) keeps {read}, not {value}")

    def map_pdo(self, parameters: int, cob_id: int, entries: Sequence[tuple[int, int]]) -> None:
        """Map a PDO that is switched off, in the order of CiA 301, and switch it on.

        Args:
            parameters: Index of its parameters; its mapping lies 200h above.
            cob_id: Its identifier.
            entries: Index and subindex of each mapped object.

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
            self.write(mapping, place, index << 16 | sub << 8 | self._known(index, sub).bits)
        self.write(mapping, 0, len(entries))
        self.write(parameters, 1, cob_id)

    def _known(self, index: int, sub: int) -> Object:
        known = protocol.objects().get((index, sub))
        if known is None:
            raise self.wrong(f"{index:04X}h:{sub}: not in the object dictionary")
        return known

    def _asked(self, what: str, index: int, sub: int, data: bytes) -> bytes:
        """Send a request and return the data of its answer."""
        where = self.axis.where
        try:
            answer = self.network.request(self.axis.node, index, sub, data)
        except BUS_ERRORS as error:
            raise DriveError(
                c.ADAPTER_GONE, where, f"{what}: the adapter was lost ({error})"
            ) from error
        if answer is None:
            if other := self.network.answered_otherwise(self.axis.node, index, sub):
                raise DriveError(c.SDO_WRONG, where, f"{what}: {other}")
            if self.axis.node in self.network.answers:
                raise DriveError(c.SDO_TIMEOUT, where, f"{what}: no answer")
            raise DriveError(c.NODE_ABSENT, where, absent(self.network, self.axis))
        if answer.aborted:
            words = protocol.abort_words(answer.value)
            raise DriveError(c.SDO_ABORT, where, f"{what} refused: {words}")
        return answer.data

    def wrong(self, detail: str) -> DriveError:
        """That the drive is set otherwise than it must be, to be raised."""
        return DriveError(c.WRONG_SETTING, self.axis.where, detail)


def absent(network: Network, axis: AxisConfig) -> str:
    """Why a drive may be silent, in one line."""
    mask = protocol.NODE_MASK
    nodes = {each & mask for each in network.identifiers if each & ~mask in _DRIVE_SERVICES}
    others = sorted(nodes - {0, axis.node})
    heard = f"heard nodes {', '.join(map(str, others))}" if others else "heard nobody"
    return f"does not answer ({heard}); check power, cable, bit rate and node switches"
