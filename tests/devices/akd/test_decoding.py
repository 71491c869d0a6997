"""`twin.devices.akd.decoding`.

What a trace says is what was said: canopen's own nodes and the standards' tables are asked."""

import math
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import can
import canopen
import pytest
from canopen.profiles.p402 import OperationMode, State402
from canopen.sdo.exceptions import SdoAbortedError
from hypothesis import given
from hypothesis import strategies as st

from twin.base.errors import LogError
from twin.devices.akd import protocol
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.akd.conversation_summary import list_remarks, summarise
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.object_names import Names
from twin.devices.akd.protocol import table

EDS = Path(__file__).with_name("servo.eds")


def frame(at, identifier, data="", **more):
    data = bytes.fromhex(data)
    return can.Message(
        timestamp=at, arbitration_id=identifier, is_extended_id=False, data=data, **more
    )


def decode(*heard, names=None, rig=None):
    return Conversation(heard, names, rig)


def texts(conversation, kind):
    return [each.text for each in conversation.events if each.kind == kind]


class Wire(canopen.Network):
    """A network of canopen that hands every frame to another one, and keeps it."""

    def __init__(self, heard):
        super().__init__()
        self.heard, self.other = heard, None

    def send_message(self, can_id, data, remote=False):
        at = 1.0 + 0.001 * len(self.heard)
        self.heard.append(frame(at, can_id, bytes(data).hex(), is_remote_frame=remote))
        self.other.notify(can_id, bytearray(data), at)


@pytest.fixture(scope="module")
def talk():
    """A master and a node of canopen talk: every frame, what the master got, the last refusal."""
    heard = []
    master, slave = Wire(heard), Wire(heard)
    master.other, slave.other = slave, master
    node = canopen.LocalNode(5, str(EDS))
    slave.add_node(node)
    remote = master.add_node(5, str(EDS))
    got = [remote.sdo[0x1000].raw, remote.sdo[0x2301].raw]
    remote.sdo[0x2301].raw = "another rather long name"
    remote.sdo[0x2300].raw = -77
    got.append(remote.sdo[0x2300].raw)
    with pytest.raises(SdoAbortedError) as refused:
        remote.sdo.upload(0x2302, 0)
    node.emcy.send(0x2310, 1, b"F3")
    remote.nmt.state = "OPERATIONAL"
    return heard, got, refused.value.code


def test_what_canopen_reads_and_writes_is_told_with_the_names_of_its_eds(talk):
    heard, got, _ = talk
    told = texts(decode(*heard, names=Names(EDS)), "SDO")
    assert got == [0x20192, "axis with a long name", -77]
    assert told[:4] == [
        "reads 1000h Device type of somebody of node 5: CiA 402 (20192h)",
        'reads 2301h Name of the axis of node 5: "axis with a long name"',
        'writes 2301h Name of the axis to node 5: "another rather long name"',
        "writes 2300h Current of phase U to node 5: -77; read back",
    ]


def test_a_refusal_is_told_by_the_code_that_canopen_got(talk):
    heard, _, code = talk
    told = decode(*heard, names=Names(EDS))
    assert f"reads 2302h of node 5: refused, code {code:08X}h, no such object" in texts(told, "SDO")
    assert told.nodes[5].transfers == {"reads": 3, "writes": 2, "refused": 1}
    assert texts(told, "EMCY") == ["2310h continuous over current 46 33"]
    assert told.nodes[5].faults[0]["text"] == "2310h continuous over current 46 33"
    assert texts(told, "NMT") == ["start: node 5"]


@pytest.mark.parametrize("code", SdoAbortedError.CODES)
def test_every_abort_code_that_canopen_knows_has_words(code):
    assert "of the vendor's own" not in protocol.abort_words(code)


def test_every_status_word_is_told_as_the_state_that_canopen_sees():
    masks = State402.SW_MASK.items()
    for status in range(1 << 16):
        truth = next((name for name, (mask, bits) in masks if status & mask == bits), "UNKNOWN")
        assert protocol.state(status) is protocol.DriveState(truth.lower())
        words = protocol.status_words(status)
        assert words.partition(",")[0] == truth.lower()
        assert ("warning" in words) == bool(status & 0x80)
        assert ("no main voltage" in words) == (not status & 0x10)


@pytest.mark.parametrize(
    ("control", "words"),
    [
        (State402.CW_SHUTDOWN, "shutdown"),
        (State402.CW_SWITCH_ON, "switch on"),
        (State402.CW_OPERATION_ENABLED, "enable operation"),
        (State402.CW_DISABLE_VOLTAGE, "disable voltage"),
        (State402.CW_QUICK_STOP, "quick stop"),
        (State402.CW_SWITCH_ON_DISABLED, "fault reset"),
        (0x010F, "enable operation, halt"),
        (0x000E, "shutdown"),  # bit 3 says nothing where bit 0 is not set
    ],
)
def test_a_control_word_is_told_as_the_command_it_is(control, words):
    assert protocol.control_words(control) == words


def test_the_names_of_modes_are_those_that_canopen_has():
    for number, words in table()["modes"].items():
        assert OperationMode.CODE2NAME[int(number)].lower().replace("profiled", "profile") == words


