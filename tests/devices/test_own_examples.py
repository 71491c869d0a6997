"""`ballplate.hardware`.

The examples of own hardware on a network, each against an emulation of its other side.
"""

import math
import socket
import sys
import threading
import time
import tomllib

import pytest
from own_board import EXAMPLE, example

from ballplate.hardware import Reading
from twin.base.jobs import wait_until


def line_of(text):
    """A line with its check sum, by the description of the examples."""
    return f"{text}*{sum(map(ord, text)) & 0xFF:02X}\n".encode("ascii")


@pytest.fixture
def board():
    """The socket of a board; nothing is behind it but the test."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.settimeout(60.0)
        yield line


@pytest.fixture
def connected(board):
    """The example, started, and the address at which it is answered."""
    rig = example("udp").Esp32(*board.getsockname())

    rig.begun = rig.time()
    starting = threading.Thread(target=rig.start)
    starting.start()
    heard, peer = board.recvfrom(64)
    assert heard == line_of("P 0 0")
    board.sendto(line_of("B 1 30.0 -20.0"), peer)
    starting.join(timeout=60.0)
    yield rig, peer
    rig.stop()


def test_a_line_of_the_board_becomes_a_reading_in_metres(connected):
    rig, _ = connected
    x, y, at, *angles = rig.measure()
    assert (x, y) == (pytest.approx(0.03), pytest.approx(-0.02))
    assert rig.time() >= at >= rig.begun
    assert angles == [None, None]


def test_an_older_or_broken_line_is_dropped_and_a_ball_not_seen_is_not_a_number(board, connected):
    rig, peer = connected
    for text in ("B 5 1.0 2.0", "B 3 9.0 9.0", "B 5 9.0 9.0"):  # overtaken, repeated
        board.sendto(line_of(text), peer)
    board.sendto(line_of("B 6 9.0 9.0").replace(b"9.0*", b"8.0*"), peer)
    assert wait_until(lambda: rig.measure().x != 0.03, 60.0)
    time.sleep(0.02)
    assert rig.measure()[:2] == (0.001, 0.002)
    board.sendto(line_of("B 7 - -"), peer)
    assert wait_until(lambda: math.isnan(rig.measure().x), 60.0)
    assert rig.faults() == ()


def test_a_board_that_counts_from_the_beginning_was_reset(board, connected):
    rig, peer = connected
    board.sendto(line_of("B 400 1.0 2.0"), peer)
    assert wait_until(lambda: rig.measure().x == 0.001, 60.0)
    board.sendto(line_of("B 1 1.0 2.0"), peer)
    assert wait_until(lambda: (rig.measure(), rig.faults())[1], 60.0)
    assert rig.faults() == ("the board was reset once",)


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


@pytest.fixture
def cv2():
    """OpenCV, which only these examples use."""
    return pytest.importorskip("cv2", reason="opencv-python-headless is not installed")


@pytest.fixture
def pictures(monkeypatch):
    """The example that makes pictures, where the camera's example finds it."""
    module = example("pictures")
    monkeypatch.setitem(sys.modules, "pictures", module)
    return module


@pytest.fixture
def camera(cv2, pictures):
    """The example with a camera, as the rig file describes it."""
    file = tomllib.loads((EXAMPLE / "servos_and_opencv.toml").read_text(encoding="utf-8"))
    return example("opencv_camera").OverheadCamera(**file["touch"]["options"])


@pytest.mark.parametrize("ball", [(0.0, 0.0), (0.12, -0.12), (-0.12, 0.1), (-0.05, 0.03)])
def test_the_ball_of_a_picture_is_found_within_half_a_millimetre(camera, pictures, ball):
    found = camera.find(pictures.Pictures(ball).picture())
    assert found == pytest.approx(ball, abs=5e-4)


def test_a_camera_whose_place_is_wrong_is_wrong_by_the_height_of_the_ball(camera, pictures):
    """As if it stood above the ball: the ball is 20 mm above the plate, seen from 550 mm."""
    camera.eye[:] = 0.12, -0.12
    x, y = camera.find(pictures.Pictures((0.12, -0.12)).picture())
    missed = 0.02 / 0.55 * 0.06  # m, for 60 mm along x
    assert x - 0.12 == pytest.approx(missed, abs=5e-4)
    assert y + 0.12 == pytest.approx(-missed * 7 / 6, abs=5e-4)


def test_an_empty_plate_has_no_ball(camera, pictures):
    assert all(map(math.isnan, camera.find(pictures.Pictures((math.nan, 0.0)).picture())))


def test_the_corners_of_the_rig_file_are_those_of_the_pictures(pictures):
    file = tomllib.loads((EXAMPLE / "servos_and_opencv.toml").read_text(encoding="utf-8"))
    assert file["touch"]["options"]["corners"] == pictures.corners()
    assert file["touch"]["options"]["eye"] == pictures.EYE_M.tolist()


def test_pictures_that_end_are_a_fault_of_the_camera(camera):
    camera.start()
    assert camera.measure()[:2] == pytest.approx((0.03, -0.02), abs=5e-4)
    first = camera.measure().at
    assert wait_until(lambda: camera.measure().at > first, 60.0)
    camera.camera.read = lambda: (False, None)
    assert wait_until(camera.faults, 60.0)
    assert camera.faults() == ("camera made: no more pictures",)
    camera.stop()
    assert not camera.thread.is_alive()


def test_a_camera_that_is_not_there_is_named(cv2, camera):
    camera.source = "nowhere.mp4"
    with pytest.raises(OSError, match=r"camera nowhere\.mp4: no picture"):
        camera.start()
    camera.stop()
