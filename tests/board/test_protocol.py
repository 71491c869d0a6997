"""`twin.board.protocol`."""

import struct

import numpy as np
import pytest

from twin.board.protocol import ANSWER_LENGTH, Answer, FrameError, decode, encode

CONTENT = [0.1, -2.5, 1e-300]


def reference_sum(data):
    """CRC-16 bit by bit, as its definition has it: the rest of a division by 0x11021."""
    value = int.from_bytes(data, "big") << 16
    for shift in range(value.bit_length() - 17, -1, -1):
        if value >> (shift + 16) & 1:
            value ^= 0x11021 << shift
    return value


def test_a_frame_has_number_length_content_and_a_check_sum():
    assert reference_sum(b"123456789") == 0x31C3  # as catalogues of check sums have it
    said = encode(7, CONTENT)
    body = struct.pack("<BH3d", 7, 24, *CONTENT)
    assert said == b"\xb5" + body + struct.pack("<H", reference_sum(body))
    np.testing.assert_array_equal(decode(said, 7, 3), CONTENT)


def test_a_frame_that_is_not_whole_is_none_yet():
    said = encode(7, CONTENT)
    assert [decode(said[:count], 7, 3) for count in range(len(said))] == [None] * len(said)


def test_any_bit_that_is_wrong_is_noticed():
    said = encode(7, CONTENT)
    for bit in range(8 * len(said)):
        wrong = bytearray(said)
        wrong[bit // 8] ^= 1 << bit % 8
        with pytest.raises(FrameError):
            decode(bytes(wrong), 7, 3)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (b"ready\n", r"sent 'ready\\n', but a frame begins with 0xb5"),
        (b"\xff" * 99, r"sent '(\\\\xff){40}', but a frame begins"),
        (encode(6, CONTENT), "sent frame 6 instead of 7"),
        (encode(7, CONTENT[:2]), "sent a frame of 16 bytes instead of 24"),
        (encode(7, CONTENT)[:-1] + b"?", "with the check sum 0x"),
        (encode(7, CONTENT) + b"ok", "sent 2 bytes more than one frame"),
        (2 * encode(7, CONTENT), "sent 30 bytes more"),
    ],
)
def test_what_is_no_frame_is_one_line(said, words):
    with pytest.raises(FrameError, match=words) as error:
        decode(said, 7, 3)
    assert "\n" not in str(error.value)


def answer(**changed):
    content = np.arange(ANSWER_LENGTH, dtype=float)
    for place, value in changed.items():
        content[int(place[1:])] = value
    return content


def test_an_answer_has_its_parts_in_order():
    found = Answer.of(answer())
    assert found.rate.tolist() == [0, 1]
    assert found.acceleration.tolist() == [2, 3]
    assert found.estimate.tolist() == [4, 5, 6, 7, 8, 9, 10, 11]
    assert (found.valid, found.instructions) == (True, 13)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"_0": np.nan}, r"sent \[nan, 1.0, .*\], which are not all numbers"),
        ({"_7": np.inf}, "which are not all numbers"),
        ({"_12": 0}, r"its law's request is not a number \(valid = 0\)"),
        ({"_13": -1}, "counted -1 instructions"),
    ],
)
def test_an_answer_that_is_none_is_one_line(changed, words):
    with pytest.raises(FrameError, match=words):
        Answer.of(answer(**changed))