MAPPING = [
    frame(0.0, 0x605, "2f001a0000000000"),
    frame(0.001, 0x585, "60001a0000000000"),
    frame(0.002, 0x605, "23001a0110004160"),
    frame(0.003, 0x585, "60001a0100000000"),
    frame(0.004, 0x605, "23001a0220006460"),
    frame(0.005, 0x585, "60001a0200000000"),
    frame(0.006, 0x605, "2f001a0002000000"),
    frame(0.007, 0x585, "60001a0000000000"),
    frame(0.008, 0x605, "23001801c5030000"),
    frame(0.009, 0x585, "6000180100000000"),
    frame(0.010, 0x605, "40 8f 60 01 00 00 00 00"),
    frame(0.011, 0x585, "43 8f 60 01 00 10 00 00"),
    frame(0.012, 0x605, "40 8f 60 02 00 00 00 00"),
    frame(0.013, 0x585, "43 8f 60 02 01 00 00 00"),
    frame(0.014, 0x605, "40 18 10 01 00 00 00 00"),
    frame(0.015, 0x585, "43 18 10 01 6a 00 00 00"),
]
"""TPDO1 of node 5: status word, position, identifier 3C5h; an AKD that says 4096 counts a turn."""


def test_a_pdo_is_decoded_by_the_mapping_that_the_trace_shows():
    told = decode(*MAPPING, frame(0.1, 0x3C5, "370200 08 00 00"), frame(0.2, 0x3C5, "3702fffbffff"))
    assert texts(told, "PDO") == ["6041h Status word: operation enabled (0237h)"]
    counts = told.series[5, (0x6064, 0)].counts
    assert list(counts) == [2048, -1025]
    signals = summarise(told)["nodes"]["5"]["signals"]["6064h Position actual"]
    assert signals == {
        "from": pytest.approx(-1025 / 4096 * 2 * math.pi),
        "to": pytest.approx(math.pi),
        "unit": "rad",
    }
    assert told.nodes[5].drive == ["operation enabled"]


def test_a_mapping_of_absurdly_many_objects_is_read_as_far_as_subindices_go():
    told = decode(frame(0.0, 0x605, "23001a00ffffffff"), frame(0.001, 0x585, "60001a0000000000"))
    assert len(summarise(told)["pdos"]["185h"]["entries"]) == 0xFF


def test_a_fifth_pdo_has_no_identifier_but_the_one_it_is_given():
    fifth = [frame(each.timestamp, each.arbitration_id, bytes(each.data).hex()) for each in MAPPING]
    for each in fifth:
        if each.data[2] in {0x1A, 0x18}:
            each.data[1] = 4
    told = decode(*fifth, frame(0.1, 0x3C5, "370200080000"), names=Names(EDS))
    assert summarise(told)["pdos"]["3C5h"]["name"] == "TPDO5"
    assert list(told.series[5, (0x6064, 0)].counts) == [2048]
    assert list(summarise(decode(*fifth[:8]))["pdos"]) == []


def test_without_a_mapping_the_rig_file_then_the_eds_then_the_standard_count():
    rig = AkdConfig(axes=(AxisConfig(name="phi", node=5), AxisConfig(name="theta", node=2)))
    long, short, two = (frame(0.1, 0x185, data) for data in ("37020301000000", "3702ffff", "3702"))
    names = Names(EDS)
    assert list(decode(long, names=names, rig=rig).series[5, (0x6064, 0)].counts) == [1]
    assert list(decode(short, names=names).series[5, (0x2300, 0)].counts) == [-1]
    assert list(decode(two, names=names).series) == []
    assert list(decode(two).series) == [(5, (0x6041, 0))]
    assert "4 bytes 37 02 ff ff, 16 bits are known" in texts(decode(short), "PDO")[0]


def test_only_changes_of_what_a_pdo_means_are_told():
    ready, target = "3102", "3106"  # bit 10, target reached, is no other state
    told = decode(*(frame(0.1 * k, 0x185, data) for k, data in enumerate([ready, target, ready])))
    assert len(texts(told, "PDO")) == 1


def test_gaps_and_ends_of_what_comes_regularly_are_told():
    sync = [frame(0.002 * k, 0x080) for k in range(500) if not 200 < k < 205]
    beats = [frame(0.02 * k, 0x701, "05") for k in range(26)]
    told = decode(*sorted(sync + beats, key=lambda each: each.timestamp))
    assert texts(told, "gap") == [
        "no SYNC for 10 ms (usually every 2 ms)",
        "no heartbeat of node 1 from here on (usually every 20 ms)",
    ]
    assert [each.time for each in told.events if each.kind == "gap"] == pytest.approx([0.4, 0.5])
    assert summarise(told)["regular"]["SYNC"] == {
        "usual": pytest.approx(0.002),
        "gaps": 1,
        "longest": pytest.approx(0.01),
        "worst": pytest.approx(0.01),
    }


def test_a_pdo_that_is_missing_with_its_sync_is_no_gap_of_its_own():
    heard = []
    for k in range(500):
        if not 200 < k < 205:
            heard.append(frame(0.002 * k, 0x080))
            heard += [frame(0.002 * k + 0.001, 0x181, "3702")] if k != 300 else []
    assert texts(decode(*heard), "gap") == [
        "no SYNC for 10 ms (usually every 2 ms)",
        "no TPDO1 of node 1 for 4 ms (usually every 2 ms)",
    ]


