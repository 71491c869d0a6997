"""A classic frame out of a trace, and the remarks of a reader on its file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Protocol

ERROR_FLAG, REMOTE_FLAG, EXTENDED_FLAG = 1 << 29, 1 << 30, 1 << 31
"""Flags above an identifier, as SocketCAN has them."""
LARGEST_STANDARD = 0x7FF
"""Largest identifier of 11 bits."""
LOOKAHEAD_LINES = 20_000
"""Lines by which a reader infers what the file does not state, as the base of its numbers."""


class BusFrame(Protocol):
    """The attributes of a frame that decoding needs: one of a trace, or a message of python-can."""

    timestamp: float
    arbitration_id: int
    is_extended_id: bool
    is_remote_frame: bool
    is_error_frame: bool
    is_rx: bool
    dlc: int

    @property
    def data(self) -> bytes | bytearray:
        """Its bytes."""


@dataclass(slots=True, eq=False)
class TracedFrame:
    """A classic frame of a trace.

    It has the attributes of python-can's message, which takes twice the memory and twice the time
    to be made, and 0.2 s to be imported.

    Attributes:
        timestamp: In s.
        arbitration_id: Identifier without flags.
        data: Its bytes; of a remote frame none.
        is_extended_id: Whether the identifier has 29 bits.
        is_remote_frame: Whether it requests data.
        is_error_frame: Whether it reports an error.
        is_rx: Whether the program that wrote the trace received it.
        dlc: Length of the data; of a remote frame, length of the requested data.
        channel: Name of the bus.
    """

    timestamp: float
    arbitration_id: int
    data: bytes
    is_extended_id: bool
    is_remote_frame: bool
    is_error_frame: bool
    is_rx: bool
    dlc: int
    channel: str | None

    is_fd: ClassVar[bool] = False
    bitrate_switch: ClassVar[bool] = False
    error_state_indicator: ClassVar[bool] = False


@dataclass
class Notes:
    """The remarks of a reader on a file.

    Attributes:
        form: Name of the format.
        timed: Whether its frames have times.
        left_out: How many lines or frames were left out.
        remarks: Other remarks, in a line each.
    """

    form: str = ""
    timed: bool = True
    left_out: int = 0
    remarks: list[str] = field(default_factory=list)


def classic_frame(
    time: float,
    identifier: int,
    data: bytes,
    *,
    extended: bool = False,
    remote: int | None = None,
    error: bool = False,
    sent: bool = False,
    channel: str | None = None,
    stated: int | None = None,
) -> TracedFrame | None:
    """A classic frame; None if there is none of more than eight bytes or so large an identifier.

    Args:
        time: In s.
        identifier: Without flags.
        data: Its bytes.
        extended: Whether the identifier has 29 bits.
        remote: Length that a remote frame requests; None for a frame of data.
        error: Whether it is an error frame.
        sent: Whether the program that wrote the trace sent it.
        channel: Name of the bus.
        stated: Length that the file states; data of a different length are no frame.
    """
    if (
        len(data) > 8
        or (remote is None and stated not in {None, len(data)})
        or identifier >> 29
        or not (extended or error or identifier <= LARGEST_STANDARD)
    ):
        return None
    length = len(data) if remote is None else remote
    content = data if remote is None else b""
    return TracedFrame(
        time, identifier, content, extended, remote is not None, error, not sent, length, channel
    )
