#!/usr/bin/env bash
# canmatrix 1.3.3, canconvert from .dbc to .xlsx or .xls and back (cantools 45.1.0 decodes).
# Guess: the table that canconvert writes and reads has all that decoding needs: a DBC comes back with the same
#   signals, perhaps without comments and attributes.
# Seen: neither table has a column for the sign, and every signal comes back unsigned: a torque of -7 decodes as
#   65529. From .xlsx the minimum comes back as the offset, too: an angle of 1.5 deg with limits of -300 and 300 is
#   -298.5. The limits are right in the .xlsx, and no warning names the signals.
# Do: write the table with --additionalSignalAttributes is_signed,offset,factor,min,max; both then decode as the DBC.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet "canmatrix[xls,xlsx]==1.3.3" cantools==45.1.0 openpyxl==3.1.5 xlrd==1.2.0 xlwt==1.3.0
cat > rig.dbc <<'DBC'
VERSION ""

NS_ :

BS_:

BU_: Drive Host

BO_ 641 Plate: 8 Drive
 SG_ angle : 0|16@1- (0.01,0) [-300|300] "deg" Host
 SG_ torque : 16|16@1- (1,0) [0|0] "mNm" Host
 SG_ voltage : 32|16@1+ (0.001,0) [0|60] "V" Host
DBC
columns=is_signed,offset,factor,min,max
for kind in xlsx xls; do
  env/bin/canconvert rig.dbc "rig.$kind" 2> /dev/null
  env/bin/canconvert "rig.$kind" "$kind.dbc" 2>> said.txt
  env/bin/canconvert --additionalSignalAttributes "$columns" rig.dbc "full.$kind" 2> /dev/null
  env/bin/canconvert "full.$kind" "full_$kind.dbc" 2> /dev/null
done
env/bin/python - <<'PY'
import struct
from importlib.metadata import version
from pathlib import Path

import cantools

data = struct.pack("<hhHxx", 150, -7, 12000)


def decode(name):
    message = cantools.database.load_file(name).get_message_by_frame_id(641)
    found = {signal: round(value, 6) for signal, value in message.decode(data).items()}
    print(f"{name:13}", found)
    return found


print("canmatrix", version("canmatrix"), "cantools", version("cantools"))
right = {"angle": 1.5, "torque": -7, "voltage": 12}
assert decode("rig.dbc") == right
assert decode("xlsx.dbc") == right | {"angle": 1.5 - 300, "torque": 2**16 - 7}
assert decode("xls.dbc") == right | {"torque": 2**16 - 7}
assert decode("full_xlsx.dbc") == decode("full_xls.dbc") == right
assert not any(name in Path("said.txt").read_text() for name in right)
PY
