"""`twin.fmu.bus_node`.

The emulated drive as a node of a simulated bus: the answers of the Python emulator, byte for byte;
operations, clocks and the description as FMI-LS-BUS 1.0 has them."""

import ctypes
import itertools
import random
import re
import struct
import subprocess
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import pytest
from bus_node_importer import BusNode, frames_of, make_library, operation, split, transmit
from click.testing import CliRunner
from fmpy.validation import validate_fmu

import ballplate as bp
from twin.base.errors import RecordError, TwinError
from twin.cli import ballplate as command
from twin.emulator.drive import VELOCITY_UNIT, EmulatedDrive, Power
from twin.emulator.drive_objects import AKD_MODES, Frame, drive_objects
from twin.fmu import bus_node

HERE = Path(__file__).parent
STEP_S = 0.001
NODE = 5


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    """The library of an exported drive."""
    return make_library(tmp_path_factory.mktemp("bus"))


class Pair:
    """The drive in C and the one in Python, given the same frames."""

    def __init__(self, library, *, start_counts=0, dt=STEP_S):
        self.dt = dt
        self.node = BusNode(library, node=NODE, start_counts=start_counts)
        self.twin = EmulatedDrive(NODE, start_counts=start_counts)
        *configuration, boot_up = split(self.node.begin())
        assert [code for code, _ in configuration] == [0x40, 0x40]
        assert frames_of(operation(*boot_up)) == self.twin.receive(Frame(0x123))

    def exchange(self, *frames):
        """Both receive the frames and go on by a step; what both send."""
        expected = [sent for frame in frames for sent in self.twin.receive(frame)]
        expected += self.twin.step(self.dt)
        assert frames_of(self.node.exchange(b"".join(map(transmit, frames)), self.dt)) == expected
        return expected

    def read(self, index, sub=0):
        """The answer to an SDO read."""
        (answer,) = self.exchange(request(0x40, index, sub))
        return answer.data

    def write(self, index, sub, value, size):
        """Write an object by SDO; the abort code, 0 if there is none."""
        (answer,) = self.exchange(write(index, sub, value, size))
        return struct.unpack("<I", answer.data[4:])[0] if answer.data[0] == 0x80 else 0


def request(head, index, sub, data=bytes(4)):
    return Frame(0x600 + NODE, struct.pack("<BHB", head, index, sub) + data)


def write(index, sub, value, size):
    data = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little").ljust(4, b"\0")
    return request(0x23 | (4 - size) << 2, index, sub, data)


def network(command, node=NODE):
    return Frame(0x000, bytes((command, node)))


SYNC = Frame(0x080)
OBJECTS = drive_objects(NODE)
ENABLE = [write(0x6060, 0, 3, 1), *(write(0x6040, 0, word, 2) for word in (6, 7, 15))]


def draw_request(rng):
    """One SDO request, valid or not, of a kind that is drawn, too."""
    key = rng.choice(sorted(OBJECTS))
    known = OBJECTS[key]
    values = (known.default, 0, 1, rng.getrandbits(32), 1 << 31 | known.default)
    kinds = {
        30: lambda: request(0x40 | rng.randrange(32), *key, rng.randbytes(4)),
        22: lambda: write(*key, rng.choice(values), known.size),
        5: lambda: write(*key, rng.choice(values), rng.randrange(1, 5)),
        8: lambda: write(0x6040, 0, rng.choice((6, 7, 15, 15, 0x8F, 0, 0x10F, 2, 11)), 2),
        7: lambda: write(0x60FF, 0, rng.randrange(-9000, 9000) * 1000, 4),
        9: lambda: write(0x6060, 0, rng.choice((3, 3, 1, 2, 5, -3, -4, 9)), 1),
        6: lambda: request(0x22, *key, rng.randbytes(4)),
        3: lambda: request(0x40, rng.randrange(1 << 16), rng.randrange(256)),
        4: lambda: request(0x40, key[0], rng.randrange(256)),
        2: lambda: Frame(0x600 + NODE, rng.randbytes(rng.choice((8, 8, 8, 0, 3, 7)))),
    }
    return rng.choices(list(kinds.values()), list(kinds))[0]()


