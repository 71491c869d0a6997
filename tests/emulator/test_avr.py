"""`twin.emulator.avr`: The firmware of examples/board in simavr; pulses, line, watchdogs."""

import os
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from twin.base.errors import RigError
from twin.emulator import avr
from twin.emulator.avr import (
    CLOCK_HZ,
    FLASH_BYTES,
    RAM_BYTES,
    Chip,
    PulsedPlate,
    build_firmware,
    missing_programs,
    size_of,
)
from twin.scenario.load import load

FIRMWARE = Path(__file__).parents[2] / "examples" / "board" / "firmware"
NEUTRAL_US, US_PER_RAD = 1500.0, 1910.0
BY_HOST, HOST_LOST, RESTARTED = 1, 4, 32
POWER_ON, BROWN_OUT, WATCHDOG = 1, 4, 8
BYTE_S = 10 / 115200

needs_simavr = pytest.mark.skipif(
    bool(missing_programs()), reason=f"needs {', '.join(missing_programs())}"
)


def crc(data):
    """CRC-16 of polynomial 0x1021 from 0, bit by bit."""
    found = 0
    for byte in data:
        found ^= byte << 8
        for _ in range(8):
            found = (found << 1 ^ (0x1021 if found & 0x8000 else 0)) & 0xFFFF
    return found


def frame(kind, number, content=b""):
    body = kind + bytes([number]) + content
    checked = bytes([len(body)]) + body
    return b"\xb5" + checked + struct.pack("<H", crc(checked))


def angles(number, phi, theta):
    return frame(b"A", number, struct.pack("<hh", round(1e5 * phi), round(1e5 * theta)))


class Bench:
    """A chip with its line in our hands."""

    def __init__(self, firmware, clock_error=0.0):
        self.chip = Chip(firmware, clock_error)
        self.port = os.open(self.chip.port, os.O_RDWR | os.O_NOCTTY)
        self.heard, self.time = b"", 0.0
        self.pulses = [[], []]

    def run(self, seconds, data=b""):
        """The contents of the frames that came meanwhile; pulses are kept with their time, us."""
        os.write(self.port, data)
        count, pulses = self.chip.run(seconds, len(data))
        self.time += seconds
        while count:
            more = os.read(self.port, count)
            count -= len(more)
            self.heard += more
        for axis, width in pulses:
            self.pulses[axis].append((self.time, 1e6 * width))
        return self.frames()

    def frames(self):
        found = []
        while len(self.heard) > 1 and len(self.heard) >= self.heard[1] + 4:
            assert self.heard[0] == 0xB5
            end = self.heard[1] + 2
            assert crc(self.heard[1:end]) == int.from_bytes(self.heard[end : end + 2], "little")
            found.append(self.heard[2:end])
            self.heard = self.heard[end + 2 :]
        return found

    def status(self, seconds=0.021, data=b""):
        """The newest status after a time, as numbers."""
        last = [each for each in self.run(seconds, data) if each[:1] == b"S"][-1]
        return struct.unpack("<xBBBHHHHhhhhHHH", last)

    def widths(self):
        return np.array([self.pulses[axis][-1][1] for axis in (0, 1)])

    def close(self):
        self.chip.close()
        os.close(self.port)


@pytest.fixture(scope="module")
def firmware():
    return build_firmware(FIRMWARE)


@pytest.fixture
def bench(firmware):
    """A chip that has begun."""
    made = Bench(firmware)
    yield made
    made.close()


def began(bench):
    """The bench, with a host that may move the plate."""
    bench.run(0.005)  # what comes before its program has begun is lost
    bench.run(0.03, frame(b"L", 1))
    return bench


@needs_simavr
def test_pulses_at_the_pins_are_those_of_the_commanded_angles_every_20_ms(bench):
    began(bench)
    for number, asked in enumerate([(0.0, 0.0), (0.05, -0.03), (-0.2, 0.2), (0.1, 0.0)]):
        bench.run(0.05, angles(number + 1, *asked))
        # half a tick of 0.5 us, and the cycles of an instruction that simavr does not divide
        np.testing.assert_allclose(
            bench.widths(), NEUTRAL_US + US_PER_RAD * np.array(asked), atol=0.25 + 0.2
        )
    bench.pulses[0].clear()
    bench.run(0.2, angles(9, 0, 0))
    assert len(bench.pulses[0]) == 10


