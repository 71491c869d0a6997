#!/usr/bin/env bash
# dynamixel-sdk 4.1.0 (Python), protocol 2.0, on Linux.
# Guess: parameters that contain the bytes FF FF FD, with which a packet begins, are sent as FF FF FD FD and the length
#   grows by one, as the protocol says (byte stuffing); the package has a function that does so.
# Seen: that function returns the stuffed packet as a new list and the caller goes on with the old one, so the bytes are
#   sent as they are, with a length and a CRC that match them. A servo finds a header in the middle of a packet. It
#   meets the position -131073, and in a sync write of goal current and goal velocity each pair of -1 and a velocity
#   with the low byte FD, such as -3: one velocity in 256. A write without a reply, as sync write, returns success.
# Do: in a subclass of Protocol2PacketHandler let addStuffing do packet[:] = super().addStuffing(packet), as below.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet dynamixel-sdk==4.1.0 pyserial==3.5
env/bin/python - <<'PY'
import os
import pty
import tty
from importlib.metadata import version

import dynamixel_sdk as sdk

HEADER, WRITE, SYNC_WRITE, ALL = b"\xff\xff\xfd", 0x03, 0x83, 0xFE
GOAL_CURRENT, GOAL_POSITION = 102, 116  # addresses in the control table of the X series

wire, device = pty.openpty()
tty.setraw(wire)
port = sdk.PortHandler(os.ttyname(device))
assert port.openPort()


class Mended(sdk.Protocol2PacketHandler):
    def addStuffing(self, packet):
        packet[:] = super().addStuffing(packet)
        return packet


def little(value, size):
    return value.to_bytes(size, "little", signed=True)


def crc(data):
    """CRC of protocol 2.0: polynomial 8005h, start 0."""
    rest = 0
    for byte in data:
        rest ^= byte << 8
        for _ in range(8):
            rest = (rest << 1 ^ (0x8005 if rest & 0x8000 else 0)) & 0xFFFF
    return rest


def packet(servo, body):
    """Packet around instruction and parameters as they are."""
    whole = HEADER + bytes([0, servo]) + (len(body) + 2).to_bytes(2, "little") + body
    return whole + crc(whole).to_bytes(2, "little")


def write_position(handler, position):
    """Goal position of servo 1 by the SDK; the ID and the body of its packet before stuffing."""
    assert handler.write4ByteTxOnly(port, 1, GOAL_POSITION, position) == sdk.COMM_SUCCESS
    return 1, bytes([WRITE, GOAL_POSITION, 0]) + little(position, 4)


def write_both(handler, current, velocity):
    """Goal current and goal velocity of servo 1 in a sync write."""
    group = sdk.GroupSyncWrite(port, handler, GOAL_CURRENT, 6)
    data = little(current, 2) + little(velocity, 4)
    assert group.addParam(1, list(data)) and group.txPacket() == sdk.COMM_SUCCESS
    return ALL, bytes([SYNC_WRITE, GOAL_CURRENT, 0, 6, 0, 1]) + data


print("dynamixel-sdk", version("dynamixel-sdk"))
unstuffed = {}
for name, write, values in (
    ("position 1000", write_position, (1000,)),
    ("position -131073", write_position, (-131073,)),
    ("current -2, velocity -3", write_both, (-2, -3)),
    ("current -1, velocity -3", write_both, (-1, -3)),
):
    servo, body = write(sdk.PacketHandler(2.0), *values)
    sent = os.read(wire, 100)
    write(Mended(), *values)
    mended = os.read(wire, 100)
    right = packet(servo, body.replace(HEADER, HEADER + b"\xfd"))
    unstuffed[name] = sent != right
    print(f"{name}: sent {sent.hex(' ')}, by the protocol {'the same' if sent == right else right.hex(' ')}")
    assert sent == packet(servo, body) and mended == right
port.closePort()
assert list(unstuffed.values()) == [False, True, False, True]
PY