def draw_mapping(rng):
    """The requests of a host that maps some objects into a PDO, which may fit or not."""
    number = rng.choice((0x1400, 0x1800)) + rng.randrange(4)
    keys = rng.choices(sorted(OBJECTS), k=rng.randrange(1, 6))
    fitting = [key for key, known in OBJECTS.items() if known.pdo and number > 0x1700]
    keys = keys if rng.random() < 0.3 else rng.choices(fitting or [(0x6040, 0)], k=len(keys))
    entries = [index << 16 | sub << 8 | 8 * OBJECTS[index, sub].size for index, sub in keys]
    yield write(number, 1, OBJECTS[number, 1].default | 1 << 31, 4)
    yield write(number + 0x200, 0, 0, 1)
    yield from (write(number + 0x200, 1 + i, entry, 4) for i, entry in enumerate(entries))
    yield write(number + 0x200, 0, rng.choice((len(entries), 9)), 1)
    yield write(number, 1, OBJECTS[number, 1].default, 4)


@pytest.mark.short("0")
@pytest.mark.parametrize("seed", range(3))
def test_500_sdo_requests_have_the_answers_of_the_emulator(drive, seed):
    rng = random.Random(seed)
    pair = Pair(drive, start_counts=rng.randrange(1 << 31))
    requests = [each for _ in range(15) for each in draw_mapping(rng)]
    while len(requests) < 500:
        requests.insert(rng.randrange(len(requests)), draw_request(rng))
    answers = [answer for each in requests for answer in pair.exchange(each)]
    sdo = [each.data for each in answers if each.cob_id == 0x580 + NODE]
    codes = {struct.unpack("<I", each[4:])[0] for each in sdo if each[0] == 0x80}
    assert len(sdo) > 480
    assert sum(each[0] != 0x80 for each in sdo) > 200
    assert codes == {
        *(0x05040001, 0x06010002, 0x06020000, 0x06040041, 0x06040042),
        *(0x06070010, 0x06090011, 0x06090030, 0x08000022),
    }


def test_every_object_is_read_as_the_emulator_has_it(drive):
    pair = Pair(drive)
    for index in sorted({index for index, _ in OBJECTS}):
        for sub in range(12):
            pair.read(index, sub)


def test_the_states_of_the_network_management(drive):
    pair = Pair(drive)
    beat = Frame(0x700 + NODE)
    assert pair.node.get("nmt_state") == 127
    assert pair.exchange(write(0x1017, 0, 1, 2))[-1] == beat._replace(data=b"\x7f")
    for order, state in ((1, 5), (2, 4), (128, 127), (1, 5)):
        assert beat._replace(data=bytes((state,))) in pair.exchange(
            network(order, order % 2 * NODE)
        )
        assert pair.node.get("nmt_state") == state
    assert pair.exchange(network(2, NODE + 1)) == [beat._replace(data=b"\x05")]
    pair.exchange(network(2))
    assert not any(each.cob_id == 0x580 + NODE for each in pair.exchange(request(0x40, 0x1000, 0)))
    for order in (129, 130):
        assert pair.exchange(network(order))[0] == beat._replace(data=b"\x00")
        assert pair.read(0x1017)[4:6] == bytes(2)
        pair.exchange(write(0x1017, 0, 1, 2))


def test_a_heartbeat_that_the_drive_waits_for_is_missed_as_in_the_emulator(drive):
    pair = Pair(drive)
    pair.write(0x1016, 1, 0x0001_000A, 4)
    pair.exchange(Frame(0x701, b"\x05"), *ENABLE)
    sent = list(itertools.chain.from_iterable(pair.exchange() for _ in range(20)))
    assert [each.cob_id for each in sent] == [0x080 + NODE]
    assert sent[0].data == bytes.fromhex("3081014631323900")  # 8130h, F129


def bring_up(pair):
    """Synchronous PDOs of control word and velocity, status word, position and velocity."""
    for number, record, entries in (
        (0x1400, 0x1600, (0x60400010, 0x60FF0020)),
        (0x1800, 0x1A00, (0x60410010, 0x60640020)),
        (0x1801, 0x1A01, (0x606C0020, 0x60610008)),
    ):
        cob_id = OBJECTS[number, 1].default
        assert pair.write(number, 1, cob_id | 1 << 31, 4) == 0
        assert pair.write(number, 2, 1 + (number == 0x1801), 1) == 0
        assert pair.write(record, 0, 0, 1) == 0
        for sub, entry in enumerate(entries):
            assert pair.write(record, sub + 1, entry, 4) == 0
        assert pair.write(record, 0, len(entries), 1) == 0
        assert pair.write(number, 1, cob_id, 4) == 0
    assert pair.write(0x6060, 0, 3, 1) == 0
    pair.exchange(network(1))


def command_velocity(word, velocity):
    """The receive PDO of a control word and a velocity in 0.001 rpm."""
    return Frame(0x200 + NODE, struct.pack("<Hi", word, velocity))


