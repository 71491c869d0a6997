"""Tests of `twin.emulator.drive`."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_objects import Frame
from twin.emulator.power_stage import Power, PowerStage

NODE = 5
HOST = 127


@pytest.fixture
def drive():
    made = EmulatedDrive(NODE)
    assert made.step(0.001) == [Frame(0x700 + NODE, b"\0")]
    return made


def read(drive, index, sub):
    (answer,) = drive.receive(Frame(0x600 + NODE, struct.pack("<BHBI", 0x40, index, sub, 0)))
    assert answer.cob_id == 0x580 + NODE
    return answer.data


def write(drive, index, sub, value, size):
    head = struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub)
    data = head + (value % 2 ** (8 * size)).to_bytes(size, "little").ljust(4, b"\0")
    answers = {frame.cob_id: frame.data for frame in drive.receive(Frame(0x600 + NODE, data))}
    return answers[0x580 + NODE]


def control(drive, *words):
    for word in words:
        write(drive, 0x6040, 0, word, 2)


def enable(drive, rate=0.0):
    write(drive, 0x6060, 0, 3, 1)
    write(drive, 0x60FF, 0, round(rate * 9549.2966), 4)
    control(drive, 0x06, 0x07, 0x0F)
    assert drive.state is Power.OPERATION_ENABLED


def run(drive, seconds):
    return [frame for _ in range(round(1000 * seconds)) for frame in drive.step(0.001)]


@pytest.mark.parametrize(
    ("index", "sub", "answer"),
    [
        (0x1000, 0, "43 0010 00 92010200"),
        (0x1018, 1, "43 1810 01 6a000000"),
        (0x1017, 0, "4b 1710 00 00000000"),
        (0x1016, 1, "43 1610 01 00000000"),
        (0x1005, 0, "43 0510 00 80000000"),
        (0x605A, 0, "4b 5a60 00 02000000"),
        (0x608F, 1, "43 8f60 01 00001000"),
        (0x1400, 1, "43 0014 01 05020000"),
        (0x1803, 1, "43 0318 01 85040000"),
        (0x1800, 2, "4f 0018 02 ff000000"),
        (0x1800, 3, "4b 0018 03 14000000"),
        (0x1603, 2, "43 0316 02 2000ff60"),
        (0x1A03, 2, "43 031a 02 20006c60"),
        (0x60C2, 2, "4f c260 02 fd000000"),
    ],
)
def test_an_object_has_its_documented_default(drive, index, sub, answer):
    assert read(drive, index, sub) == bytes.fromhex(answer)


@pytest.mark.parametrize(
    ("index", "sub", "value", "size", "code"),
    [
        (0x4000, 0, 0, 4, 0x06020000),
        (0x1018, 9, 0, 4, 0x06090011),
        (0x6041, 0, 0, 2, 0x06010002),
        (0x1017, 0, 0, 4, 0x06070010),
        (0x6060, 0, 9, 1, 0x06090030),
        (0x1A00, 1, 0x60410010, 4, 0x08000022),
    ],
)
def test_a_wrong_write_is_aborted_with_its_code(drive, index, sub, value, size, code):
    answer = write(drive, index, sub, value, size)
    assert answer == struct.pack("<BHBI", 0x80, index, sub, code)


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())))
@settings(max_examples=60)
def test_any_frame_at_all_is_borne(sent):
    drive = EmulatedDrive(NODE)
    drive.receive(Frame(0, bytes((1, NODE))))
    for cob_id, data, remote in sent:
        for answer in drive.receive(Frame(cob_id, data, remote)):
            assert len(answer.data) <= 8
        drive.step(0.001)


TRANSITIONS = [
    (Power.SWITCH_ON_DISABLED, 0x06, Power.READY, 2),
    (Power.READY, 0x07, Power.SWITCHED_ON, 3),
    (Power.READY, 0x0F, Power.SWITCHED_ON, 3),
    (Power.SWITCHED_ON, 0x0F, Power.OPERATION_ENABLED, 4),
    (Power.OPERATION_ENABLED, 0x07, Power.SWITCHED_ON, 5),
    (Power.SWITCHED_ON, 0x06, Power.READY, 6),
    (Power.READY, 0x00, Power.SWITCH_ON_DISABLED, 7),
    (Power.READY, 0x02, Power.SWITCH_ON_DISABLED, 7),
    (Power.OPERATION_ENABLED, 0x06, Power.READY, 8),
    (Power.OPERATION_ENABLED, 0x00, Power.SWITCH_ON_DISABLED, 9),
    (Power.SWITCHED_ON, 0x00, Power.SWITCH_ON_DISABLED, 10),
    (Power.SWITCHED_ON, 0x02, Power.SWITCH_ON_DISABLED, 10),
    (Power.OPERATION_ENABLED, 0x02, Power.QUICK_STOP, 11),
    (Power.QUICK_STOP, 0x00, Power.SWITCH_ON_DISABLED, 12),
    (Power.FAULT, 0x80, Power.SWITCH_ON_DISABLED, 15),
]


@pytest.mark.parametrize("state", Power)
@pytest.mark.parametrize("word", [0x00, 0x02, 0x06, 0x07, 0x0F, 0x80])
def test_a_control_word_makes_its_transition_and_no_other(state, word):
    stage = PowerStage()
    stage.state = state
    assert stage.control(word) == []
    known = [after for before, sent, after, _ in TRANSITIONS if (before, sent) == (state, word)]
    if word == 0x80 and state not in {Power.FAULT, Power.FAULT_REACTION}:
        known = [Power.SWITCH_ON_DISABLED]  # as 00: the reset bit means nothing else
    if not known and word in {0x00, 0x02} and state is Power.NOT_READY:
        known = [Power.SWITCH_ON_DISABLED]
    if not known and word == 0x06 and state is Power.NOT_READY:
        known = [Power.READY]
    assert stage.state in (known or [state])


def test_transition_16_needs_an_option_that_keeps_the_quick_stop():
    for option, after in ((2, Power.QUICK_STOP), (6, Power.OPERATION_ENABLED)):
        stage = PowerStage()
        stage.state, stage.option = Power.QUICK_STOP, option
        stage.control(0x0F)
        assert stage.state is after


@pytest.mark.parametrize("state", [Power.SWITCHED_ON, Power.OPERATION_ENABLED, Power.QUICK_STOP])
def test_a_fault_is_braked_first_and_then_stands(drive, state):
    drive.power.state = state
    drive.motor.rate = 2.0
    drive.fail(235)
    assert drive.state is Power.FAULT_REACTION
    run(drive, 0.01)
    assert drive.state is Power.FAULT
    assert drive.rate == 0


def test_a_held_reset_bit_resets_only_once(drive):
    drive.fail(235)
    control(drive, 0x80)
    drive.fail(235)
    control(drive, 0x80)
    assert drive.state is Power.FAULT
    control(drive, 0x00, 0x80)
    assert drive.state is Power.SWITCH_ON_DISABLED


@pytest.mark.parametrize(
    ("state", "bits"),
    [
        (Power.NOT_READY, 0x00),
        (Power.SWITCH_ON_DISABLED, 0x40),
        (Power.READY, 0x21),
        (Power.SWITCHED_ON, 0x23),
        (Power.OPERATION_ENABLED, 0x27),
        (Power.QUICK_STOP, 0x07),
        (Power.FAULT_REACTION, 0x0F),
        (Power.FAULT, 0x08),
    ],
)
def test_the_status_word_shows_the_state_and_the_inputs(drive, state, bits):
    drive.power.state = state
    assert drive.status == bits | 1 << 4 | 1 << 9
    drive.power.dc_link, drive.remote, drive.warning, drive.limit_active = False, False, True, True
    assert drive.status == bits | 1 << 7 | 1 << 11


def test_the_velocity_ramps_as_set_and_holds(drive):
    write(drive, 0x6083, 0, round(100 * 9549.2966), 4)
    enable(drive, 2.0)
    run(drive, 0.01)
    assert drive.rate == pytest.approx(1.0, rel=1e-6)
    run(drive, 0.02)
    assert drive.rate == pytest.approx(2.0, rel=1e-4)
    counts, angle = drive.motor.encoder.counts, 2.0 * 2.0 / 100 / 2 + 2.0 * 0.01
    assert counts == pytest.approx(angle / (2 * math.pi) * 2**20, abs=3)


def test_by_default_it_goes_on_turning_when_the_master_is_silent(drive):
    enable(drive, 2.0)
    frames = run(drive, 5.0)
    assert drive.rate == pytest.approx(2.0, rel=1e-4)
    assert frames == []


def test_a_watched_master_that_falls_silent_is_f129_and_a_braked_stop(drive):
    write(drive, 0x1016, 1, HOST << 16 | 60, 4)
    enable(drive, 2.0)
    run(drive, 1.0)
    assert drive.rate > 1.9  # the watch begins with the first heartbeat
    drive.receive(Frame(0x700 + HOST, b"\5"))
    run(drive, 0.059)
    assert drive.state is Power.OPERATION_ENABLED
    sent = run(drive, 0.01)
    assert drive.power.faults == [129]
    assert Frame(0x080 + NODE, b"\x30\x81\x01F129\0") in sent
    assert drive.rate == 0


def test_a_heartbeat_is_sent_only_when_asked_for(drive):
    assert run(drive, 0.1) == []
    write(drive, 0x1017, 0, 20, 2)
    assert run(drive, 0.1) == [Frame(0x700 + NODE, b"\x7f")] * 5


def test_no_pdo_moves_before_nmt_start(drive):
    assert drive.receive(Frame(0x080)) == []
    drive.receive(Frame(0x200 + NODE, b"\x06\0"))
    assert drive.state is Power.SWITCH_ON_DISABLED


def test_a_default_pdo_is_applied_at_once(drive):
    drive.receive(Frame(0, bytes((1, NODE))))
    drive.receive(Frame(0x200 + NODE, b"\x06\0"))
    assert drive.state is Power.READY


def test_a_synchronous_pdo_waits_for_the_sync(drive):
    for index, kind in ((0x1400, 0x200), (0x1800, 0x180)):
        write(drive, index, 1, 1 << 31 | kind + NODE, 4)
        write(drive, index, 2, 1, 1)
        write(drive, index, 1, kind + NODE, 4)
    for number in (1, 2, 3):
        write(drive, 0x1800 + number, 1, 1 << 31 | 0x180 + 0x100 * number + NODE, 4)
    drive.receive(Frame(0, bytes((1, NODE))))
    assert drive.receive(Frame(0x200 + NODE, b"\x06\0")) == []
    assert drive.state is Power.SWITCH_ON_DISABLED
    assert drive.receive(Frame(0x080)) == [Frame(0x180 + NODE, b"\x50\x02")]
    assert drive.state is Power.READY


@pytest.mark.parametrize("kind", [1, 255])
def test_an_empty_entry_of_a_pdo_carries_nothing(drive, kind):
    for index, cob_id, entry in ((0x1400, 0x205, 0x60400010), (0x1800, 0x185, 0x60410010)):
        write(drive, index, 1, 1 << 31 | cob_id, 4)
        write(drive, index, 2, 1 if index == 0x1800 else kind, 1)
        write(drive, index + 0x200, 0, 0, 1)
        write(drive, index + 0x200, 1, 0, 4)
        write(drive, index + 0x200, 2, entry, 4)
        write(drive, index + 0x200, 0, 3, 1)
        write(drive, index, 1, cob_id, 4)
    drive.receive(Frame(0, bytes((1, NODE))))
    assert drive.receive(Frame(0x205, b"\x06\0")) == []
    first = b"\x50\x02" if kind == 1 else b"\x31\x02"
    assert drive.receive(Frame(0x080)) == [Frame(0x185, first)]
    assert drive.receive(Frame(0x080)) == [Frame(0x185, b"\x31\x02")]
    assert drive.state is Power.READY


def test_an_entry_without_an_object_has_its_room_in_a_pdo(drive):
    for index, entry in ((0x1600, 0x60400010), (0x1A00, 0x60410010)):
        drive.store.set(index, 0, 2)
        drive.store.set(index, 1, 0x5FFF0010)
        drive.store.set(index, 2, entry)
    drive.store.set(0x1800, 2, 1)
    drive.receive(Frame(0, bytes((1, NODE))))
    drive.receive(Frame(0x200 + NODE, b"\xff\xff\x06\0"))
    assert drive.receive(Frame(0x080)) == [Frame(0x180 + NODE, b"\0\0\x31\x02")]


def test_a_pdo_that_is_too_short_is_refused_with_an_emergency(drive):
    drive.receive(Frame(0, bytes((1, NODE))))
    (sent,) = drive.receive(Frame(0x500 + NODE, b"\x06\0\0"))
    assert sent.cob_id == 0x080 + NODE
    assert sent.data[:2] == b"\x10\x82"
    assert drive.state is Power.SWITCH_ON_DISABLED


def test_sto_opened_in_motion_lets_the_motor_run_out(drive):
    enable(drive, 2.0)
    run(drive, 0.05)
    drive.open_sto()
    run(drive, 0.1)
    assert drive.power.faults == [602]
    assert drive.rate == pytest.approx(2.0 * math.exp(-0.1 / 0.2), rel=0.02)
    control(drive, 0x00, 0x80)
    assert drive.state is Power.FAULT
    drive.power.sto_closed = True
    control(drive, 0x00, 0x80)
    assert drive.state is Power.SWITCH_ON_DISABLED


def test_enabling_with_sto_open_is_f602(drive):
    drive.open_sto()
    control(drive, 0x06, 0x07)
    assert drive.power.faults == [602]


def test_losing_the_dc_link_in_motion_is_an_undervoltage(drive):
    enable(drive, 1.0)
    drive.power.dc_link = False
    (sent,) = run(drive, 0.001)
    assert sent.data[:3] == b"\x20\x32\x01"
    assert drive.power.faults == [502]


def test_the_mode_cannot_change_in_motion(drive):
    enable(drive, 2.0)
    run(drive, 0.01)
    assert write(drive, 0x6060, 0, 1, 1)[:1] == b"\x80"


def test_a_plant_that_tells_where_it_is_replaces_the_drive_s_own_integration(drive):
    drive.motor.sense(0.5, -0.1)
    enable(drive, 3.0)
    run(drive, 0.1)
    assert drive.motor.encoder.counts == math.floor(0.5 / (2 * math.pi) * 2**20)
    assert drive.motor.plate.counts == math.floor(-0.1 / (2 * math.pi) * 245760)


def test_a_reboot_forgets_every_setting_and_says_so(drive):
    write(drive, 0x1017, 0, 20, 2)
    enable(drive)
    drive.reboot()
    assert run(drive, 0.1) == [Frame(0x700 + NODE, b"\0")]
    assert drive.state is Power.SWITCH_ON_DISABLED