@needs_simavr
def test_no_command_takes_a_pulse_beyond_its_limits(bench):
    began(bench).run(0.05, angles(1, 0.32, -0.32))
    np.testing.assert_allclose(
        bench.widths(), NEUTRAL_US + US_PER_RAD * np.array([0.21, -0.21]), atol=0.45
    )


@needs_simavr
def test_the_plate_is_levelled_100_ms_after_the_last_word_of_the_host_and_stays_so(bench):
    began(bench).run(0.05, angles(1, 0.1, 0.1))
    sent = bench.time
    assert bench.status(0.02, angles(2, 0.1, 0.1))[1] == BY_HOST
    while bench.widths()[0] > NEUTRAL_US + 1:
        bench.run(0.001)
        assert bench.time < sent + 0.2
    # the frame's 10 bytes, up to 1 ms of the board's clock, up to a servo frame, the pulse
    assert 0.1 < bench.time - sent < 0.1 + 10 * BYTE_S + 0.001 + 0.02 + 0.002
    number, state, *_ = bench.status(0.05, angles(3, 0.1, 0.1))
    assert (number, state) == (3, HOST_LOST)
    assert bench.widths()[0] == pytest.approx(NEUTRAL_US, abs=0.45)
    began(bench)
    assert bench.status(0.05, angles(4, 0.1, 0.1))[1] == BY_HOST
    assert bench.widths()[0] > NEUTRAL_US + 100


@needs_simavr
@pytest.mark.parametrize(
    ("command", "wait", "cause"),
    [(f"reset {BROWN_OUT}", 0.03, BROWN_OUT), ("hang", 0.17, WATCHDOG)],
)
def test_a_reset_levels_the_plate_and_is_reported_with_its_cause(bench, command, wait, cause):
    first = bench.run(0.03)[0]
    assert first[:4] == bytes([ord("R"), 0, POWER_ON, 1])
    began(bench).run(0.04, angles(1, 0.1, 0.1))
    bench.chip.tell(command)
    found = bench.run(wait)
    (ready,) = [each for each in found if each[:1] == b"R"]
    assert ready[1:3] == bytes([0, cause])
    number, state, seen, *_ = bench.status(0.05, angles(2, 0.1, 0.1))
    assert (number, state, seen) == (2, RESTARTED, cause)
    assert bench.widths()[0] == pytest.approx(NEUTRAL_US, abs=0.45)