def test_pdos_go_with_sync_and_the_motor_follows_as_in_the_emulator(drive):
    pair = Pair(drive, start_counts=(1 << 31) - 5000)
    bring_up(pair)
    sent, positions = Counter(), []
    for word in (6, 7, 15):
        pair.exchange(command_velocity(word, 0), SYNC)
    for tick in range(300):
        frames = [command_velocity(0x0F, 600_000 - 4000 * tick)] if tick % 7 else []
        sent.update(each.cob_id for each in pair.exchange(*frames, SYNC))
        positions.append(pair.twin.motor.encoder.counts)
    assert sent == {0x180 + NODE: 300, 0x280 + NODE: 150}
    (status, _) = struct.unpack("<Hi", pair.exchange(SYNC)[0].data)
    assert status & 0x6F == Power.OPERATION_ENABLED
    assert pair.node.get("rate") == pair.twin.rate == pytest.approx(-596_000 * VELOCITY_UNIT)
    assert pair.node.get("status_word") == pair.twin.status
    assert min(positions) < 0 < max(positions)  # the counter has wrapped


def test_empty_entries_of_pdos_are_skipped_as_in_the_emulator(drive):
    pair = Pair(drive)
    bring_up(pair)
    for number, first in ((0x1400, 0x60FF0020), (0x1800, 0x60640020), (0x1801, 0)):
        cob_id = OBJECTS[number, 1].default
        assert pair.write(number, 1, cob_id | 1 << 31, 4) == 0
        assert pair.write(number + 0x200, 0, 0, 1) == 0
        assert pair.write(number + 0x200, 1, first, 4) == 0
        assert pair.write(number + 0x200, 2, 0, 4) == 0
        assert pair.write(number + 0x200, 0, 2, 1) == 0
        assert pair.write(number, 1, cob_id, 4) == 0
    pair.exchange(*ENABLE)
    sent = pair.exchange(Frame(0x200 + NODE, struct.pack("<i", 9000)), SYNC)
    assert [(each.cob_id, len(each.data)) for each in sent] == [(0x180 + NODE, 4)]
    assert pair.exchange(SYNC)[1] == Frame(0x280 + NODE)
    assert pair.node.get("rate") == pair.twin.rate == pytest.approx(9000 * VELOCITY_UNIT)


def test_receive_pdos_that_wait_for_a_sync_are_applied_in_the_order_of_their_first_frames(drive):
    pair = Pair(drive)
    for number in (0x1400, 0x1403):
        cob_id = OBJECTS[number, 1].default
        assert pair.write(number, 1, cob_id | 1 << 31, 4) == 0
        assert pair.write(number, 2, 1, 1) == 0
        assert pair.write(number + 0x200, 0, 0, 1) == 0
        assert pair.write(number + 0x200, 1, 0x60FF0020, 4) == 0
        assert pair.write(number + 0x200, 0, 1, 1) == 0
        assert pair.write(number, 1, cob_id, 4) == 0
    pair.exchange(network(1), *ENABLE)
    first, second, again = (struct.pack("<i", 1000 * n) for n in (-5, 9, 7))
    frames = (Frame(0x505, first), Frame(0x205, second), Frame(0x505, again))
    pair.exchange(*frames)
    assert pair.node.get("rate") == 0.0
    pair.exchange(SYNC)
    assert pair.node.get("rate") == pair.twin.rate == pytest.approx(9000 * VELOCITY_UNIT)
    pair.exchange(write(0x60FF, 0, -(1 << 31), 4))
    assert pair.node.get("rate") == pair.twin.rate < 9000 * VELOCITY_UNIT


@pytest.mark.parametrize(("option", "state"), [(2, 0x07), (6, 0x27)])
def test_an_option_decides_whether_a_quick_stop_can_be_left(drive, option, state):
    pair = Pair(drive)
    pair.exchange(write(0x605A, 0, option, 2), *ENABLE, write(0x60FF, 0, 3_000_000, 4))
    for _ in range(200):
        pair.exchange()
    pair.exchange(write(0x6040, 0, 0x0B, 2))
    pair.exchange(write(0x6040, 0, 0x0F, 2))
    assert pair.node.get("status_word") & 0x6F == pair.twin.status & 0x6F == state
    pair.exchange(write(0x6040, 0, 0x0B, 2))
    for _ in range(400):
        pair.exchange()
    stopped = 0x40 if option == 2 else 0x07
    assert pair.node.get("status_word") & 0x6F == pair.twin.status & 0x6F == stopped