def test_a_request_that_nobody_answers_is_told():
    told = decode(frame(0, 0x605, "4041600000000000"), frame(1, 0x605, "4064600000000000"))
    assert texts(told, "SDO") == [
        "reads 6041h Status word of node 5: no answer",
        "reads 6064h Position actual of node 5: no answer",
    ]


def test_where_no_size_is_told_a_value_is_as_long_as_its_object():
    written = [frame(0, 0x605, "224060000600ffff"), frame(1, 0x585, "6040600000000000")]
    read = [frame(2, 0x605, "4040600000000000"), frame(3, 0x585, "424060000600ffff")]
    assert texts(decode(*written, *read), "SDO") == [
        "writes 6040h Control word to node 5: shutdown (0006h); read back"
    ]


def test_what_is_no_service_of_canopen_is_counted():
    told = decode(frame(0, 0x10A, "00"), frame(1, 0x10A), frame(2, 0x7E5, "00"))
    assert summarise(told)["strangers"] == {"10Ah": 2, "7E5h": 1}


@given(
    st.lists(
        st.builds(
            can.Message,
            timestamp=st.floats(0, 1e6),
            arbitration_id=st.integers(0, 0x7FF),
            is_extended_id=st.booleans(),
            is_error_frame=st.booleans(),
            is_remote_frame=st.booleans(),
            data=st.binary(max_size=8),
        ),
        min_size=1,
        max_size=30,
    )
)
def test_no_frames_whatever_end_in_an_error(heard):
    told = Conversation(sorted(heard, key=lambda each: each.timestamp))
    summarise(told)
    assert all(event.text.isprintable() for event in told.events)


@pytest.mark.parametrize("content", [b"", b"nothing\0of the kind", b"[1000]\nDataType=rubbish\n"])
def test_what_is_no_eds_is_told_in_one_line(tmp_path, content):
    (tmp_path / "a.eds").write_bytes(content)
    with pytest.raises(LogError, match=r"--eds .*a\.eds: not a readable EDS file"):
        Names(tmp_path / "a.eds")


def vendor(node, number):
    return frame(0.0, 0x580 + node, f"43181001{number.to_bytes(4, 'little').hex()}")


def reads(node, index, sub, data):
    """A request and its answer, expedited or in segments; ``data`` in hex."""
    key, raw = f"{index.to_bytes(2, 'little').hex()}{sub:02x}", bytes.fromhex(data)
    ask = frame(0.1, 0x600 + node, f"40{key}00000000")
    if len(raw) <= 4:
        command = 0x43 | (4 - len(raw)) << 2
        return [ask, frame(0.1, 0x580 + node, f"{command:02x}{key}{raw.ljust(4, bytes(1)).hex()}")]
    found = [ask, frame(0.1, 0x580 + node, f"41{key}{len(raw).to_bytes(4, 'little').hex()}")]
    for k in range(0, len(raw), 7):
        part, last = raw[k : k + 7], k + 7 >= len(raw)
        found.append(frame(0.1, 0x600 + node, f"{k // 7 % 2 << 4 | 0x60:02x}{'00' * 7}"))
        head = k // 7 % 2 << 4 | 7 - len(part) << 1 | last
        found.append(frame(0.1, 0x580 + node, f"{head:02x}{part.ljust(7, bytes(1)).hex()}"))
    return found


def writes(node, index, sub, data):
    """A request to write at most four bytes and its answer; ``data`` in hex."""
    key, raw = f"{index.to_bytes(2, 'little').hex()}{sub:02x}", bytes.fromhex(data)
    command = 0x23 | (4 - len(raw)) << 2
    return [
        frame(0.1, 0x600 + node, f"{command:02x}{key}{raw.ljust(4, bytes(1)).hex()}"),
        frame(0.1, 0x580 + node, f"60{key}00000000"),
    ]


def numbers(index, sub, value):
    return reads(5, index, sub, value.to_bytes(4, "little").hex())


def test_objects_of_a_vendor_have_an_akds_names_only_in_an_akd():
    fault = reads(5, 0x2001, 1, "0500")
    told = decode(vendor(5, 0x6A), *fault)
    assert texts(told, "SDO")[-1] == "reads 2001h:1 Fault number 1 of node 5: F5"
    assert told.nodes[5].faults
    rig = AkdConfig(axes=(AxisConfig(name="phi", node=5), AxisConfig(name="theta", node=2)))
    assert decode(*fault, rig=rig).nodes[5].faults
    for other in (decode(vendor(5, 0xFB), *fault), decode(*fault)):
        assert texts(other, "SDO")[-1] == "reads 2001h:1 of node 5: 5"
        assert not other.nodes[5].faults
    later = decode(*reads(5, 0x36E5, 0, "05000000"), vendor(5, 0x6A))
    assert texts(later, "SDO")[0] == "reads 36E5h Fieldbus parameter 1 of node 5: 5"


