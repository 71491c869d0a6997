"""`docs.firmware`: The board of examples/board as own hardware, also one that computes; faults."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from ballplate.hardware import Reading
from docs import firmware
from docs.firmware import BOARD, EXAMPLE, SERVO_FRAME_S, ObservedBoard, export
from twin.base.errors import RigError
from twin.board.process import BoardProcess
from twin.board.program import compile_controller
from twin.emulator.avr import missing_programs
from twin.run.controller_building import build_reference, control_of
from twin.scenario.load import load

needs_simavr = pytest.mark.skipif(
    bool(missing_programs()), reason=f"needs {', '.join(missing_programs())}"
)
BY_BOARD, HOST_LOST, BALL_LOST = 2, 4, 8
UNIT_RAD = 1e-5


@needs_simavr
@pytest.mark.long
@pytest.mark.parametrize("row", firmware.ROWS, ids=lambda row: row.name)
def test_a_fault_is_detected_in_time_and_ends_level(row):
    done = firmware.carried_out(row)
    assert done.good, done


@needs_simavr
@pytest.mark.long
def test_a_row_is_bad_where_the_board_is_slower_to_level(monkeypatch):
    (row,) = (each for each in firmware.ROWS if "Nothing of the host" in each.name)
    slow = firmware.build_firmware(firmware.EMULATED.FIRMWARE, None, "HOST_TIMEOUT_MS=2000")
    monkeypatch.setattr(firmware.EMULATED, "build_firmware", lambda *_: slow)
    assert {"detected", "standstill"} <= set(firmware.carried_out(row).failures)


@pytest.fixture(scope="module")
def controllers(tmp_path_factory):
    """Folders of exported controllers, by law."""
    folder = tmp_path_factory.mktemp("controllers")
    for law in firmware.LAWS:
        (folder / law).mkdir()
        export(law, folder / law)
    return folder


def started(folder, **given):
    board = ObservedBoard(controller=str(folder), **given)
    board.start()
    return board


def held(board, seconds, seen=True):
    """Statuses of a board that is sent where the ball is, once a servo frame."""
    found = []
    for _ in range(round(seconds / SERVO_FRAME_S)):
        board.measure()
        if not seen:
            board.ball = Reading(math.nan, math.nan, board.now)
        board.command((0.0, 0.0), (0.0, 0.0))
        board.wait(SERVO_FRAME_S)
        board.receive()
        found.append(board.status)
    return found


def level(board):
    """Whether the plate stands level, but for its play."""
    return bool(np.abs(board.plate.state[2::4]).max() < firmware.own_faults.LEVEL)


@needs_simavr
@pytest.mark.long
@pytest.mark.parametrize("law", firmware.LAWS)
def test_the_board_commands_what_the_same_c_code_commands_here(law, tmp_path):
    control = control_of(scenario := load(str(EXAMPLE / f"{law}.toml")))
    # with the predictor it would matter when a byte arrives, to the millisecond
    control = control._replace(observer=control.observer.observer)
    for name, text in firmware.sources("controller", control, "float").items():
        if name.startswith("controller."):
            (tmp_path / name).write_text(text, encoding="utf-8")
    board = started(tmp_path)
    times = 0.02 * np.arange(100)
    balls = np.round(np.stack([0.03 * np.sin(3 * times), 0.02 * np.cos(2 * times)], 1), 5)
    got = []
    for ball in balls:
        board.ball = Reading(*ball.tolist(), board.now)
        board.command((0.0, 0.0), (0.0, 0.0))
        board.wait(SERVO_FRAME_S)
        board.receive()
        if board.status.state == BY_BOARD:
            got.append((*board.status.angle, *board.status.plate))
    board.stop()
    program = compile_controller(control, "host", "float")
    process, reference = BoardProcess(program, "here", 0.02, 5.0), build_reference(scenario)
    angle, plate, due = np.zeros(2), np.zeros(2), []
    for t, (x, y) in zip(times, balls, strict=True):
        plate = plate + (1 - math.exp(-0.02 / 0.06)) * (angle - plate)
        path = np.asarray(reference(t)).reshape(5, 2)
        answer = process.ask([t, x, plate[0], y, plate[1], 0.0, 1.0, *path.ravel().tolist()])
        angle = np.clip(angle + 0.02 * np.asarray(answer.rate), -0.21, 0.21)
        due.append((*angle, *plate))
    assert len(got) >= 98
    assert np.abs(due).max() > 0.02
    np.testing.assert_allclose(got, due[: len(got)], atol=2 * UNIT_RAD)


@needs_simavr
@pytest.mark.long
def test_a_board_that_computes_levels_when_it_sees_no_ball_or_hears_nothing(controllers):
    board = started(controllers / "pid")
    assert held(board, 1.0)[-1].state == BY_BOARD
    last = held(board, 0.5, seen=False)
    gone = next(i for i, each in enumerate(last) if each.state == BALL_LOST)
    assert 0.2 <= (gone + 1) * SERVO_FRAME_S <= 0.2 + 3 * SERVO_FRAME_S
    assert board.faults() == ("the board saw no ball in its area",)
    board.wait(1.0)
    assert level(board)
    board.stop()
    board = started(controllers / "pid")
    held(board, 1.0)
    board.line.cut = True
    held(board, 1.0)
    assert board.status.state == HOST_LOST
    assert level(board)
    board.stop()


@needs_simavr
@pytest.mark.long
@pytest.mark.parametrize(("buffer", "overflows"), [(64, False), (32, True)])
def test_a_board_that_computes_goes_on_on_a_line_that_is_full(
    buffer, overflows, controllers, monkeypatch
):
    program = firmware.build_firmware(
        firmware.EMULATED.FIRMWARE, controllers / "pid", f"BUFFER_BYTES={buffer}"
    )
    monkeypatch.setattr(firmware.EMULATED, "build_firmware", lambda *_: program)
    board = started(controllers / "pid")
    held(board, 0.5)
    for _ in range(50):
        board.line.junk = 214  # with the frame nearly all that the line carries in a servo frame
        (status,) = held(board, SERVO_FRAME_S)
        assert status.state == BY_BOARD
    assert (status.overruns > 20) is overflows
    assert held(board, 0.2)[-1].state == BY_BOARD
    assert board.faults() == ()
    board.stop()
    board.wait(1.0)
    assert level(board)


@needs_simavr
@pytest.mark.long
def test_every_run_is_the_same_also_with_lost_bytes():
    found = []
    for _ in range(2):
        board = ObservedBoard(lose_percent=3)
        board.start()
        for k in range(100):
            board.measure()
            board.command((0.0, 0.0), (0.1 * math.sin(0.1 * k), 0.05))
            board.wait(0.004)
        found.append((np.array(board.line.trace), board.status))
        board.stop()
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1]
    assert found[0][1].invalid > 20


@needs_simavr
@pytest.mark.long
@pytest.mark.parametrize("percent", [-1, 1])
@pytest.mark.parametrize("trimmed", [False, True])
def test_a_clock_that_is_off_leaves_the_plate_level_once_it_is_trimmed(percent, trimmed):
    neutral = 1500 + 15 * percent
    trim = [f"NEUTRAL_US_{axis}={neutral}" for axis in ("PHI", "THETA")] if trimmed else []
    board = ObservedBoard(clock_percent=percent, defines=trim)
    board.start()
    for angle in (0.1, 0.1, 0.0, 0.0):
        for _ in range(15):
            board.command((0.0, 0.0), (angle, -angle))
            board.wait(SERVO_FRAME_S)
    board.stop()
    board.wait(1.0)
    # 1 % of a pulse of 1500 us, with half of the play of the servos and a tick
    off, play = 0.01 * 1500 / 1910, math.radians(0.15) + 0.5 / 1910
    found = board.plate.state[2::4]
    np.testing.assert_allclose(found, 0.0 if trimmed else -percent * off, atol=play)
    assert level(board) is trimmed


@needs_simavr
@pytest.mark.long
def test_a_board_without_the_right_controller_is_refused_in_one_line(controllers, tmp_path):
    board = ObservedBoard()
    board.computes = True
    with pytest.raises(OSError, match="computes: the board was flashed without a controller"):
        board.start()
    for name in ("controller.c", "controller.h"):
        text = (controllers / "lqr" / name).read_text("utf-8")
        (tmp_path / name).write_text(text.replace("PERIOD_S 0.02f", "PERIOD_S 0.01f"), "utf-8")
    with pytest.raises(OSError, match=r"exported for another rig\.period than 0\.02 s"):
        started(tmp_path)
    with pytest.raises(RigError, match=r"there is no .*controller\.c"):
        started(tmp_path / "nowhere")


@needs_simavr
@pytest.mark.long
@pytest.mark.parametrize("setting", ["observer.kind=ekf", "reference.kind=path"])
def test_a_controller_that_is_too_large_is_refused_in_one_line(setting, tmp_path):
    export("lqr", tmp_path, [setting])
    with pytest.raises(RigError, match="does not fit into an ATmega328P; large are an ekf"):
        firmware.build_firmware(firmware.EMULATED.FIRMWARE, tmp_path)


def test_frames_are_found_between_bytes_without_sense_and_after_a_lost_byte():
    # the check value of this CRC for the digits 1 to 9, from the catalogue of CRCs, is 0x31C3
    assert BOARD.binascii.crc_hqx(b"123456789", 0) == 0x31C3
    one, two = BOARD.frame(b"S\x01abc"), BOARD.frame(b"R\x02")
    buffer = bytearray(b"\xb5\x20" + one[:3] + one[4:] + two + b"\x00\xb5" + one + two[:4])
    assert BOARD.take_frames(buffer) == []  # what may be a long frame is waited for
    buffer += bytes(40)
    assert BOARD.take_frames(buffer) == [b"R\x02", b"S\x01abc"]
    whole = bytearray(one + two + one)
    assert BOARD.take_frames(whole) == [b"S\x01abc", b"R\x02", b"S\x01abc"]
    assert whole == b""


class Silent:
    """A port on which nobody answers, or with the given bytes."""

    def __init__(self, answer=b""):
        self.answer = answer

    def write(self, data):
        return len(data)

    def read(self, count):
        found, self.answer = self.answer, b""
        return found

    def close(self):
        pass


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b"", "P: no answer from the board within 4 s; is it the right port, and flashed?"),
        (b"R\x01\x01\x09\x00", "P: the board speaks version 9, this is 1"),
        (b"R\x01\x01\x01\x00", "P: the board says nothing more"),
    ],
)
def test_a_board_that_does_not_answer_well_is_refused_in_one_line(answer, words, monkeypatch):
    line = Silent(BOARD.frame(answer) if answer else b"")
    monkeypatch.setattr(BOARD, "serial", SimpleNamespace(Serial=lambda *_, **__: line))
    clock = SimpleNamespace(now=0.0)
    board = BOARD.Board("P")
    monkeypatch.setattr(board, "time", lambda: clock.now)
    monkeypatch.setattr(board, "wait", lambda s: setattr(clock, "now", clock.now + s))
    with pytest.raises(OSError, match=re.escape(words)):
        board.start()


def test_a_port_that_fails_at_the_end_leaves_no_camera_open():
    closed = []

    def unplugged(_):
        raise OSError("unplugged")

    board = BOARD.Board("P")
    board.line = SimpleNamespace(write=unplugged, close=lambda: closed.append("port"))
    board.camera = SimpleNamespace(stop=lambda: closed.append("camera"))
    with pytest.raises(OSError, match="unplugged"):
        board.stop()
    assert closed == ["port", "camera"]


def test_a_board_that_is_to_compute_needs_a_camera():
    with pytest.raises(ValueError, match="computes: needs the camera"):
        BOARD.Board("P", computes=True)