def test_two_drives_and_a_host_on_one_bus_are_those_of_the_emulator(drive):
    """Drive 6 monitors drive 5, whose heartbeat ends with its reset: it stops with F129."""
    nodes = {each: BusNode(drive, node=each) for each in (NODE, NODE + 1)}
    twins = {each: EmulatedDrive(each) for each in nodes}
    sent = {each: frames_of(node.begin()[23:]) for each, node in nodes.items()}
    assert sent == {each: twin.receive(Frame(0x123)) for each, twin in twins.items()}
    script = {
        1: [write(0x1017, 0, 5, 2)],
        3: [write(0x1016, 1, NODE << 16 | 8, 4)._replace(cob_id=0x606)],
        20: [each._replace(cob_id=0x606) for each in ENABLE],
        60: [network(129)],
    }
    seen = []
    for tick in range(100):
        host = script.get(tick, [])
        received = {me: [*host, *sent[NODE + NODE + 1 - me]] for me in nodes}
        for me, frames in received.items():
            sent[me] = frames_of(nodes[me].exchange(b"".join(map(transmit, frames)), STEP_S))
            expected = [answer for frame in frames for answer in twins[me].receive(frame)]
            assert sent[me] == expected + twins[me].step(STEP_S)
            seen += sent[me]
        enabled = nodes[NODE + 1].get("status_word") & 0x6F == Power.OPERATION_ENABLED
        if not 68 <= tick <= 70:  # 8 ms after the boot-up that follows the reset
            assert enabled == (20 <= tick < 68)
    assert Frame(0x086, bytes.fromhex("3081014631323900")) in seen


NEXT_WORDS = {
    Power.SWITCH_ON_DISABLED: (6,),
    Power.READY: (7,),
    Power.SWITCHED_ON: (15,),
    Power.OPERATION_ENABLED: (15, 15, 15, 15, 0x10F, 11),
    Power.FAULT: (0, 0x80),
}
"""Control words of a host that wants a drive to turn, by the state of its power stage."""


def draw_frames(rng, state):
    """What a host, or a careless one, sends to a drive in a state within a step."""
    words = (*NEXT_WORDS.get(state, (15,)) * 9, 0, 6, 7, 15, 0x8F)
    velocity = rng.randrange(-4000, 4000) * 1000
    kinds = {
        50: lambda: [command_velocity(rng.choice(words), velocity), SYNC],
        10: lambda: [SYNC],
        11: lambda: [Frame(0x200 + NODE, rng.randbytes(rng.choice((3, 6, 8)))), SYNC],
        8: lambda: [Frame(0x500 + NODE, rng.randbytes(6))],  # a PDO that is applied at once
        4: lambda: [draw_request(rng), request(0x40, 0x606C, 0)],
        6: lambda: [Frame(0x701, b"\x05")],
        3: lambda: [network(rng.choice((1, 1, 1, 2, 128)), rng.choice((0, NODE, NODE + 1)))],
        5: lambda: [Frame(rng.randrange(0x800), rng.randbytes(rng.randrange(9)))],
        2: lambda: [Frame(0x205, remote=True), Frame(0x585, bytes(8), extended=True)],
    }
    return rng.choices(list(kinds.values()), list(kinds))[0]()


@pytest.mark.short("0")
@pytest.mark.parametrize("seed", range(3))
def test_a_session_of_any_frames_and_inputs_has_the_frames_of_the_emulator(drive, seed):
    rng = random.Random(seed)
    pair = Pair(drive, dt=0.0007)
    bring_up(pair)
    pair.write(0x1016, 1, 0x0001_0064, 4)
    pair.write(0x1017, 0, 5, 2)
    for ramp in (0x6083, 0x6084):
        pair.exchange(write(ramp, 0, 300_000_000, 4))
    codes, states = Counter(), set()
    for _ in range(2000):
        if rng.random() < 0.01:
            pair.twin.power.sto_closed = rng.random() < 0.6
            pair.twin.power.dc_link = rng.random() < 0.7
        assert pair.node.set("sto_closed", pair.twin.power.sto_closed) == 0
        assert pair.node.set("dc_link", pair.twin.power.dc_link) == 0
        frames = draw_frames(rng, pair.twin.state)
        if not any(spoils_pdos(each) for each in frames):
            codes.update(each.cob_id for each in pair.exchange(*frames))
            states.add(pair.twin.state)
    assert codes[0x080 + NODE] > 10
    assert codes[0x180 + NODE] > 150
    assert codes[0x700 + NODE] > 100
    assert states >= {Power.OPERATION_ENABLED, Power.FAULT, Power.SWITCHED_ON}


def spoils_pdos(frame):
    """Whether a frame would change what PDOs carry, or reboot the drive."""
    data = frame.data
    if frame.cob_id == 0x600 + NODE:
        return len(data) == 8 and 0x14 <= data[2] <= 0x1B and data[0] & 0xE0 == 0x20
    return frame.cob_id == 0 and data[:1] in {b"\x81", b"\x82"}


