#!/usr/bin/env bash
# canmatrix 1.3.3, canconvert from .eds to .dbc (canopen 2.4.1 reads the EDS, cantools 45.1.0 the DBC).
# Guess: an object of a PDO becomes a signal with the object's type, factor 1 and offset 0. LowLimit and
#   HighLimit of CiA 306 bound the value, as the minimum and maximum of a signal do.
# Seen: the offset of the signal is LowLimit, too. Torque of 10 with limits of -3000 and 3000 decodes as -2990,
#   mode 8 with limits of -128 and 127 as -120. Signals without limits are right. No warning.
# Do: set the offset of every signal of the PDOs to 0, or remove the limits from the EDS before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet canmatrix==1.3.3 canopen==2.4.1 cantools==45.1.0
cat > drive.eds <<'EDS'
[FileInfo]
FileName=drive.eds
FileVersion=1
FileRevision=1
EDSVersion=4.0

[DeviceInfo]
VendorName=any
ProductName=drive
NrOfRXPDO=0
NrOfTXPDO=1

[MandatoryObjects]
SupportedObjects=1
1=0x1000

[OptionalObjects]
SupportedObjects=5
1=0x1800
2=0x1A00
3=0x6041
4=0x6061
5=0x6077

[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x00020192
PDOMapping=0

[1800]
ParameterName=TPDO 1
ObjectType=0x9
SubNumber=3

[1800sub0]
ParameterName=Highest sub-index
ObjectType=0x7
DataType=0x0005
AccessType=const
DefaultValue=2
PDOMapping=0

[1800sub1]
ParameterName=COB-ID
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x180
PDOMapping=0

[1800sub2]
ParameterName=Transmission type
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=1
PDOMapping=0

[1A00]
ParameterName=TPDO 1 mapping
ObjectType=0x9
SubNumber=4

[1A00sub0]
ParameterName=Number of objects
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=3
PDOMapping=0

[1A00sub1]
ParameterName=First object
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x60410010
PDOMapping=0

[1A00sub2]
ParameterName=Second object
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x60610008
PDOMapping=0

[1A00sub3]
ParameterName=Third object
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x60770010
PDOMapping=0

[6041]
ParameterName=Statusword
ObjectType=0x7
DataType=0x0006
AccessType=ro
PDOMapping=1

[6061]
ParameterName=Modes of operation display
ObjectType=0x7
DataType=0x0002
AccessType=ro
LowLimit=-128
HighLimit=127
PDOMapping=1

[6077]
ParameterName=Torque actual value
ObjectType=0x7
DataType=0x0003
AccessType=ro
LowLimit=-3000
HighLimit=3000
PDOMapping=1
EDS
env/bin/canconvert drive.eds drive.dbc 2> /dev/null
env/bin/python - <<'PY'
from importlib.metadata import version

import cantools

message = cantools.database.load_file("drive.dbc", strict=False).get_message_by_name("TPDO_1")
data = (0x0237).to_bytes(2, "little") + bytes([8]) + (10).to_bytes(2, "little", signed=True)
decoded = message.decode(data)
print("canmatrix", version("canmatrix"), "canopen", version("canopen"))
for signal in message.signals:
    print(f"{signal.name}: offset {signal.offset}, decoded {decoded[signal.name]}")
assert decoded["Statusword"] == 0x0237
assert decoded["Modes_of_operation_display"] == 8 - 128
assert decoded["Torque_actual_value"] == 10 - 3000
PY
