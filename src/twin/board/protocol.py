"""Frames between the loop and a program that has the controller: length, number and check sum.

A frame is ``0xB5``, a number (1 byte), the length of the content in bytes (2), the content, and the
CRC-16 of all that follows the ``0xB5`` (2; polynomial 0x1021 from 0). Integers are little-endian,
contents are numbers of 64 bits. The first frame is the program's, number 0. Then each measurement
is answered by a frame of its number.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from controllers.arrays import Array
from twin.base.errors import plural

FRAME_BEGIN = 0xB5
"""The first byte of a frame."""
PROTOCOL_VERSION = 1
"""Version of the protocol, which a program states."""
HELLO_LENGTH = 2
"""Numbers of the first frame: version, control period in s."""
MEASUREMENT_LENGTH = 17
"""Numbers of a measurement: time in s, (x, phi, y, theta) in m and rad, age of the ball's position
in s, whether the ball is felt, and the desired position with four derivatives, shape (5, 2)."""
ANSWER_LENGTH = 14
"""Numbers of an answer, see ``Answer``."""
MAX_FRAME_NUMBER = 255
"""Measurements have the numbers 1 to this in turn."""
FRAME_HEAD = struct.Struct("<BBH")
CHECK_SUM = struct.Struct("<H")
SHOWN_BYTES = 40
"""Most bytes that a message quotes of something that is no frame."""


class FrameError(ValueError):
    """The output of a program is no answer: why, in one line without its name."""


class Answer(NamedTuple):
    """The answer to a measurement.

    Attributes:
        rate: Commanded plate rates (phi', theta') in rad/s, shape (2,).
        acceleration: Plate accelerations that the law requested, rad/s^2, shape (2,).
        estimate: State at the time of the measurement, shape (8,).
        valid: Whether the law's request was finite.
        instructions: That it took; 0 where they are not counted.
    """

    rate: Array
    acceleration: Array
    estimate: Array
    valid: bool
    instructions: float

    @classmethod
    def of(cls, content: Array) -> Self:
        """The answer of a frame's content, shape (14,).

        Raises:
            FrameError: If a number of it is none, or the law's request was none.
        """
        rate, acceleration, estimate, rest = np.split(content, (2, 4, 12))
        if not np.isfinite(content).all():
            raise FrameError(f"sent {content.tolist()}, which are not all numbers")
        valid, instructions = rest.tolist()
        if not valid:
            raise FrameError("reports that its law's request is not a number (valid = 0)")
        if instructions < 0:
            raise FrameError(f"counted {instructions:g} instructions")
        return cls(rate, acceleration, estimate, bool(valid), instructions)


def encode(number: int, content: Sequence[float] | Array) -> bytes:
    """The frame of a number and a content."""
    numbers = np.asarray(content, "<f8").tobytes()
    head = FRAME_HEAD.pack(FRAME_BEGIN, number, len(numbers))
    return head + numbers + CHECK_SUM.pack(binascii.crc_hqx(head[1:] + numbers, 0))


def decode(heard: bytes, number: int, count: int) -> Array | None:
    """The content of the one frame in what was heard, shape (count,); None if it is not whole yet.

    Args:
        heard: All output since the last frame.
        number: The number that it must have.
        count: How many numbers it must have.

    Raises:
        FrameError: If that is no such frame, or more than one.
    """
    if heard and heard[0] != FRAME_BEGIN:
        shown = heard[:SHOWN_BYTES].decode("ascii", errors="backslashreplace")
        raise FrameError(f"sent {shown!r}, but a frame begins with {FRAME_BEGIN:#x}")
    if len(heard) < FRAME_HEAD.size:
        return None
    _, given, length = FRAME_HEAD.unpack_from(heard)
    if given != number:
        raise FrameError(f"sent frame {given} instead of {number}")
    if length != 8 * count:
        raise FrameError(f"sent a frame of {plural(length, 'byte')} instead of {8 * count}")
    end = FRAME_HEAD.size + length
    if len(heard) < end + CHECK_SUM.size:
        return None
    (stated,) = CHECK_SUM.unpack_from(heard, end)
    if stated != (own := binascii.crc_hqx(heard[1:end], 0)):
        raise FrameError(
            f"sent a frame with the check sum {stated:#06x}; its content gives {own:#06x}"
        )
    if more := len(heard) - end - CHECK_SUM.size:
        raise FrameError(f"sent {plural(more, 'byte')} more than one frame")
    return np.frombuffer(heard, "<f8", count, FRAME_HEAD.size).astype(float)