@pytest.mark.parametrize("step", [0.0001, 0.001, 0.01])
def test_a_long_communication_step_is_many_short_ones_of_the_drive(drive, step):
    node, twin = BusNode(drive, node=NODE), EmulatedDrive(NODE)
    node.begin()
    frames = [*ENABLE, write(0x60FF, 0, 500_000, 4)]
    node.exchange(b"".join(map(transmit, frames)), step)
    for frame in frames:
        twin.receive(frame)
    count = max(1, round(step / STEP_S))
    for _ in range(count):
        twin.step(step / count)
    assert node.get("angle") == twin.motor._angle != 0.0


def test_fmpy_s_own_interface_exchanges_frames_with_it(drive):
    folder = drive.parents[2]
    about = fmpy.read_model_description(str(folder))
    known = {each.name: each.valueReference for each in about.modelVariables}
    rx, tx = ([known[f"can.{way}_{part}"] for part in ("Data", "Clock")] for way in ("Rx", "Tx"))
    node = fmpy.fmi3.FMU3Slave(
        guid=about.guid,
        unzipDirectory=str(folder),
        modelIdentifier=about.coSimulation.modelIdentifier,
        instanceName="drive",
    )
    node.instantiate(eventModeUsed=True)
    node.enterInitializationMode()
    node.exitInitializationMode()
    assert node.getClock(tx[1:]) == [True]
    node.setClock(rx[1:], [True])
    node.setBinary(rx[:1], [transmit(Frame(0x601, bytes.fromhex("4000100000000000")))])
    assert node.updateDiscreteStates()[:2] == (False, False)
    node.enterStepMode()
    assert node.doStep(0.0, STEP_S)[0]
    node.enterEventMode()
    assert node.getClock(tx[1:]) == [True]
    answer = Frame(0x581, bytes.fromhex("4300100092010200"))
    assert frames_of(bytes(node.getBinary(tx[:1])[0])) == [answer]
    node.terminate()
    node.freeInstance()


# ---- Operations --------------------------------------------------------------------------------


def test_at_first_the_bus_is_configured_and_the_drive_boots(drive):
    node = BusNode(drive, node=0x7F, bit_rate=500_000)
    expected = "40000000 0d000000 01 20a10700"  # configuration, 13 bytes, CAN_BAUDRATE, 500000
    expected += "40000000 0a000000 04 01"  # arbitration lost: buffer and retransmit
    expected += "10000000 11000000 7f070000 00 00 0100 00"  # transmit, 17 bytes, 77Fh, a byte 0
    assert node.begin() == bytes.fromhex(expected)
    node.update()
    assert node.sent == b""


@pytest.mark.parametrize(
    "bad",
    [
        operation(0x77, b"\1\2"),
        operation(0x20, b"\1\2\3"),
        operation(0x10, struct.pack("<IBBH", 0x605, 0, 0, 9) + bytes(9)),
        operation(0x10, struct.pack("<IBBH", 0x605, 0, 0, 8) + bytes(7)),
        operation(0x10, struct.pack("<IBBH", 0x805, 0, 0, 8) + bytes(8)),
        operation(0x10, struct.pack("<IBBH", 0x605, 2, 0, 8) + bytes(8)),
        operation(0x10, b"\1"),
        operation(0x41),
    ],
)
def test_a_corrupt_operation_is_returned_and_the_next_one_is_obeyed(drive, bad):
    node = BusNode(drive, node=NODE)
    node.begin()
    good = transmit(request(0x40, 0x1000, 0))
    (error, answer) = split(node.exchange(bad + good, STEP_S))
    assert error == (0x01, struct.pack("<H", len(bad)) + bad)
    assert frames_of(operation(*answer))[0].data == bytes.fromhex("4300100092010200")


@pytest.mark.parametrize(
    "bad", [b"\x10", bytes(7), operation(0x42)[:-1] + b"\1", b"\x10" + bytes(9)]
)
def test_bytes_that_are_no_operation_are_returned_to_their_end(drive, bad):
    node = BusNode(drive, node=NODE)
    node.begin()
    rest = bad + transmit(request(0x40, 0x1000, 0))
    assert split(node.exchange(rest, STEP_S)) == [(0x01, struct.pack("<H", len(rest)) + rest)]