SCALES = [
    *numbers(0x608F, 1, 1 << 20), *numbers(0x608F, 2, 1), *numbers(0x6091, 1, 10),
    *numbers(0x6091, 2, 1), *numbers(0x6092, 1, 3600), *numbers(0x6092, 2, 1),
]  # fmt: skip


def test_a_position_is_an_angle_of_the_driven_shaft_by_feed_gear_and_encoder():
    told = decode(*SCALES, *numbers(0x6064, 0, 3600))
    assert texts(told, "SDO")[-1] == "reads 6064h Position actual of node 5: 6.28319 rad"
    factor, unit = told.objects.scale(5, (0x6063, 0))  # in increments of the encoder, at the motor
    assert (factor, unit) == (pytest.approx(2 * math.pi / (1 << 20)), "rad")


@pytest.mark.parametrize("lost", [slice(0, 2), slice(4, 6), slice(8, 10), slice(10, 12)])
def test_without_one_of_them_it_stays_counts(lost):
    frames = list(SCALES)
    del frames[lost]
    told = decode(*frames, *numbers(0x6064, 0, 3600))
    assert texts(told, "SDO")[-1] == "reads 6064h Position actual of node 5: 3600"


def test_a_zero_among_them_is_no_scale():
    told = decode(*SCALES, *numbers(0x6092, 2, 0), *numbers(0x6064, 0, 3600))
    assert texts(told, "SDO")[-1] == "reads 6064h Position actual of node 5: 3600"


def second_axis(status):
    mapping = [
        *reads(5, 0x1A01, 1, "10004168"), *reads(5, 0x1A01, 2, "20006c68"),
        *reads(5, 0x1A01, 0, "02"),
    ]  # fmt: skip
    return [*mapping, frame(0.2, 0x285, f"{status}9cffffff"), frame(0.3, 0x285, "180000000000")]


def test_a_second_axis_is_an_axis_of_its_own():
    told = decode(*second_axis("3702"), frame(0.4, 0x185, "3702"))
    assert told.nodes[5].drive == ["operation enabled"]
    assert told.nodes[5].axes == {2: ["operation enabled", "fault"]}
    assert [each["text"] for each in told.nodes[5].faults] == [
        "axis 2: fault, not under remote control (0018h)"
    ]
    assert "6841h Status word of axis 2: fault, not under remote control (0018h)" in texts(
        told, "PDO"
    )
    assert list(told.series[5, (0x686C, 0)].counts) == [-100, 0]
    third = decode(*reads(5, 0x7060, 0, "fd"), *reads(5, 0x7061, 0, "09"))
    assert texts(third, "SDO") == [
        "reads 7060h Mode of operation of axis 3 of node 5: mode -3",
        "reads 7061h Mode display of axis 3 of node 5: cyclic synchronous velocity",
    ]


def test_the_scale_of_a_second_axis_is_its_own():
    moved = []
    for each in SCALES:
        data = bytearray(each.data)
        data[2] += 8
        moved.append(frame(each.timestamp, each.arbitration_id, data.hex()))
    told = decode(*moved)
    assert told.objects.scale(5, (0x6864, 0)) == (pytest.approx(2 * math.pi / 3600), "rad")
    assert told.objects.scale(5, (0x6064, 0)) == (1.0, "")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("2171", "7121h motor blocked"),
        ("1023", "2310h continuous over current"),
        ("1186", "8611h following error"),
        ("3031", "3130h phase failure"),
        ("0573", "7305h incremental encoder 1 failed"),
        ("5023", "2350h current at the output"),
        ("34ff", "FF34h of the vendor"),
        ("1053", "5310h operating unit"),
    ],
)
def test_an_emergency_has_the_words_of_the_standard(code, words):
    data = f"{code}010000000000"
    assert texts(decode(frame(0.0, 0x085, data)), "EMCY") == [words]


def test_an_akd_keeps_its_own_words_for_its_codes():
    told = decode(vendor(5, 0x6A), frame(0.1, 0x085, "3031010000000000"))
    assert texts(told, "EMCY") == ["3130h bus capacitor overload"]


def test_an_error_code_that_is_read_has_words():
    assert texts(decode(*reads(5, 0x603F, 0, "2171")), "SDO") == [
        "reads 603Fh Error code of node 5: 7121h motor blocked"
    ]


def test_status_bits_that_a_drive_does_not_serve_are_left_alone():
    assert texts(decode(frame(0.0, 0x185, "0800")), "PDO") == ["6041h Status word: fault (0008h)"]
    served = decode(
        *(frame(0.1 * k, 0x185, data) for k, data in enumerate(("3102", "2102", "2100")))
    )
    assert texts(served, "PDO") == [
        "6041h Status word: ready to switch on (0231h)",
        "6041h Status word: ready to switch on, no main voltage (0221h)",
        "6041h Status word: ready to switch on, no main voltage, not under remote control (0021h)",
    ]
    akd = decode(vendor(5, 0x6A), frame(0.1, 0x185, "0800"))
    assert texts(akd, "PDO") == [
        "6041h Status word: fault, no main voltage, not under remote control (0008h)"
    ]


