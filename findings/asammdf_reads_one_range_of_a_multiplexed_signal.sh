#!/usr/bin/env bash
# asammdf 8.8.28, MDF.extract_bus_logging with a DBC of extended multiplexing (canmatrix 1.2 reads the DBC; a
#   trace of python-can 4.6.1; cantools 45.1.0 for comparison).
# Guess: a signal that SG_MUL_VAL_ gives several ranges of the multiplexer is found in the frames of all of them.
# Seen: only the first range counts: with `0-0, 5-6` the frames of 5 and 6 have no sample. cantools and
#   canmatrix alone decode them all. No warning.
# Do: decode the frames with cantools, or give each range a signal of its own.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet asammdf==8.8.28 canmatrix==1.2 python-can==4.6.1 cantools==45.1.0
cat > drive.dbc <<'DBC'
VERSION ""

NS_ :
	SG_MUL_VAL_

BS_:

BU_: Drive Host

BO_ 513 Readings: 8 Drive
 SG_ Kind M : 0|8@1+ (1,0) [0|255] "" Host
 SG_ Current m0 : 8|16@1- (0.1,0) [-3276.8|3276.7] "A" Host
 SG_ Voltage m1 : 8|16@1+ (1,0) [0|65535] "V" Host

SG_MUL_VAL_ 513 Current Kind 0-0, 5-6;
SG_MUL_VAL_ 513 Voltage Kind 1-1;
DBC
env/bin/python -W ignore - <<'PY'
import time
from importlib.metadata import version

import can
import cantools
from asammdf import MDF

START = time.time()
frames = [(0, 10), (5, 20), (6, 30), (1, 48)]
database = cantools.database.load_file("drive.dbc")
decoded = []
with can.MF4Writer("trace.mf4") as writer:
    for k, (kind, number) in enumerate(frames):
        data = bytes([kind]) + number.to_bytes(2, "little") + bytes(5)
        decoded.append(database.decode_message(513, data))
        writer(can.Message(timestamp=START + 0.01 * k, arbitration_id=513, is_extended_id=False, data=data))
found = MDF("trace.mf4").extract_bus_logging({"CAN": [("drive.dbc", 0)]})
currents = [round(each["Current"], 6) for each in decoded if "Current" in each]
print("asammdf", version("asammdf"), "canmatrix", version("canmatrix"))
for name in ("Kind", "Current", "Voltage"):
    print(f"{name}: {found.get(name).samples.tolist()}")
print("Current by cantools:", currents)
assert currents == [1.0, 2.0, 3.0]
assert found.get("Kind").samples.tolist() == [0, 5, 6, 1]
assert found.get("Current").samples.tolist() == [1.0]
assert found.get("Voltage").samples.tolist() == [48]
PY