def test_what_others_may_send_is_no_error(drive):
    node = BusNode(drive, node=NODE)
    node.begin()
    others = [
        operation(0x01, b"\2\0\1\2"),
        operation(0x11, struct.pack("<IBBBH", 0x605, 0, 0, 0, 12) + bytes(12)),
        operation(0x12, struct.pack("<IBBBBIH", 0x605, 0, 0, 0, 0, 0, 1) + bytes(1)),
        operation(0x20, struct.pack("<I", 0x705)),
        operation(0x30, struct.pack("<I", 0x705)),
        operation(0x31, struct.pack("<IBBB", 0x705, 4, 1, 1)),
        operation(0x40, struct.pack("<BI", 1, 500_000)),
        operation(0x41, b"\1"),
        operation(0x42),
    ]
    assert node.exchange(b"".join(others), STEP_S) == b""
    (answer,) = frames_of(node.exchange(transmit(request(0x40, 0x1000, 0)), STEP_S))
    assert answer.data[4:] == bytes.fromhex("92010200")


def test_more_frames_than_the_buffer_holds_are_lost_with_a_line(drive):
    node = BusNode(drive, node=NODE)
    node.begin()
    asked = transmit(request(0x40, 0x1000, 0))
    for many in (300, 300):
        assert node.activate() == node.put(many * asked) == 0
        node.update()
    node.call("EnterStepMode")
    assert node.step(STEP_S) == (1, True)
    assert node.lines == [
        "the transmit buffer is full: frames are lost; take shorter communication steps"
    ]
    node.call("EnterEventMode")
    assert len(frames_of(node.sent)) == bus_node.CAN_BUS.max_bytes // len(asked)
    assert node.put(bytes(bus_node.CAN_BUS.max_bytes + 1)) == 3
    assert node.lines[-1] == "Rx_Data is longer than its maxSize"


# ---- Clocks and phases -------------------------------------------------------------------------


def test_what_comes_without_its_clock_is_not_received(drive):
    node = BusNode(drive, node=NODE)
    node.begin()
    node.put(transmit(request(0x40, 0x1000, 0)))
    assert node.exchange(b"", STEP_S) == b""
    node.activate()
    assert node.exchange(b"", STEP_S) == b""  # an event forgets its bytes


def test_an_answer_comes_after_the_next_step_and_once(drive):
    node = BusNode(drive, node=NODE)
    node.begin()
    node.activate()
    node.put(transmit(request(0x40, 0x1000, 0)))
    node.update()
    assert not node.ticks
    node.activate()
    node.update()  # the bytes have been received already
    node.call("EnterStepMode")
    assert node.step(STEP_S) == (0, True)
    node.call("EnterEventMode")
    assert len(frames_of(node.sent)) == 1
    assert node.exchange(b"", STEP_S) == b""


def test_what_cannot_be_done_is_one_line(drive):
    node = BusNode(drive)
    assert node.step(STEP_S)[0] == 3
    assert node.set("node", 128) == 3
    assert node.set("angle", 1.0) == 3
    node.begin()
    assert node.step(STEP_S)[0] == 3
    assert node.set("node", 2) == 3
    node.call("EnterStepMode")
    assert node.activate() == 3
    assert node.put(b"\0") == 3
    assert node.step(0.0)[0] == 3
    assert node.status("EnterContinuousTimeMode") == 3
    assert node.lines == [
        "a step needs step mode",
        "node is not in the range that the model description gives",
        "angle cannot be set",
        "a step needs step mode",
        "node can be set before the first step only",
        "Rx_Clock needs event mode",
        "Rx_Data needs event mode",
        "a step must be longer than 0 s and shorter than 1e6 s",
        "model exchange is not a part of this FMU",
    ]
    alone = BusNode(drive, events=False)
    zero = ctypes.c_double(0.0)
    alone.call("EnterInitializationMode", False, zero, zero, False, zero)
    alone.call("ExitInitializationMode")
    assert alone.step(STEP_S)[0] == 0
    assert alone.status("EnterEventMode") == 3


@pytest.mark.parametrize("serialized", [False, True])
def test_a_saved_state_goes_on_to_the_same_bytes(drive, serialized):
    node = BusNode(drive, node=NODE)
    node.begin()
    node.exchange(b"".join(map(transmit, [*ENABLE, write(0x60FF, 0, 500_000, 4)])), STEP_S)
    saved = ctypes.c_void_p()
    node.call("GetFMUState", ctypes.byref(saved))
    other = BusNode(drive) if serialized else node
    asked = transmit(request(0x40, 0x6064, 0))
    first = [node.exchange(asked, STEP_S) for _ in range(50)]
    if serialized:
        size = ctypes.c_size_t()
        node.call("SerializedFMUStateSize", saved, ctypes.byref(size))
        held = (ctypes.c_uint8 * size.value)()
        node.call("SerializeFMUState", saved, held, size)
        saved = ctypes.c_void_p()
        other.call("DeserializeFMUState", held, size, ctypes.byref(saved))
        assert other.status("DeserializeFMUState", held, size.value - 1, ctypes.byref(saved)) == 3
    other.call("SetFMUState", saved)
    assert [other.exchange(asked, STEP_S) for _ in range(50)] == first
    assert len(set(first)) == 50
    other.call("FreeFMUState", ctypes.byref(saved))