@pytest.mark.parametrize(
    ("mode", "status", "words"),
    [
        (1, 0x1237, "set-point acknowledged"),
        (1, 0x2237, "following error"),
        (3, 0x1237, "speed 0"),
        (3, 0x2237, "maximum slippage"),
        (4, 0x0637, "target reached"),
        (6, 0x1237, "homing attained"),
        (6, 0x3237, "homing attained, homing error"),
        (7, 0x1237, "interpolating"),
        (8, 0x3237, "following error"),
        (9, 0x1237, ""),
        (10, 0x2237, ""),  # reserved there
    ],
)
def test_bits_of_the_status_word_are_those_of_the_mode(mode, status, words):
    told = decode(
        *reads(5, 0x6061, 0, f"{mode:02x}"),
        *reads(5, 0x6041, 0, status.to_bytes(2, "little").hex()),
    )
    assert told.objects.mode(5, 1) == mode
    text = "operation enabled" + (f", {words}" if words else "")
    assert texts(told, "SDO")[-1] == (f"reads 6041h Status word of node 5: {text} ({status:04X}h)")


def test_a_cyclic_mode_that_does_not_follow_says_so_once_it_was_seen_to_follow():
    cst = reads(5, 0x6061, 0, "0a")
    frames = (frame(0.2 + 0.1 * k, 0x185, data) for k, data in enumerate(("3712", "3702", "3102")))
    assert texts(decode(*cst, *frames), "PDO") == [
        "6041h Status word: operation enabled (1237h)",
        "6041h Status word: operation enabled, does not follow the command (0237h)",
        "6041h Status word: ready to switch on (0231h)",
    ]


def test_speed_0_and_target_reached_come_and_go_without_an_event():
    words = (frame(0.2 + 0.1 * k, 0x185, data) for k, data in enumerate(("3702", "3716", "3702")))
    assert len(texts(decode(*reads(5, 0x6061, 0, "03"), *words), "PDO")) == 1


@pytest.mark.parametrize(
    ("mode", "control", "words"),
    [
        (1, 0x001F, "enable operation, new set-point"),
        (1, 0x007F, "enable operation, new set-point, at once, relative"),
        (2, 0x007F, "enable operation, ramp enabled, ramp unlocked, ramp on reference"),
        (6, 0x001F, "enable operation, start homing"),
        (7, 0x001F, "enable operation, interpolate"),
        (3, 0x011F, "enable operation, halt"),
        (9, 0x001F, "enable operation"),
        (1, 0x0016, "shutdown"),
    ],
)
def test_bits_of_the_control_word_are_those_of_the_mode(mode, control, words):
    assert protocol.control_words(control, mode) == words
    second = decode(
        *reads(5, 0x6861, 0, f"{mode:02x}"),
        *reads(5, 0x6840, 0, control.to_bytes(2, "little").hex()),
    )
    assert texts(second, "SDO")[-1] == (
        f"reads 6840h Control word of axis 2 of node 5: {words} ({control:04X}h)"
    )


def test_a_device_without_a_standard_profile_may_be_a_drive():
    told = decode(*reads(5, 0x1000, 0, "00000000"), *reads(5, 0x6041, 0, "3702"))
    assert told.nodes[5].drive == ["operation enabled"]


@pytest.mark.parametrize(
    ("key", "data", "words"),
    [
        (0x2310, "feffffffffffffff", "-2"),
        (0x2311, "01020304", "01 02 03 04"),
        (0x2312, "000000000000f83f", "1.5"),
        (0x2313, "0000c07f", "nan"),
        (0x2314, "6d6f746f72", '"motor"'),
        (0x2315, "ffffffffffffffff", "18446744073709551615 (FFFFFFFFFFFFFFFFh)"),
        (0x2316, "ffff7f", "8388607 (7FFFFFh)"),
        (0x2316, "ffffff", "-1"),
        (0x2317, "f400", "-12"),  # filled up with zeros
        (0x2317, "f4ffffff", "-12"),  # filled up with the sign
        (0x2318, "01", "1"),
        (0x23FF, "feffffffffffffff", "fe ff ff ff ff ff ff ff"),  # of no known type
        (0x23FF, "6d6f746f72", '"motor"'),
    ],
)
def test_a_value_is_decoded_by_the_type_of_its_object(tmp_path, key, data, words):
    types = (0x15, 0xF, 0x11, 0x8, 0x9, 0x1B, 0x10, 0x2, 0x1)
    text = "".join(
        f"[{0x2310 + k:x}]\nParameterName=a\nDataType={kind}\n" for k, kind in enumerate(types)
    )
    (tmp_path / "a.eds").write_text(text)
    told = texts(decode(*reads(5, key, 0, data), names=Names(tmp_path / "a.eds")), "SDO")
    assert told[0].rpartition(": ")[2] == words


def test_a_mode_that_is_sent_wider_than_it_is_keeps_its_sign():
    for data in ("fd", "fd000000", "fdffffff"):
        assert texts(decode(*reads(5, 0x6061, 0, data)), "SDO") == [
            "reads 6061h Mode display of node 5: mode -3"
        ]


def shared(first, second):
    """Node 5 receives by the identifier of TPDO1 of node 1; then PDOs come."""
    setup = [
        *reads(5, 0x1600, 0, "01"), *reads(5, 0x1600, 1, "2000ff60"),
        *reads(5, 0x1400, 1, first),
    ]  # fmt: skip
    return [*setup, frame(0.2, int(second, 16), "9cffffff")]


