#!/usr/bin/env bash
# feetech-servo-sdk 1.0.0 (scservo_sdk), PacketHandler(protocol_end), on Linux.
# Guess: each handler has the byte order that it was made with, 0 for servos of the STS and SMS series, 1 for those of
#   the SCS series, so that one bus, or one process, may have both.
# Seen: the byte order is one variable of the module. The handler that is made last sets it for all: after a handler for
#   an SCS servo was made, the goal of 1000 steps for an STS servo is sent as 59395, which that servo takes for -26627,
#   and the speed of 50 as 12800. Reading is changed alike: a position of 1000 is returned as 59395. No error.
# Do: call PacketHandler with the byte order of the servo before each access, or a process for each series.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet feetech-servo-sdk==1.0.0 pyserial==3.5
env/bin/python - <<'PY'
import os
import tty
from importlib.metadata import version

from scservo_sdk import COMM_SUCCESS, PacketHandler, PortHandler

STS, SCS = 0, 1  # byte orders: the low byte first, the high byte first
SERVO, GOAL, SPEED, PRESENT = 1, 42, 46, 56  # id and registers of an STS servo
wire, end = os.openpty()
tty.setraw(wire)
port = PortHandler(os.ttyname(end))
assert port.openPort()


def sent(handler, register, value):
    """What an STS servo, low byte first, takes from the frame: FF FF id length instruction register low high sum."""
    port.is_using = False
    assert handler.write2ByteTxOnly(port, SERVO, register, value) == COMM_SUCCESS
    frame = os.read(wire, 100)
    assert frame[:6] == bytes([255, 255, SERVO, 5, 3, register]) and len(frame) == 9
    return int.from_bytes(frame[6:8], "little")


def received(handler, value):
    """What the handler returns for a position that an STS servo answers with."""
    port.is_using = False
    assert handler.read2ByteTx(port, SERVO, PRESENT) == COMM_SUCCESS
    os.read(wire, 100)
    body = bytes([SERVO, 4, 0, *value.to_bytes(2, "little")])
    os.write(wire, b"\xff\xff" + body + bytes([~sum(body) & 0xFF]))
    position, result, error = handler.read2ByteRx(port, SERVO)
    assert (result, error) == (COMM_SUCCESS, 0)
    return position


print("feetech-servo-sdk", version("feetech-servo-sdk"))
handler = PacketHandler(STS)
alone = sent(handler, GOAL, 1000), sent(handler, SPEED, 50), received(handler, 1000)
other = PacketHandler(SCS)
after = sent(handler, GOAL, 1000), sent(handler, SPEED, 50), received(handler, 1000)
signed = -(after[0] & 0x7FFF) if after[0] & 0x8000 else after[0]
print("alone: goal, speed and position", alone)
print("with a handler for SCS:         ", after, "; the goal with its sign in bit 15:", signed)
PacketHandler(STS)
again = sent(handler, GOAL, 1000)
print("after PacketHandler(STS): goal  ", again)
assert alone == (1000, 50, 1000) and again == 1000
assert after == (59395, 12800, 59395) and signed == -26627
PY
