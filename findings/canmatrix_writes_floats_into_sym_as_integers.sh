#!/usr/bin/env bash
# canmatrix 1.3.3, canconvert from .dbc to PEAK's .sym (cantools 45.1.0 for comparison).
# Guess: a signal of IEEE 754 (SIG_VALTYPE_ 1 or 2) becomes a variable of the type float or double, which .sym
#   has and canmatrix reads.
# Seen: it becomes `signed`, as a DBC marks floats as signed, and that is asked first. An angle of 1.5 rad then
#   decodes as 1069547520. No warning.
# Do: write the .sym with cantools, or correct the type of each such line.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet canmatrix==1.3.3 cantools==45.1.0
cat > rig.dbc <<'DBC'
VERSION ""

NS_ :
	SIG_VALTYPE_

BS_:

BU_: Drive Host

BO_ 641 Plate: 8 Drive
 SG_ Angle : 0|32@1- (1,0) [-3.5|3.5] "rad" Host
 SG_ Counts : 32|32@1- (1,0) [-2147483648|2147483647] "" Host

SIG_VALTYPE_ 641 Angle : 1;
DBC
env/bin/canconvert rig.dbc rig.sym 2> /dev/null
env/bin/python - <<'PY'
import struct
from importlib.metadata import version

import canmatrix.formats
import cantools

data = struct.pack("<fi", 1.5, -7)
frame = canmatrix.ArbitrationId(641, extended=False)


def decode(name):
    (database,) = canmatrix.formats.loadp(name).values()
    return {name: float(signal.phys_value) for name, signal in database.decode(frame, data).items()}


database = cantools.database.load_file("rig.dbc")
cantools.database.dump_file(database, "cantools.sym")
by_cantools = cantools.database.load_file("cantools.sym").decode_message(641, data)
print("canmatrix", version("canmatrix"), "cantools", version("cantools"))
print([line.strip() for line in open("rig.sym") if line.startswith("Var=")])
print("from the .dbc:", decode("rig.dbc"))
print("from the .sym:", decode("rig.sym"))
print("from cantools' .sym:", by_cantools)
assert decode("rig.dbc") == {"Angle": 1.5, "Counts": -7}
assert decode("rig.sym") == {"Angle": 1069547520, "Counts": -7}
assert by_cantools == {"Angle": 1.5, "Counts": -7}
PY