def test_a_pdo_from_one_device_to_another_is_the_senders():
    beat = frame(0.0, 0x701, "05")
    told = decode(beat, *shared("81010000", "181"))
    assert told.pdos[0x181].name == "TPDO1"
    assert told.nodes[1].frames["PDO"] == 1
    assert list(told.series[5, (0x60FF, 0)].counts) == [-100]
    alone = decode(*shared("81010000", "181"))  # there is no node 1: the host sends it
    assert alone.pdos[0x181][:2] == (5, "RPDO1")


def test_one_pdo_of_the_host_to_two_drives_is_for_both():
    to_both = [*shared("01030000", "0"), *shared("01030000", "0")]
    for each in to_both[:6]:
        each.arbitration_id += 1
    frames = [each for each in to_both if each.arbitration_id]
    told = decode(*frames, frame(0.3, 0x301, "9cffffff"))
    assert list(told.series[5, (0x60FF, 0)].counts) == [-100]
    assert list(told.series[6, (0x60FF, 0)].counts) == [-100]


def test_an_identifier_that_a_pdo_has_left_is_its_no_more():
    told = decode(*MAPPING, frame(0.1, 0x3C5, "370200080000"), frame(0.2, 0x185, "370200080000"))
    assert list(told.series[5, (0x6064, 0)].counts) == [2048]
    assert told.strangers == {0x185: 1}


def test_a_node_of_another_profile_is_no_drive():
    told = decode(
        *reads(5, 0x1000, 0, "91010000"), frame(0.2, 0x185, "0800"), *reads(5, 0x6041, 0, "0800")
    )
    assert not told.nodes[5].drive
    assert texts(told, "SDO")[-1] == "reads 6041h of node 5: 8"


def test_dummy_entries_stand_for_nothing():
    mapping = [
        *reads(5, 0x1A00, 1, "10000600"), *reads(5, 0x1A00, 2, "10004160"),
        *reads(5, 0x1A00, 0, "02"),
    ]  # fmt: skip
    told = decode(*mapping, frame(0.2, 0x185, "ffff3702"))
    assert list(told.series) == [(5, (0x6041, 0))]
    assert told.nodes[5].drive == ["operation enabled"]


def test_error_frames_are_told_and_counted():
    data = "0000000000000000"
    error = [
        frame(0.0, 0x040, data, is_error_frame=True),
        frame(0.1, 0x004, "0010000000000000", is_error_frame=True),
        frame(0.2, 0x080, data, is_error_frame=True),
        frame(0.3, 0x080, data, is_error_frame=True),
        frame(0.4, 0x000, is_error_frame=True),
    ]
    told = decode(*error)
    assert summarise(told)["errors"] == {
        "bus off": 1,
        "controller, receive errors: passive": 1,
        "bus error": 2,
        "of unknown kind": 1,
    }
    assert texts(told, "bus")[0] == "error frame: bus off"


def test_without_times_nothing_is_late():
    sync = [frame(float(k if k < 100 else k + 50), 0x080) for k in range(200)]
    assert texts(Conversation(sync), "gap")
    assert not texts(Conversation(sync, timed=False), "gap")


def test_the_time_of_day_is_read():
    # the upper four bits of the milliseconds are reserved
    heard = [frame(0.0, 0x100, "c82b0af2e93b"), frame(1.0, 0x705, "05")]
    time = datetime(1984, 1, 1) + timedelta(days=0x3BE9, milliseconds=0x20A2BC8)
    assert texts(decode(*heard), "TIME") == [f"the time is {time:%Y-%m-%d %H:%M:%S}.000"]
    shorter = decode(frame(0.0, 0x100, "c82b0a02"), frame(1.0, 0x705, "05"))
    assert shorter.strangers == {0x100: 1}


@pytest.mark.parametrize(
    ("identifier", "data", "who", "words"),
    [
        (0x7E5, "0401000000000000", "host", "all devices: mode 1 (0 waiting, 1 configuration)"),
        (0x7E5, "1107000000000000", "host", "configure node number: 7; an answer of 0 accepts it"),
        (0x7E5, "406a000000000000", "host", "select the device of vendor 6Ah"),
        (0x7E4, "4400000000000000", "a device", "the selected device answers"),
        (0x7E5, "ff00000000000000", "host", "command FFh"),
    ],
)
def test_layer_setting_services_are_read(identifier, data, who, words):
    (event,) = decode(frame(0.0, identifier, data)).events
    assert event.kind == "LSS"
    assert event.who.startswith(who)
    assert event.text == words


def sdo(*rows):
    """Frames of an SDO channel of node 5, 10 ms apart: ``>`` and its bytes of a client."""
    return [
        frame(0.01 * k, 0x605 if row[0] == ">" else 0x585, row[1:].ljust(16, "0"))
        for k, row in enumerate(rows)
    ]


