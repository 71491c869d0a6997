#!/usr/bin/env bash
# canopen 2.4.1, BaseNode402.homing.
# Guess: each call homes the drive: a rising edge of bit 4 of the control word starts homing (CiA 402-2).
# Seen: bit 4 is left set. A second call has no rising edge, so the drive does nothing, reports what the first
#   call attained, and homing returns True.
# Do: node.controlword = 0x0F before each call after the first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet canopen==2.4.1 python-can==4.6.1
env/bin/python - <<'PY'
import logging

import canopen
from canopen.objectdictionary import ObjectDictionary, ODVariable
from canopen.profiles.p402 import BaseNode402

logging.disable()
ENABLED, ATTAINED, START = 0x0627, 0x1000, 1 << 4
HOMING, SUPPORTED = 6, 1 << 5
U32, I8, U16 = 7, 2, 6

objects = ObjectDictionary()
for index, kind, value in (
    (0x6040, U16, 0), (0x6041, U16, ENABLED), (0x6060, I8, 0), (0x6061, I8, HOMING),
    (0x6502, U32, SUPPORTED),
):
    variable = ODVariable(f"{index:04X}", index)
    variable.data_type, variable.access_type, variable.default = kind, "rw", value
    objects.add_object(variable)

host, device = canopen.Network(), canopen.Network()
for network in (host, device):
    network.connect(interface="virtual", channel="bus")
drive = device.create_node(1, objects)
words, homed = [0], []


def obey(index, data, **_):
    """Home at once on a rising edge of bit 4, as method 37 does."""
    if index == 0x6040:
        word = int.from_bytes(data, "little")
        if word & ~words[-1] & START:
            homed.append(word)
            drive.sdo[0x6041].raw = ENABLED | ATTAINED
        words.append(word)


drive.add_write_callback(obey)
node = host.add_node(BaseNode402(1, objects))
print("canopen", canopen.__version__)
results = [node.homing(timeout=2) for _ in range(2)]
print("returned", results, "- the drive has homed", len(homed), "time(s)")
assert results == [True, True]
assert len(homed) == 1
node.controlword = 0x0F
assert node.homing(timeout=2)
assert len(homed) == 2
for network in (host, device):
    network.disconnect()
PY
