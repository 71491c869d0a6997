"""`ballplate.hardware`.

The examples of own hardware on a network, each against an emulation of its other side.
"""

import importlib.util
import math
import socket
import threading
import time
from pathlib import Path

import pytest

from ballplate.hardware import Reading

EXAMPLES = Path(__file__).parents[2] / "examples" / "own_rig"


def example(name):
    """A program of the examples, which is in no package, as a module."""
    spec = importlib.util.spec_from_file_location(f"own_example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def line_of(text):
    """A line with its check sum, by the description of the examples."""
    return f"{text}*{sum(map(ord, text)) & 0xFF:02X}\n".encode("ascii")


def waited(condition, seconds=2.0):
    """Whether something becomes true within a time in s."""
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.005)
    return found


@pytest.fixture
def board():
    """The socket of a board; nothing is behind it but the test."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.settimeout(2.0)
        yield line


@pytest.fixture
def connected(board):
    """The example, started, and the address at which it is answered."""
    rig = example("udp").Esp32(*board.getsockname())

    starting = threading.Thread(target=rig.start)
    starting.start()
    heard, peer = board.recvfrom(64)
    assert heard == line_of("P 0 0")
    board.sendto(line_of("B 1 30.0 -20.0"), peer)
    starting.join(timeout=2.0)
    yield rig, peer
    rig.stop()


def test_a_line_of_the_board_becomes_a_reading_in_metres(connected):
    rig, _ = connected
    x, y, at, *angles = rig.measure()
    assert (x, y) == (pytest.approx(0.03), pytest.approx(-0.02))
    assert 0 <= rig.time() - at < 2
    assert angles == [None, None]


def test_an_older_or_broken_line_is_dropped_and_a_ball_not_seen_is_not_a_number(board, connected):
    rig, peer = connected
    for text in ("B 5 1.0 2.0", "B 3 9.0 9.0", "B 5 9.0 9.0"):  # overtaken, repeated
        board.sendto(line_of(text), peer)
    board.sendto(line_of("B 6 9.0 9.0").replace(b"9.0*", b"8.0*"), peer)
    assert waited(lambda: rig.measure().x != 0.03)
    time.sleep(0.02)
    assert rig.measure()[:2] == (0.001, 0.002)
    board.sendto(line_of("B 7 - -"), peer)
    assert waited(lambda: math.isnan(rig.measure().x))
    assert rig.faults() == ()


def test_a_board_that_counts_from_the_beginning_was_reset(board, connected):
    rig, peer = connected
    board.sendto(line_of("B 400 1.0 2.0"), peer)
    assert waited(lambda: rig.measure().x == 0.001)
    board.sendto(line_of("B 1 1.0 2.0"), peer)
    assert waited(lambda: (rig.measure(), rig.faults())[1])
    assert rig.faults() == ("the board was reset 1 times",)


def test_the_board_is_told_angles_in_degrees_and_to_level_the_plate_at_the_end(board, connected):
    rig, _ = connected
    rig.command((0.0, 0.0), (math.radians(1.5), math.radians(-2)))
    assert board.recv(64) == line_of("P 1.500 -2.000")
    rig.stop()
    assert {board.recv(64) for _ in range(3)} == {line_of("P 0.000 0.000")}


def test_datagrams_of_others_are_not_heard(connected):
    rig, peer = connected
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(line_of("B 900 5.0 5.0"), peer)
    time.sleep(0.05)
    assert isinstance(rig.measure(), Reading)
    assert rig.measure().x == pytest.approx(0.03)


@pytest.mark.long
def test_a_board_that_does_not_answer_is_named():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        host, port = line.getsockname()
        rig = example("udp").Esp32(host, port)
        with pytest.raises(OSError, match=f"{host}:{port}: no line from the board within 2 s"):
            rig.start()
        rig.stop()
