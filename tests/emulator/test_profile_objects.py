"""Tests of `twin.emulator.profile_objects`: every entry of the EDS, by canopen's SDO client."""

import struct
from itertools import pairwise
from pathlib import Path

import canopen
import pytest
from stepped_canopen import SteppedNetwork, read_eds

from twin.base.data_file import read_packaged
from twin.devices.akd.eds import read_data_sheet
from twin.emulator.drive_objects import Frame
from twin.emulator.profile_eds import eds_text

NODE = 5
EDS = read_eds(NODE)
VARIABLES = {(each.index, each.subindex): each for entry in EDS.values()
             for each in (entry.values() if hasattr(entry, "subindices") else [entry])}  # fmt: skip
READ_ONLY, NO_OBJECT, NO_SUB = 0x06010002, 0x06020000, 0x06090011
LENGTH, RANGE, NOT_NOW = 0x06070010, 0x06090030, 0x08000022
EMPTY = {(0x1003, sub): 0x08000024 for sub in range(1, 9)}
"""Error fields without an error have no value (CiA 301)."""
SIGNED = {1: "<b", 2: "<h", 4: "<i"}
COB_ID_INVALID = 1 << 31


def text(key):
    return f"{key[0]:04X}h:{key[1]}"


@pytest.fixture(scope="module")
def shared():
    return SteppedNetwork(NODE)


@pytest.fixture
def network():
    return SteppedNetwork(NODE)


def download(network, key, data, **how):
    """The abort code of a write; 0 where it is accepted."""
    try:
        network[NODE].sdo.download(*key, data, **how)
    except canopen.SdoAbortedError as refusal:
        return refusal.code
    return 0


def upload(network, key):
    return network[NODE].sdo.upload(*key)


