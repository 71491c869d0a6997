"""A CAN frame: identifier, data, and whether it is a remote request."""

from __future__ import annotations

from typing import NamedTuple


class Frame(NamedTuple):
    """A classic CAN frame with an 11-bit identifier and up to eight bytes."""

    cob_id: int
    data: bytes = b""
    remote: bool = False