# ---- Motor -------------------------------------------------------------------------------------


def test_without_power_inertia_friction_and_load_move_the_shaft(drive):
    inertia, friction, torque = 3e-3, 2e-3, 0.05
    node = BusNode(drive, shaft__inertia=inertia, shaft__friction=friction, load_torque=torque)
    node.begin()
    for _ in range(500):
        node.exchange(b"", STEP_S)
    time, end, lag = 0.5, torque / friction, inertia / friction
    rate = end * (1 - 2.718281828459045 ** (-time / lag))
    assert node.get("rate") == pytest.approx(rate, rel=1e-9)
    assert node.get("angle") == pytest.approx(end * time - lag * rate, rel=1e-5)
    assert node.get("torque") == 0.0


def test_with_power_the_torque_is_that_of_ramp_friction_and_load(drive):
    inertia, friction, load = 3e-3, 2e-3, 0.05
    node = BusNode(drive, node=NODE, shaft__inertia=inertia, shaft__friction=friction)
    node.begin()
    frames = [*ENABLE, write(0x6083, 0, 60_000_000, 4), write(0x60FF, 0, 300_000, 4)]
    node.set("load_torque", load)
    node.exchange(b"".join(map(transmit, frames)), STEP_S)
    acceleration = 60_000 * 2 * 3.141592653589793 / 60  # 60,000 rpm/s
    mean = acceleration * STEP_S / 2
    assert node.get("torque") == pytest.approx(inertia * acceleration + friction * mean - load)
    for _ in range(100):
        node.exchange(b"", STEP_S)
    assert node.get("rate") == pytest.approx(300 * 2 * 3.141592653589793 / 60)
    assert node.get("torque") == pytest.approx(friction * node.get("rate") - load)


def test_sto_opened_in_motion_is_an_emergency_and_lets_the_motor_run_out(drive):
    pair = Pair(drive)
    pair.exchange(*ENABLE, write(0x60FF, 0, 900_000, 4))
    for _ in range(100):
        pair.exchange()
    pair.twin.open_sto()
    pair.node.set("sto_closed", False)
    (emergency,) = pair.exchange()
    assert emergency == Frame(0x080 + NODE, bytes.fromhex("8110014636303200"))  # 1081h, F602
    before = pair.node.get("rate")
    for _ in range(200):
        pair.exchange()
    assert pair.node.get("rate") == pair.twin.rate == pytest.approx(before / 2.718281828, rel=1e-6)


# ---- Description -------------------------------------------------------------------------------


def test_fmpy_finds_nothing_to_complain_of_and_simulates_it(drive):
    fmu = drive.parents[3] / "drive.fmu"
    assert validate_fmu(str(fmu)) == []
    for events in (False, True):
        found = fmpy.simulate_fmu(
            str(fmu),
            stop_time=0.05,
            output_interval=STEP_S,
            start_values={"load_torque": 0.01},
            use_event_mode=events,
        )
        assert found["rate"][-1] == pytest.approx(10 * (1 - 2.718281828459045**-0.25), rel=1e-9)


def test_every_function_of_the_header_is_there(drive):
    header = Path(fmpy.__file__).parent / "c-code" / "fmi3Functions.h"
    declared = re.findall(r"^#define (fmi3\w+) +fmi\dFullName", header.read_text(), re.M)
    assert len(declared) > 40
    loaded = ctypes.CDLL(str(drive))
    assert [name for name in declared if not hasattr(loaded, name)] == []


def test_the_sources_that_are_listed_are_all(drive):
    source = drive.parents[2] / "sources"
    listed = re.findall(r'name="(\w+\.c)"', (source / "buildDescription.xml").read_text())
    assert sorted(listed) == sorted(path.name for path in source.glob("*.c"))