def bytes_of(entry, value):
    return (value % (1 << len(entry))).to_bytes(len(entry) // 8, "little")


def test_the_eds_and_the_table_of_objects_have_the_same_entries():
    tables = read_packaged("twin.emulator", "profile_objects.toml")
    keys = {(int(key[:4], 16), int(key[5:])) for key in tables["objects"]}
    keys |= {(int(key, 16), sub) for key in tables["mappings"] for sub in range(9)}
    assert set(VARIABLES) == keys
    assert len(keys) > 180


def test_the_eds_is_read_by_the_reader_of_traces_without_remarks(tmp_path):
    file = tmp_path / "drive.eds"
    file.write_text(eds_text())
    sheet = read_data_sheet(Path(file))
    assert sheet.remarks == ()
    assert set(sheet.objects) == set(VARIABLES)


@pytest.mark.parametrize("key", VARIABLES, ids=text)
def test_an_entry_reads_as_its_eds_has_it(shared, key):
    entry = VARIABLES[key]
    if key in EMPTY:
        with pytest.raises(canopen.SdoAbortedError) as caught:
            upload(shared, key)
        assert caught.value.code == EMPTY[key]
        return
    data = upload(shared, key)
    if entry.data_type == canopen.objectdictionary.VISIBLE_STRING:
        assert data.decode() == entry.default
        return
    assert len(data) == len(entry) // 8
    if key not in {(0x6041, 0)}:  # what a drive at rest shows otherwise than at its start
        assert entry.decode_raw(data) == entry.default


@pytest.mark.parametrize(
    "key", [key for key, each in VARIABLES.items() if not each.writable], ids=text
)
def test_an_entry_that_cannot_be_written_says_so(shared, key):
    assert download(shared, key, bytes(max(1, len(VARIABLES[key]) // 8))) == READ_ONLY


NUMBERS = {key: each for key, each in VARIABLES.items() if each.writable}
SPECIAL = {
    *((index, sub) for index in (0x1010, 0x1011) for sub in (1,)),
    *((base + number, sub) for base in (0x1600, 0x1A00) for number in range(4) for sub in range(9)),
    *((base + number, sub) for base in (0x1400, 0x1800) for number in range(4) for sub in (1, 3)),
    (0x1005, 0), (0x1014, 0), (0x6040, 0),
}  # fmt: skip
"""Entries with rules of their own, which tests below hold."""


def bounds(entry):
    """Smallest and largest value of an entry, and those of its type."""
    bits, signed = len(entry), entry.data_type in canopen.objectdictionary.SIGNED_TYPES
    least, most = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    low = least if entry.min is None else entry.min
    high = most if entry.max is None else entry.max
    return low, high, least, most


@pytest.mark.parametrize("key", [key for key in NUMBERS if key not in SPECIAL], ids=text)
def test_an_entry_takes_its_bounds_and_nothing_beyond_or_of_another_length(network, key):
    entry = VARIABLES[key]
    low, high, least, most = bounds(entry)
    for value in (low, high):
        assert download(network, key, bytes_of(entry, value)) == 0
        if key != (0x1003, 0):
            assert entry.decode_raw(upload(network, key)) == value
    for value in {low - 1, high + 1}:
        if least <= value <= most:
            assert download(network, key, bytes_of(entry, value)) == RANGE
            assert entry.decode_raw(upload(network, key)) != value
    size = len(entry) // 8
    for wrong in {1, 2, 4} - {size}:
        assert download(network, key, bytes(wrong)) == LENGTH


@pytest.mark.parametrize(
    ("key", "code"), [((0x4000, 0), NO_OBJECT), ((0x1018, 9), NO_SUB), ((0x6041, 1), NO_SUB)]
)
def test_what_is_not_there_has_the_abort_code_for_it(shared, key, code):
    assert download(shared, key, b"\0") == code
    with pytest.raises(canopen.SdoAbortedError) as caught:
        upload(shared, key)
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("index", "value"), [(0x605A, 3), (0x605A, 4), (0x6060, 4), (0x6098, 36), (0x1800, 245)]
)
def test_values_within_a_range_that_mean_nothing_are_refused(network, index, value):
    key = (index, 2 if index == 0x1800 else 0)
    assert download(network, key, bytes_of(VARIABLES[key], value)) == RANGE


@pytest.mark.parametrize("identifier", [0x000, 0x07F, 0x101, 0x580 + NODE, 0x600 + NODE, 0x701])
def test_a_pdo_cannot_have_the_identifier_of_another_service(network, identifier):
    assert download(network, (0x1800, 1), struct.pack("<I", COB_ID_INVALID | identifier)) == RANGE


def test_a_name_comes_in_segments(network):
    assert upload(network, (0x1008, 0)) == b"Emulated CiA 402 drive"
    answers = [frame.data for _, frame in network.heard if frame.cob_id == 0x580 + NODE]
    assert answers[0] == struct.pack("<BHBI", 0x41, 0x1008, 0, 22)
    assert [answer[0] for answer in answers[1:]] == [0x00, 0x10, 0x00, 0x1D]


def test_a_number_may_be_written_in_segments(network):
    data = struct.pack("<i", -5)
    assert download(network, (0x607A, 0), data, force_segment=True) == 0
    assert upload(network, (0x607A, 0)) == data
    assert download(network, (0x607A, 0), bytes(6)) == LENGTH
    assert download(network, (0x6041, 0), bytes(2), force_segment=True) == READ_ONLY


def answer(network, *requests):
    """The answer to the last of some requests."""
    for request in requests:
        network.send_message(0x600 + NODE, request)
    return network.heard[-1][1].data


BEGIN_UPLOAD = struct.pack("<BHBI", 0x40, 0x1008, 0, 0)
ABORT = struct.pack("<BHBI", 0x80, 0x1008, 0, 0)


@pytest.mark.parametrize(
    ("requests", "code"),
    [
        ([b"\x60" + bytes(7)], 0x05040001),  # a segment of no transfer
        ([BEGIN_UPLOAD, b"\x70" + bytes(7)], 0x05030000),  # a wrong toggle bit
        ([BEGIN_UPLOAD, b"\x00" + bytes(7)], 0x05040001),  # a segment the other way
        ([BEGIN_UPLOAD, ABORT, b"\x60" + bytes(7)], 0x05040001),
        ([struct.pack("<BHBI", 0xA0, 0x1008, 0, 0)], 0x05040001),  # a block transfer
        ([struct.pack("<BHBI", 0x21, 0x607A, 0, 6)], LENGTH),  # announces six bytes
        ([struct.pack("<BHBI", 0x20, 0x607A, 0, 0), bytes(8)], LENGTH),  # seven bytes and more
    ],
)
def test_a_broken_transfer_is_aborted(network, requests, code):
    reply = answer(network, *requests)
    assert reply[0] == 0x80
    assert struct.unpack("<I", reply[4:]) == (code,)


def mapping(network, number, *entries):
    """Map entries to a transmit PDO in CiA 301's order, and switch it on with type 255."""
    record = network[NODE].tpdo[number]
    record.read()
    record.clear()
    for index, sub in entries:
        record.add_variable(index, sub)
    record.trans_type, record.enabled, record.inhibit_time = 255, True, 100
    record.save()
    return record


def test_a_mapping_changes_only_while_its_pdo_is_off(network):
    entry = struct.pack("<I", 0x60640020)
    assert download(network, (0x1A00, 1), entry) == NOT_NOW
    assert download(network, (0x1A00, 0), b"\0") == NOT_NOW
    assert download(network, (0x1800, 1), struct.pack("<I", COB_ID_INVALID | 0x180 + NODE)) == 0
    assert download(network, (0x1A00, 1), entry) == NOT_NOW  # its count is not 0 yet
    assert download(network, (0x1A00, 0), b"\0") == 0
    assert download(network, (0x1A00, 1), entry) == 0
    assert download(network, (0x1A00, 2), struct.pack("<I", 0x60630020)) == 0x06040041
    assert download(network, (0x1A00, 2), struct.pack("<I", 0x606C0020)) == 0
    assert download(network, (0x1A00, 3), struct.pack("<I", 0x60410010)) == 0
    assert download(network, (0x1A00, 0), b"\3") == 0x06040042  # 80 bits
    assert download(network, (0x1A00, 0), b"\2") == 0
    assert download(network, (0x1800, 1), struct.pack("<I", 0x180 + NODE)) == 0


def test_an_inhibit_time_changes_only_while_its_pdo_is_off(network):
    assert download(network, (0x1800, 3), struct.pack("<H", 50)) == NOT_NOW
    assert download(network, (0x1800, 1), struct.pack("<I", COB_ID_INVALID | 0x180 + NODE)) == 0
    assert download(network, (0x1800, 3), struct.pack("<H", 50)) == 0


def sent(network, cob_id):
    return [time for time, frame in network.heard if frame.cob_id == cob_id]


def test_an_event_driven_pdo_comes_after_a_change_and_not_within_its_inhibit_time(network):
    mapping(network, 1, (0x6041, 0), (0x607A, 0))
    network[NODE].nmt.state = "OPERATIONAL"
    network.run(0.5)
    assert len(sent(network, 0x180 + NODE)) == 1
    for value in range(1, 11):
        network.drives[0].store.set(0x607A, 0, value)
        network.run(0.002)
    network.run(0.02)
    times = sent(network, 0x180 + NODE)
    assert all(after - before > 0.0099 for before, after in pairwise(times))
    assert len(times) == 4
    assert network[NODE].tpdo[1][0x607A].raw == 10


def test_an_event_timer_sends_a_pdo_that_has_not_changed(network):
    mapping(network, 1, (0x6041, 0))
    network[NODE].sdo[0x1800][5].raw = 50
    network[NODE].nmt.state = "OPERATIONAL"
    network.run(0.52)
    assert len(sent(network, 0x180 + NODE)) == 11


@pytest.mark.parametrize(("kind", "count"), [(1, 12), (3, 4), (0, 2)])
def test_a_synchronous_pdo_comes_with_its_sync(network, kind, count):
    mapping(network, 1, (0x607A, 0))
    network[NODE].sdo[0x1800][2].raw = kind
    network[NODE].nmt.state = "OPERATIONAL"
    for number in range(12):
        if number == 6:
            network.drives[0].store.set(0x607A, 0, 1)
        network.send_message(0x080, b"")
    assert len(sent(network, 0x180 + NODE)) == count


def test_a_remote_request_is_answered_where_bit_30_allows_it(network):
    network[NODE].nmt.state = "OPERATIONAL"
    network.run(0.1)
    before = len(sent(network, 0x180 + NODE))
    network.send_message(0x180 + NODE, b"", remote=True)
    assert len(sent(network, 0x180 + NODE)) == before
    assert download(network, (0x1800, 1), struct.pack("<I", COB_ID_INVALID | 0x180 + NODE)) == 0
    assert download(network, (0x1800, 1), struct.pack("<I", 0x180 + NODE)) == 0
    network.run(0.1)
    before = len(sent(network, 0x180 + NODE))
    network.send_message(0x180 + NODE, b"", remote=True)
    assert len(sent(network, 0x180 + NODE)) == before + 1


def test_parameters_are_stored_by_a_signature_and_come_back_after_a_reset(network):
    node, key = network[NODE], (0x1010, 1)
    assert download(network, key, struct.pack("<I", 1)) == 0x08000020
    node.sdo[0x6081].raw = 4711
    node.nmt.send_command(129)
    assert node.sdo[0x6081].raw == EDS[0x6081].default
    node.sdo[0x6081].raw = 4711
    node.store()
    node.sdo[0x6081].raw = 1
    node.nmt.send_command(129)
    assert node.sdo[0x6081].raw == 4711
    node.restore()
    assert node.sdo[0x6081].raw == 4711
    node.nmt.send_command(129)
    assert node.sdo[0x6081].raw == EDS[0x6081].default


def test_a_reset_of_the_communication_leaves_the_profile_s_objects(network):
    node = network[NODE]
    node.sdo[0x6081].raw, node.sdo[0x1017].raw = 4711, 100
    node.nmt.send_command(130)
    assert network.heard[-1][1] == Frame(0x700 + NODE, b"\0")
    assert (node.sdo[0x6081].raw, node.sdo[0x1017].raw) == (4711, 0)


def test_heartbeats_tell_canopen_the_state(network):
    node = network[NODE]
    node.sdo[0x1017].raw = 20
    for state in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
        node.nmt.send_command(canopen.nmt.NMT_COMMANDS[state])
        network.run(0.05)
        assert node.nmt.state == state
    assert len(sent(network, 0x700 + NODE)) == pytest.approx(0.15 / 0.02, abs=2)


def test_a_stopped_node_answers_no_sdo(network):
    network[NODE].nmt.send_command(2)
    network[NODE].sdo.RESPONSE_TIMEOUT = 0.01
    with pytest.raises(canopen.SdoCommunicationError):
        upload(network, (0x1000, 0))


def test_emergencies_have_the_identifier_of_1014h_or_are_off(network):
    drive = network.drives[0]
    for cob_id, expected in ((0x0B5, [0x0B5]), (COB_ID_INVALID | 0x085, [])):
        assert download(network, (0x1014, 0), struct.pack("<I", cob_id)) == 0
        network.heard.clear()
        drive.fail(0x4310)
        network.run(0.001)
        assert [frame.cob_id for _, frame in network.heard] == expected
        network[NODE].sdo[0x6040].raw = 0
        network[NODE].sdo[0x6040].raw = 0x80
    assert network[NODE].sdo[0x1003][0].raw == 2