@needs_simavr
def test_a_frame_with_any_wrong_bit_is_not_obeyed(bench):
    began(bench)
    right = angles(1, 0.05, 0.05)
    for bit in range(8 * len(right)):
        wrong = bytearray(right)
        wrong[bit // 8] ^= 1 << bit % 8
        bench.run(0.0045, bytes(wrong) + bytes(36))  # what looks longer is filled up with zeros
    assert bench.status()[1] == 0
    assert bench.status(0.021, right)[1] == BY_HOST


@needs_simavr
def test_a_lost_byte_costs_its_own_frame_and_no_other(bench):
    began(bench)
    right = angles(7, 0.05, 0.05)
    for lost in range(len(right)):
        before = bench.status(0.021)[4]
        cut = right[:lost] + right[lost + 1 :]
        assert bench.status(0.041, right + cut + right + right)[4] - before == 3, lost


@needs_simavr
def test_a_clock_that_is_off_changes_pulses_by_its_error_and_2_percent_break_the_line(firmware):
    for error in (-0.01, 0.01):
        bench = Bench(firmware, error)
        began(bench).run(0.05, angles(1, 0.1, 0.1))
        expected = (NEUTRAL_US + US_PER_RAD * 0.1) / (1 + error)
        np.testing.assert_allclose(bench.widths(), expected, atol=0.45)
        bench.close()
    bench = Bench(firmware, 0.02)  # with the 2.1 % of its divider
    assert bench.run(0.1, frame(b"L", 1)) == []
    bench.close()


@needs_simavr
def test_bytes_that_get_lost_are_as_many_as_asked(bench):
    bench.run(0.03)
    bench.chip.tell("lose 0.2")
    count = sum(bench.chip.run(0.1, 0)[0] for _ in range(8))
    assert 0.74 < count / (8 * 5 * 30) < 0.86


@needs_simavr
def test_the_firmware_fits_and_one_that_does_not_is_refused_in_a_line(tmp_path):
    size = size_of(build_firmware(FIRMWARE))
    assert 2000 < size.flash_bytes < FLASH_BYTES / 4
    assert 150 < size.ram_bytes < RAM_BYTES / 4
    assert 100 < size.stack_bytes < RAM_BYTES / 4
    text = "#include <avr/io.h>\n{} big[{}]; int main(void) {{ return big[PINB] > 1; }}"
    for array, why in (
        (("volatile char", 2020), r"its RAM has 28 bytes left for a stack of up to \d\d"),
        (("volatile const float", 1100), "large are an ekf, and the table"),
        (("volatile const float", 20000), "large are an ekf, and the table"),
    ):
        (tmp_path / "firmware.c").write_text(text.format(*array))
        with pytest.raises(RigError, match=f"does not fit into an ATmega328P.{{1,2}}{why}"):
            build_firmware(tmp_path, None, f"SIZE={array[1]}")
    (tmp_path / "firmware.c").write_text("int main(void) { return nothing; }")
    with pytest.raises(RigError, match=r"avr-gcc: .*'nothing' undeclared"):
        build_firmware(tmp_path, None, "OTHER=1")
    with pytest.raises(RigError, match=r"there is no .*controller\.c"):
        build_firmware(FIRMWARE, tmp_path)


@needs_simavr
def test_a_chip_that_ends_is_an_error_in_one_line(tmp_path):
    file = tmp_path / "no.elf"
    file.write_text("no firmware")
    chip = Chip(file)
    with pytest.raises(RigError, match=r"its process has ended: .*no\.elf"):
        chip.run(0.01, 0)


@needs_simavr
def test_a_chip_that_cannot_be_started_leaves_no_port_open(firmware, monkeypatch):
    def refused(*_, **__):
        raise OSError(12, "no memory")

    opened = []
    openpty = os.openpty
    monkeypatch.setattr(avr.os, "openpty", lambda: opened.append(openpty()) or opened[-1])
    monkeypatch.setattr(avr.subprocess, "Popen", refused)
    monkeypatch.setattr(avr, "build_emulator", lambda: "avr")
    with pytest.raises(RigError, match=r"emulated board: cannot be started: .*no memory$"):
        Chip(firmware)
    for each in opened[0]:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(each)


@needs_simavr
def test_a_file_without_a_size_is_an_error_in_one_line(tmp_path):
    file = tmp_path / "no.elf"
    file.write_text("no firmware")
    with pytest.raises(RigError, match=r"emulated board: .*no\.elf") as refused:
        size_of(file)
    assert "\n" not in str(refused.value)


@needs_simavr
def test_a_firmware_without_an_endless_loop_cannot_hang(tmp_path):
    (tmp_path / "firmware.c").write_text(
        "void _exit(int s) { (void)s; }  void exit(int s) { _exit(s); }\n"
        "int main(void) { return 0; }\n"
    )
    chip = Chip(build_firmware(tmp_path, None, "HANGS=0"))
    with pytest.raises(RigError, match="ended: hang: the firmware has no endless loop"):
        chip.tell("hang")
    chip.close()


def test_what_is_missing_is_named_with_its_package(monkeypatch, tmp_path):
    monkeypatch.setattr(avr, "SIMAVR_HEADERS", tmp_path / "none")
    monkeypatch.setattr(avr.shutil, "which", lambda name: None)
    assert missing_programs() == ["avr-gcc", "avr-size", "cc", "libsimavr-dev"]
    avr.build_emulator.cache_clear()
    with pytest.raises(RigError, match=re.escape("needs cc, which is not installed (packages of")):
        avr.build_emulator()
    monkeypatch.setattr(avr.shutil, "which", lambda name: name)
    with pytest.raises(RigError, match=r"needs simavr, .* libsimavr-dev"):
        avr.build_emulator()
    avr.build_emulator.cache_clear()


def test_a_pulsed_plate_goes_to_where_its_pulses_say_and_stays_without():
    plate = PulsedPlate(load("hold", ("parameters=hobby",)), 1.5e-3, 1.91e-3)
    plate.pulse(0, 1.5e-3 + 1.91e-3 * 0.1)
    plate.pulse(1, 1.5e-3 - 1.91e-3 * 0.05)
    for _ in range(250):
        plate.advance()
    play = np.radians(0.3)
    np.testing.assert_allclose(plate.state[2::4], (0.1, -0.05), atol=play / 2 + 1e-4)


@pytest.mark.parametrize("step", [0.0015, 0.004, 0.0003])
def test_a_step_that_does_not_divide_the_turns_of_chip_and_plate_is_refused(step):
    scenario = load("hold", ("plant.kind=lagrange",))
    plant = scenario.plant.model_copy(update={"step": step})
    with pytest.raises(RigError, match=f"plant.step: must divide the 0.002 s .*, got {step:g}$"):
        PulsedPlate(scenario.model_copy(update={"plant": plant}), 1.5e-3, 1.91e-3)


@pytest.mark.parametrize("step", [0.002, 0.001, 0.0004])
def test_the_plate_goes_on_by_as_much_time_as_the_chip(step):
    settings = ("plant.kind=lagrange", f"plant.step={step}", "plant.start.x_rate=0.1",
                "plant.friction.rolling_mm=0")  # fmt: skip
    plate = PulsedPlate(load("hold", settings), 1.5e-3, 1.91e-3)
    for _ in range(100):
        plate.advance()
    assert plate.state[0] == pytest.approx(0.1 * 100 * avr.TICK_S, rel=1e-6)


MUTATIONS = {
    "a tick too long": ("((ticks) - 1)", "((ticks) + 1)"),
    "axes exchanged": ("OCR1A = COMPARE(pulse_ticks[0])", "OCR1A = COMPARE(pulse_ticks[1])"),
    "no watchdog of the host": (">= HOST_TIMEOUT_MS", ">= 60000"),
    "watchdog not latched": ("level_because(HOST_LOST)", "level_because(0)"),
    "obeys after a reset": ("level_because(RESTARTED)", "level_because(0)"),
    "no watchdog of the program": ("wdt_enable(WDTO_120MS)", "wdt_disable()"),
    "cause forgotten": ("reset_cause = MCUSR", "reset_cause = 1"),
    "check sum not looked at": ("valid = crc ==", "valid = crc || crc =="),
    "frame not sought again": ("memmove(frame, frame + 1, --count)", "count = 0"),
    "no limit of the angle": ("fmaxf(-MAX_ANGLE_RAD, fminf(MAX_ANGLE_RAD, angle[i]))", "angle[i]"),
}  # fmt: skip
CHECKS = [
    test_pulses_at_the_pins_are_those_of_the_commanded_angles_every_20_ms,
    test_no_command_takes_a_pulse_beyond_its_limits,
    test_the_plate_is_levelled_100_ms_after_the_last_word_of_the_host_and_stays_so,
    lambda bench: test_a_reset_levels_the_plate_and_is_reported_with_its_cause(
        bench, f"reset {BROWN_OUT}", 0.03, BROWN_OUT
    ),
    lambda bench: test_a_reset_levels_the_plate_and_is_reported_with_its_cause(
        bench, "hang", 0.17, WATCHDOG
    ),
    test_a_frame_with_any_wrong_bit_is_not_obeyed,
    test_a_lost_byte_costs_its_own_frame_and_no_other,
]


@needs_simavr
@pytest.mark.long
@pytest.mark.parametrize("name", MUTATIONS)
def test_a_firmware_with_a_mistake_fails_a_check(name, tmp_path):
    text = (FIRMWARE / "firmware.c").read_text("utf-8")
    old, new = MUTATIONS[name]
    assert old in text
    (tmp_path / "firmware.c").write_text(text.replace(old, new), "utf-8")
    (tmp_path / "rig.h").write_text((FIRMWARE / "rig.h").read_text("utf-8"), "utf-8")
    program, failed = build_firmware(tmp_path), 0
    for check in CHECKS:
        bench = Bench(program)
        try:
            check(bench)
        except (AssertionError, IndexError, ValueError):
            failed += 1
        finally:
            bench.close()
    assert failed


def test_the_clock_is_that_of_the_firmware():
    assert f"#define F_CPU {CLOCK_HZ}UL" in (FIRMWARE / "firmware.c").read_text("utf-8")