def block(text, *, writes=False, index=0x1008, size=127):
    """A block transfer of CiA 301 (7.2.4.3.9 to 7.2.4.3.16), the blocks of so many segments."""
    key = f"{index & 0xFF:02x}{index >> 8:02x}00"
    pieces = [text[k : k + 7] for k in range(0, len(text), 7)]
    spare = (7 - len(text) % 7) % 7
    sender, receiver = "><" if writes else "<>"
    length = len(text).to_bytes(4, "little").hex()
    rows = [f">c2{key}{length}", f"<a0{key}{size:02x}"] if writes else [
        f">a0{key}{size:02x}", f"<c2{key}{length}", ">a3"
    ]  # fmt: skip
    for begin in range(0, len(pieces), size):
        part = pieces[begin : begin + size]
        for number, piece in enumerate(part, 1):
            last = begin + number == len(pieces)
            rows.append(f"{sender}{number | 0x80 * last:02x}{piece.hex()}")
        rows.append(f"{receiver}a2{len(part):02x}{size:02x}")
    rows += [f"{sender}{0xC1 | spare << 2:02x}", f"{receiver}a1"]
    return sdo(*rows)


@pytest.mark.parametrize("count", [1, 6, 7, 8, 13, 14, 889, 890, 2000])
@pytest.mark.parametrize("writes", [False, True])
@pytest.mark.parametrize("size", [1, 2, 127])
def test_a_block_transfer_is_one_transfer_with_its_bytes(count, writes, size):
    data = bytes(0x21 + k % 90 for k in range(count))
    heard = block(data, writes=writes, size=size)
    after = [frame(99.0, 0x605, "4064600000000000"), frame(99.1, 0x585, "4364600005000000")]
    told = decode(*heard, *after)
    assert [each.good for each in told.observed.transfers] == [True, True]
    assert [each.key for each in told.observed.transfers] == [(0x1008, 0), (0x6064, 0)]
    assert (told.observed.strays, told.strangers.total()) == ([], 0)
    first, second = texts(told, "SDO")
    what = "writes 1008h Device name to" if writes else "reads 1008h Device name of"
    assert first == f'{what} node 5: "{data.decode()}"'
    assert second == "reads 6064h Position actual of node 5: 5"


def test_a_block_is_decoded_by_the_type_of_its_object():
    told = decode(*block(b"\xfe\xff\xff\xff", index=0x6064))
    assert texts(told, "SDO") == ["reads 6064h Position actual of node 5: -2"]
    long = decode(*block(bytes(range(200)), index=0x2100))
    (shown,) = texts(long, "SDO")
    assert shown == f"reads 2100h of node 5: {bytes(range(64)).hex(' ')} ... (200 bytes)"


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (("<01454c4d4f204272", "<8261766f", ">a20100", "<8161766f", ">a20100"), '"ELMO Bravo"'),
        (("<8261766f", ">a20200"), "a block, of which the trace lacks a part"),
        (("<8008100004000405", None), "refused, code 05040004h, CRC error"),
        ((">8008100004000405", None), "given up by the host, code 05040004h, CRC error"),
    ],
)
def test_a_block_may_be_sent_again_lost_or_given_up(rows, words):
    begin = (">a00810007f", "<c20810000a000000", ">a3")
    end = () if rows[-1] is None else ("<d1", ">a1")
    told = decode(*sdo(*begin, *filter(None, rows), *end))
    (text,) = texts(told, "SDO")
    assert words in text
    assert told.observed.strays == []


@pytest.mark.parametrize("kept", [3, 4, 5])
def test_a_block_download_that_stalls_leaves_the_requests_after_it(kept):
    heard = block(b"a name of 20 letters", writes=True)[:kept]  # 3 segments, acknowledgement, end
    after = ["4064600000000000", "4041600000000000", "2b40600006000000"]
    for k, request in enumerate(after):
        answer = ("43" if request[0] == "4" else "60") + request[2:8] + "05000000"
        heard += [frame(9.0 + k, 0x605, request), frame(9.1 + k, 0x585, answer)]
    told = decode(*heard)
    assert told.observed.strays == []
    assert [each.key for each in told.observed.transfers if each.good] == [
        (0x6064, 0),
        (0x6041, 0),
        (0x6040, 0),
    ]


def test_a_device_may_answer_a_block_transfer_without_blocks():
    told = decode(*sdo(">a00810007f", "<4308100045504f53"))
    assert texts(told, "SDO") == ['reads 1008h Device name of node 5: "EPOS"']


@pytest.mark.parametrize("data", ["4308100048303033", "4208100048303033"])
def test_a_name_of_four_letters_is_no_number(data):
    """An AKD's name (1008h) has four letters (its CAN manual, p. 51)."""
    assert texts(decode(*sdo(">4008100000000000", f"<{data}")), "SDO") == [
        'reads 1008h Device name of node 5: "H003"'
    ]


CIA_402_SIGNED = {
    8: [(0x6098, 0), (0x60E3, 1), (0x6060, 0)],
    16: [
        (0x6007, 0), (0x605A, 0), (0x605B, 0), (0x605C, 0), (0x605D, 0), (0x605E, 0), (0x6042, 0),
        (0x6043, 0), (0x6044, 0), (0x604B, 1), (0x606A, 0), (0x6071, 0), (0x6074, 0), (0x6077, 0),
        (0x6078, 0), (0x6086, 0), (0x6088, 0), (0x60B2, 0), (0x60C0, 0), (0x60D0, 1),
    ],
    32: [
        (0x604C, 2), (0x6062, 0), (0x6063, 0), (0x6069, 0), (0x606B, 0), (0x607B, 1), (0x607C, 0),
        (0x607D, 1), (0x607D, 2), (0x60B0, 0), (0x60B1, 0), (0x60BA, 0), (0x60BD, 0), (0x60C1, 1),
        (0x60F4, 0), (0x60F8, 0), (0x60FA, 0), (0x60FC, 0),
    ],
}  # fmt: skip
"""Objects that have a sign by CiA 402-2, by their bits."""


