"""What a trace says is what was said: canopen's own nodes and the standards' tables are asked."""

import math
from pathlib import Path

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
from twin.devices.akd.decoding import Conversation, Names
from twin.devices.akd.protocol import table

EDS = Path(__file__).with_name("servo.eds")


def frame(at, identifier, data="", **more):
    data = bytes.fromhex(data)
    return can.Message(
        timestamp=at, arbitration_id=identifier, is_extended_id=False, data=data, **more
    )


def said(*heard, names=None, rig=None):
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
    told = texts(said(*heard, names=Names(EDS)), "SDO")
    assert got == [0x20192, "axis with a long name", -77]
    assert told[:4] == [
        f"reads 1000h Device type of somebody of node 5: {got[0]} (20192h)",
        'reads 2301h Name of the axis of node 5: "axis with a long name"',
        'writes 2301h Name of the axis to node 5: "another rather long name"',
        "writes 2300h Current of phase U to node 5: -77; read back",
    ]


def test_a_refusal_is_told_by_the_code_that_canopen_got(talk):
    heard, _, code = talk
    told = said(*heard, names=Names(EDS))
    assert f"reads 2302h of node 5: refused, code {code:08X}h, no such object" in texts(told, "SDO")
    assert told.nodes[5].transfers == {"reads": 3, "writes": 2, "refused": 1}
    assert texts(told, "EMCY") == ["2310h current F3"]
    assert told.nodes[5].faults[0]["text"] == "2310h current F3"
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
]
"""TPDO1 of node 5: status word, position, identifier 3C5h; the drive says 4096 counts a turn."""


def test_a_pdo_is_decoded_by_the_mapping_that_the_trace_shows():
    told = said(*MAPPING, frame(0.1, 0x3C5, "370200 08 00 00"), frame(0.2, 0x3C5, "3702fffbffff"))
    assert texts(told, "PDO") == ["6041h Status word: operation enabled (0237h)"]
    counts = told.series[5, (0x6064, 0)].counts
    assert list(counts) == [2048, -1025]
    signals = told.summary()["nodes"]["5"]["signals"]["6064h Position actual"]
    assert signals == {
        "from": pytest.approx(-1025 / 4096 * 2 * math.pi),
        "to": pytest.approx(math.pi),
        "unit": "rad",
    }
    assert told.nodes[5].drive == ["operation enabled"]


def test_a_mapping_of_absurdly_many_objects_is_read_as_far_as_subindices_go():
    told = said(frame(0.0, 0x605, "23001a00ffffffff"), frame(0.001, 0x585, "60001a0000000000"))
    assert len(told.summary()["pdos"]["185h"]["entries"]) == 0xFF


def test_a_fifth_pdo_has_no_identifier_but_the_one_it_is_given():
    fifth = [frame(each.timestamp, each.arbitration_id, bytes(each.data).hex()) for each in MAPPING]
    for each in fifth:
        if each.data[2] in {0x1A, 0x18}:
            each.data[1] = 4
    told = said(*fifth, frame(0.1, 0x3C5, "370200080000"), names=Names(EDS))
    assert told.summary()["pdos"]["3C5h"]["name"] == "TPDO5"
    assert list(told.series[5, (0x6064, 0)].counts) == [2048]
    assert list(said(*fifth[:8]).summary()["pdos"]) == []


def test_without_a_mapping_the_rig_file_then_the_eds_then_the_standard_count():
    rig = AkdConfig(axes=(AxisConfig(name="phi", node=5), AxisConfig(name="theta", node=2)))
    long, short, two = (frame(0.1, 0x185, data) for data in ("37020301000000", "3702ffff", "3702"))
    names = Names(EDS)
    assert list(said(long, names=names, rig=rig).series[5, (0x6064, 0)].counts) == [1]
    assert list(said(short, names=names).series[5, (0x2300, 0)].counts) == [-1]
    assert list(said(two, names=names).series) == []
    assert list(said(two).series) == [(5, (0x6041, 0))]
    assert "4 bytes 37 02 ff ff, 16 bits are known" in texts(said(short), "PDO")[0]


def test_only_changes_of_what_a_pdo_means_are_told():
    ready, target = "3102", "3106"  # bit 10, target reached, is no other state
    told = said(*(frame(0.1 * k, 0x185, data) for k, data in enumerate([ready, target, ready])))
    assert len(texts(told, "PDO")) == 1


def test_gaps_and_ends_of_what_comes_regularly_are_told():
    sync = [frame(0.002 * k, 0x080) for k in range(500) if not 200 < k < 205]
    beats = [frame(0.02 * k, 0x701, "05") for k in range(26)]
    told = said(*sorted(sync + beats, key=lambda each: each.timestamp))
    assert texts(told, "gap") == [
        "no SYNC for 10 ms (usually every 2 ms)",
        "no heartbeat of node 1 from here on (usually every 20 ms)",
    ]
    assert [each.time for each in told.events if each.kind == "gap"] == pytest.approx([0.4, 0.5])
    assert told.pauses["SYNC"] == {
        "usual": pytest.approx(0.002),
        "gaps": 1,
        "longest": pytest.approx(0.01),
    }


def test_a_pdo_that_is_missing_with_its_sync_is_no_gap_of_its_own():
    heard = []
    for k in range(500):
        if not 200 < k < 205:
            heard.append(frame(0.002 * k, 0x080))
            heard += [frame(0.002 * k + 0.001, 0x181, "3702")] if k != 300 else []
    assert texts(said(*heard), "gap") == [
        "no SYNC for 10 ms (usually every 2 ms)",
        "no TPDO1 of node 1 for 4 ms (usually every 2 ms)",
    ]


def test_a_request_that_nobody_answers_is_told():
    told = said(frame(0, 0x605, "4041600000000000"), frame(1, 0x605, "4064600000000000"))
    assert texts(told, "SDO") == [
        "reads 6041h Status word of node 5: no answer",
        "reads 6064h Position actual of node 5: no answer",
    ]


def test_where_no_size_is_told_a_value_is_as_long_as_its_object():
    written = [frame(0, 0x605, "224060000600ffff"), frame(1, 0x585, "6040600000000000")]
    read = [frame(2, 0x605, "4040600000000000"), frame(3, 0x585, "424060000600ffff")]
    assert texts(said(*written, *read), "SDO") == [
        "writes 6040h Control word to node 5: shutdown (0006h); read back"
    ]


def test_what_is_no_service_of_canopen_is_counted():
    told = said(frame(0, 0x10A, "00"), frame(1, 0x10A), frame(2, 0x7E5, "00"))
    assert told.summary()["strangers"] == {"10Ah": 2, "7E5h": 1}


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
    told.summary()
    assert all(event.text.isprintable() for event in told.events)


@pytest.mark.parametrize("content", [b"", b"nothing\0of the kind", b"[1000]\nDataType=rubbish\n"])
def test_what_is_no_eds_is_told_in_one_line(tmp_path, content):
    (tmp_path / "a.eds").write_bytes(content)
    with pytest.raises(LogError, match=r"--eds .*a\.eds: not a readable EDS file"):
        Names(tmp_path / "a.eds")
