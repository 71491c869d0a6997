#!/usr/bin/env bash
# canopen 2.4.1, BaseNode402 (its issue 396).
# Guess: a status word in a PDO of transmission type 255, which a drive sends when it changes, is known not to
#   be periodic, so that check_statusword reads it by SDO.
# Seen: from its second reception on, however long after the first, is_periodic is True: check_statusword waits
#   0.2 s for a PDO and raises RuntimeError, where the drive has nothing new to send. A command PDO that comes
#   back, as over udp_multicast, is taken for periodic, too, and controlword sends nothing any more.
# Do: use transmission types 1 to 240 with a SYNC, or an event timer, and no bus that echoes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet canopen==2.4.1 python-can==4.6.1
env/bin/python - <<'PY'
import logging
import time

import canopen
from canopen.objectdictionary import ObjectDictionary, ODRecord, ODVariable
from canopen.profiles.p402 import BaseNode402

logging.disable()
COB_ID, STATUS = 0x181, b"\x21\x00"
U8, U16, U32 = 5, 6, 7


def entry(index, sub, kind, default):
    """A variable of the object dictionary."""
    made = ODVariable(f"{index:04X}sub{sub}", index, sub)
    made.data_type, made.access_type, made.default = kind, "rw", default
    return made


objects = ObjectDictionary()
for index in (0x6040, 0x6041, 0x6060, 0x6061):
    objects.add_object(entry(index, 0, U16, 0x21))
for index, values in ((0x1800, (2, COB_ID, 255)), (0x1A00, (1, 0x60410010))):
    record = ODRecord(f"{index:04X}", index)
    for sub, (kind, value) in enumerate(zip((U8, U32, U8), values)):
        record.add_member(entry(index, sub, kind, value))
    objects.add_object(record)

host, device = canopen.Network(), canopen.Network()
for network in (host, device):
    network.connect(interface="virtual", channel="bus")
device.create_node(1, objects)
node = host.add_node(BaseNode402(1, objects))
node.tpdo[1].read(from_od=True)
node.setup_pdos(upload=False)
print("canopen", canopen.__version__, "- transmission type", node.tpdo[1].trans_type)
found = []
for _ in range(2):
    device.send_message(COB_ID, STATUS)
    time.sleep(0.3)
    found.append(node.tpdo[1].is_periodic)
    print("received; is_periodic:", found[-1])
assert found == [False, True]
try:
    node.check_statusword()
except RuntimeError as error:
    print("check_statusword:", error)
else:
    raise SystemExit("no error")
for network in (host, device):
    network.disconnect()
PY