@pytest.mark.parametrize("axis", [0, 0x800])
@pytest.mark.parametrize("bits", CIA_402_SIGNED)
def test_objects_with_a_sign_keep_it(bits, axis):
    for index, sub in CIA_402_SIGNED[bits]:
        told = decode(
            *reads(5, index + axis, sub, (-5).to_bytes(bits // 8, "little", signed=True).hex())
        )
        (text,) = texts(told, "SDO")
        assert text.endswith((": -5", "mode -5")), (hex(index), text)


@pytest.mark.parametrize(
    ("product", "akd"),
    [(0x33303650, True), (0, True), (701, False), (346, False), (3, False), (0x11110100, False)],
)
def test_of_the_drives_of_its_vendor_only_an_akd_has_its_names(product, akd):
    """By the manuals of AKD, S300 and S700, AX2000, and AKD2G, all of vendor 6Ah."""
    code = product.to_bytes(4, "little").hex()
    told = decode(vendor(5, 0x6A), *reads(5, 0x1018, 2, code), *reads(5, 0x2001, 1, "0500"))
    assert ("F5" in texts(told, "SDO")[-1]) is akd
    assert bool(told.nodes[5].faults) is akd
    alone = decode(vendor(5, 0x6A), *reads(5, 0x2001, 1, "0500"))
    assert "F5" in texts(alone, "SDO")[-1]


TORQUE = [
    *writes(5, 0x1A00, 0, "00"), *writes(5, 0x1A00, 1, "10007760"),
    *writes(5, 0x1A00, 0, "01"),
]  # fmt: skip
STORED = writes(5, 0x1010, 1, "73617665")
BOOT, PDO_BEFORE, PDO_AFTER = (
    frame(5.0, 0x705, "00"),
    frame(4.0, 0x185, "3702"),
    frame(6.0, 0x185, "3702"),
)


@pytest.mark.parametrize(
    ("settings", "torques", "states"),
    [
        (TORQUE, [0x237], [0x237]),
        ([*TORQUE, *STORED], [0x237, 0x237], None),
        ([*TORQUE, *STORED, *writes(5, 0x1011, 1, "6c6f6164")], [0x237], [0x237]),
        ([*reads(5, 0x1A00, 1, "10007760"), *reads(5, 0x1A00, 0, "01")], [0x237, 0x237], None),
    ],
    ids=["written", "written and stored", "restored", "read"],
)
def test_a_node_that_boots_has_the_pdos_that_it_stored(settings, torques, states):
    """CiA 301, 7.3.2.2: on a reset parameters have their power-on values, those last stored."""
    told = decode(*settings, PDO_BEFORE, BOOT, PDO_AFTER)
    assert list(told.series[5, (0x6077, 0)].counts) == torques
    assert (list(told.series[5, (0x6041, 0)].counts) if states else None) == states


def test_services_are_found_by_the_identifiers_that_the_trace_shows():
    moved = [
        *writes(5, 0x1005, 0, "90000040"), *reads(5, 0x1014, 0, "a7000000"),
        *reads(5, 0x1201, 1, "41060000"), *reads(5, 0x1201, 2, "c1050000"),
    ]  # fmt: skip
    used = [
        frame(1.0, 0x090), frame(1.1, 0x090), frame(1.2, 0x0A7, "1081010000000000"),
        frame(1.3, 0x641, "4064600000000000"), frame(1.4, 0x5C1, "4364600007000000"),
    ]  # fmt: skip
    told = decode(*moved, *used)
    assert len(told.sync) == 2
    assert list(told.nodes) == [5]
    assert texts(told, "EMCY") == ["8110h CAN overrun"]
    assert texts(told, "SDO")[-1] == "reads 6064h Position actual of node 5: 7"


def test_a_drive_that_the_trace_does_not_show_to_be_one_is_remarked():
    told = decode(frame(0.0, 0x705, "05"), frame(0.1, 0x185, "0100"))
    (remark,) = list_remarks(told)
    assert remark == (
        "node 5: the trace does not show what its PDOs carry: decoded by the defaults of CiA 402, "
        "as if it was a drive"
    )
    for shown in (reads(5, 0x1000, 0, "92010200"), reads(5, 0x6502, 0, "ad030000"), TORQUE):
        assert list_remarks(decode(*shown, frame(9.0, 0x185, "3702"))) == []
    assert list_remarks(decode(frame(0.1, 0x185, "3702"), names=Names(EDS))) == []


@pytest.mark.parametrize(("frames", "words"), [(1.0, "1 frame"), (2.0, "2 frames")])
def test_a_span_without_times_counts_frames(frames, words):
    assert Conversation.span(SimpleNamespace(timed=False), frames) == words
