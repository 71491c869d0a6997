"""Tests of `twin.emulator.bus_port`: drives on buses of python-can, and a master there."""

import os
from contextlib import contextmanager

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from serving import serving
from stepped_canopen import TURN, read_eds

from twin.base.errors import RigError
from twin.base.jobs import wait_until
from twin.emulator.bus_name import BusName
from twin.emulator.bus_port import open_bus
from twin.emulator.drive_objects import Frame
from twin.emulator.load import InertiaLoad
from twin.emulator.profile_drive import ProfileDrive
from twin.emulator.virtual_bus import VirtualBus

NODE = 7
GROUP, PORT = "239.74.163.2", 20000 + os.getpid() % 40000
"""A multicast group with a port of this process, as others may run these tests here, too."""


def test_a_port_that_is_not_there_is_refused_in_one_line():
    with pytest.raises(RigError, match="no channel '/dev/ttyNO'") as caught:
        open_bus(BusName("slcan", "/dev/ttyNO"))
    assert "\n" not in str(caught.value)


@contextmanager
def served(name):
    drive = ProfileDrive(NODE, InertiaLoad())
    with VirtualBus([drive], name) as rig, serving(rig.server):
        yield rig


@contextmanager
def connected(**bus):
    """A master of canopen on a bus."""
    network = canopen.Network()
    network.connect(**bus)
    try:
        node = network.add_node(BaseNode402(NODE, read_eds(NODE)))
        node.sdo.RESPONSE_TIMEOUT = 5.0  # the machine that runs the tests may be busy
        for name in ("RESET_FAULT", "SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE"):
            setattr(node, f"TIMEOUT_{name}", 10.0)
        node.TIMEOUT_CHECK_TPDO = 10.0
        yield node
    finally:
        network.sync.stop()
        network.disconnect()


def drive_by_pdos(node):
    """Enable a drive and move it a turn, by PDOs with a SYNC every 10 ms."""
    network = node.network
    node.nmt.state = "PRE-OPERATIONAL"
    node.setup_pdos()
    for number, entries in {1: (0x6041, 0x6061, 0x6064)}.items():
        record = node.tpdo[number]
        record.clear()
        for index in entries:
            record.add_variable(index)
        record.trans_type, record.enabled = 1, True
        record.save()
    for number in (2, 3, 4):
        node.tpdo[number].enabled = False
        node.tpdo[number].save()
    record = node.rpdo[1]
    record.clear()
    for index in (0x6040, 0x6060, 0x607A):
        record.add_variable(index)
    record.trans_type, record.enabled = 255, True
    record.save()
    for number in (2, 3, 4):
        node.rpdo[number].enabled = False
        node.rpdo[number].save()
    node.tpdo_values, node.tpdo_pointers, node.rpdo_pointers = {}, {}, {}
    node.setup_402_state_machine()
    # over udp_multicast canopen hears its own PDOs, takes them for periodic and stops sending them
    for record in node.rpdo.values():
        if record.enabled:
            network.unsubscribe(record.cob_id)
    network.sync.start(0.01)
    node.nmt.state = "OPERATIONAL"
    node.op_mode = "PROFILED POSITION"
    node.state = "OPERATION ENABLED"
    record = node.rpdo[1]
    record[0x607A].raw = TURN
    for word in (0x1F, 0x0F):
        record[0x6040].raw = word
        record.transmit()
    assert wait_until(lambda: abs(node.tpdo_values[0x6064] - TURN) < 64, 60.0)


@pytest.mark.real_time
def test_canopen_moves_a_drive_by_pdos_on_a_virtual_bus():
    with (
        served(BusName("virtual", "emulated")) as rig,
        connected(interface="virtual", channel="emulated") as node,
    ):
        drive_by_pdos(node)
        assert rig.drives[0].enabled


def multicast_refusal():
    """Why a multicast on this machine does not arrive; None where it does."""
    try:
        sender, hearer = (
            can.Bus(interface="udp_multicast", channel=GROUP, port=PORT) for _ in range(2)
        )
    except Exception as error:  # noqa: BLE001  sandboxes refuse in many ways
        return f"udp_multicast cannot be opened: {error}"
    with sender, hearer:
        try:
            sender.send(can.Message(arbitration_id=0x7E5))
        except can.CanError as error:
            return f"udp_multicast cannot be sent: {error}"
        return None if hearer.recv(1.0) else "udp_multicast does not arrive"


@pytest.mark.real_time
def test_canopen_moves_a_drive_by_pdos_over_sockets():
    if refusal := multicast_refusal():
        pytest.skip(refusal)
    with (
        served(BusName("udp_multicast", GROUP, PORT)) as rig,
        connected(interface="udp_multicast", channel=GROUP, port=PORT, fd=False) as node,
    ):
        drive_by_pdos(node)
        assert rig.drives[0].enabled
        assert "behind the clock" in rig.control("lag")


def test_frames_that_a_bus_brings_back_are_not_taken_for_a_host_s():
    heard = []

    with (
        VirtualBus([ProfileDrive(NODE, InertiaLoad())], BusName("virtual", "echo")) as rig,
        can.Bus(interface="virtual", channel="echo") as host,
    ):
        receive = rig.bus.from_host
        rig.bus.from_host = lambda frame: heard.append(frame) or receive(frame)
        rig.bus.step(0.001)
        rig.adapter.pump()
        boot = host.recv(1.0)
        assert (boot.arbitration_id, bytes(boot.data)) == (0x700 + NODE, b"\0")
        host.send(boot)  # as udp_multicast does
        host.send(can.Message(arbitration_id=0x080, is_extended_id=False))
        rig.adapter.pump()
    assert heard == [Frame(0x080)]


def test_a_bus_that_is_lost_ends_the_service_with_one_line(monkeypatch):
    def lost(*_):
        raise can.CanOperationError("the network is down")

    with VirtualBus([ProfileDrive(NODE, InertiaLoad())], BusName("virtual", "lost")) as rig:
        monkeypatch.setattr(rig.adapter._opened, "recv", lost)
        with pytest.raises(RigError, match="--bus virtual:lost: lost: the network is down"):
            rig.server.run()