def test_the_terminal_has_the_four_members_that_the_standard_requires(drive):
    folder = drive.parents[2]
    root = ElementTree.parse(folder / "terminalsAndIcons" / "terminalsAndIcons.xml").getroot()
    (terminal,) = root.iter("Terminal")
    assert terminal.get("terminalKind") == "org.fmi-ls-bus.network-terminal"
    assert terminal.get("matchingRule") == "org.fmi-ls-bus.transceiver"
    members = {each.get("memberName"): each for each in terminal}
    assert {each.get("variableKind") for each in terminal} == {"signal"}
    known = BusNode(drive).variables
    found = {role: known[each.get("variableName")] for role, each in members.items()}
    assert found.keys() == {"Rx_Data", "Tx_Data", "Rx_Clock", "Tx_Clock"}
    for way, causality in (("Rx", "input"), ("Tx", "output")):
        data, clock = found[f"{way}_Data"], found[f"{way}_Clock"]
        assert (data.tag, clock.tag) == ("Binary", "Clock")
        assert data.get("causality") == clock.get("causality") == causality
        assert data.get("clocks") == clock.get("valueReference")
        assert clock.get("intervalVariability") == "triggered"
        expected = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'
        assert data.get("mimeType") == expected
        assert int(data.get("maxSize")) == bus_node.CAN_BUS.max_bytes
    model = ElementTree.parse(folder / "modelDescription.xml").getroot()
    assert model.find("CoSimulation").get("hasEventMode") == "true"


def test_the_manifest_says_that_it_is_a_node(drive):
    path = drive.parents[2] / "extra" / "org.fmi-standard.fmi-ls-bus" / "fmi-ls-manifest.xml"
    root = ElementTree.parse(path).getroot()
    space = "{http://fmi-standard.org/fmi-ls-manifest}"
    assert root.tag == "fmiLayeredStandardManifest"
    assert root.get(f"{space}fmi-ls-name") == "org.fmi-standard.fmi-ls-bus"
    assert root.get(f"{space}fmi-ls-version") == "1.0.0"
    assert root.get("isBusSimulationFMU") == "false"


def test_the_buffer_of_the_c_source_has_the_size_of_the_description(drive):
    header = (drive.parents[2] / "sources" / "can_bus.h").read_text()
    assert re.search(r"OPERATION_BYTES = (\d+)", header)[1] == str(bus_node.CAN_BUS.max_bytes)


def test_the_modes_of_the_c_source_are_those_of_the_emulator(drive):
    pair = Pair(drive)
    for mode in range(-128, 128):
        assert (pair.write(0x6060, 0, mode, 1) == 0) == (mode in AKD_MODES)


def test_every_variable_is_on_the_page_about_it(drive):
    page = (HERE.parents[1] / "docs" / "bus-node.md").read_text(encoding="utf-8")
    table = page[page.index("The terminal `can`") : page.index("## What the importer does")]
    named = set(re.findall(r"`([a-z_.]+(?:[RT]x_\w+)?)`", table))
    assert named == BusNode(drive).variables.keys() - {"time"} | {"can"}


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["akd", "drive.csv", "--bus"], "an FMU's file must end in .fmu"),
        (["akd", "drive.fmu"], "a drive, not a scenario; to export it: ballplate export akd drive"),
        (["akd", "drive.fmu"], "drive.fmu --bus"),
        (["adk", "drive.fmu", "--bus"], "adk: no drive that can be exported; did you mean 'akd'?"),
        (["akd", "drive.fmu", "--bus", "--fmi", "3"], "--bus: a drive is exported without"),
        (["akd", "drive.fmu", "--bus", "--set", "a=1"], "--bus: a drive is exported without"),
    ],
)
def test_a_wrong_request_is_one_line(tmp_path, monkeypatch, arguments, line):
    monkeypatch.chdir(tmp_path)
    answer = CliRunner().invoke(command, ["export", *arguments])
    assert isinstance(answer.exception, RecordError | TwinError)
    assert line in str(answer.exception)
    assert list(tmp_path.iterdir()) == []


def test_without_a_compiler_there_are_the_sources_and_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr("twin.base.programs.shutil.which", lambda _: None)
    with pytest.warns(bp.BallplateWarning, match=r"source only.*no C compiler"):
        bp.drive_fmu("akd", tmp_path / "drive.fmu")


@pytest.mark.long
def test_compiler_and_sanitizers_find_nothing(drive, tmp_path):
    source = drive.parents[2] / "sources"
    program = tmp_path / "exercise"
    files = [HERE / "exercise_bus_node.c", *sorted(source.glob("*.c"))]
    flags = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wno-unused-parameter -Werror -g -O1"
    flags += " -fsanitize=address,undefined -fno-sanitize-recover=all"
    build = ["cc", *flags.split(), f"-I{source}", "-o", program, *files, "-lm"]
    subprocess.run(build, check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert int(done.stdout) > 10_000  # operations that were sent
