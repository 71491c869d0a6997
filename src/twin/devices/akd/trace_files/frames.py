"""A classic frame out of a trace, and what a reader has to say of the file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import can

ERROR_FLAG, REMOTE_FLAG, EXTENDED_FLAG = 1 << 29, 1 << 30, 1 << 31
"""Flags above an identifier, as SocketCAN has them."""
LARGEST_STANDARD = 0x7FF
"""Largest identifier of 11 bits."""


class BusFrame(Protocol):
    """A frame as whoever decodes it sees it: one of a trace, or a message of python-can."""

    timestamp: float
    arbitration_id: int
    is_extended_id: bool
    is_remote_frame: bool
    is_error_frame: bool

    @property
    def data(self) -> bytes | bytearray:
        """Its bytes."""


@dataclass
class Notes:
    """What a reader has to say of a file.

    Attributes:
        form: What program's form it is.
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
) -> can.Message | None:
    """A classic frame; None if there is none of more than eight bytes or so large an identifier.

    Args:
        time: In s.
        identifier: Without flags.
        data: Its bytes.
        extended: Whether the identifier has 29 bits.
        remote: Length that a remote frame asks for; None for a frame of data.
        error: Whether it is an error frame.
        sent: Whether the program that wrote the trace sent it.
        channel: What the bus is called.
    """
    if (
        len(data) > 8
        or identifier >> 29
        or not (extended or error or identifier <= LARGEST_STANDARD)
    ):
        return None
    return can.Message(
        timestamp=time,
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote is not None,
        is_error_frame=error,
        is_rx=not sent,
        dlc=len(data) if remote is None else remote,
        data=data if remote is None else None,
        channel=channel,
    )
