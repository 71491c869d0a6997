#!/usr/bin/env bash
# canopen 2.4.1, a DCF with CompactSubObj, and RemoteNode.load_configuration.
# Guess: values of an array that the DCF describes at once (CiA 306: CompactSubObj in [1016], the values in
#   [1016Value], as Lely's dcfgen writes them) are loaded and written to the device, as ParameterValue is.
# Seen: [1016Value] is left out: the members have no value, and load_configuration writes none of them. A drive
#   is configured without the heartbeat watch that the file asks for. No warning.
# Do: expand the array to [1016sub0], [1016sub1], ... with ParameterValue, or write these objects yourself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet canopen==2.4.1 python-can==4.6.1
cat > compact.dcf <<'DCF'
[FileInfo]
FileName=compact.dcf
FileVersion=1
FileRevision=1
EDSVersion=4.0

[DeviceInfo]
VendorName=any
ProductName=drive

[DeviceComissioning]
NodeID=5

[MandatoryObjects]
SupportedObjects=0

[OptionalObjects]
SupportedObjects=2
1=0x1016
2=0x1017

[1016]
ParameterName=Consumer heartbeat time
ObjectType=0x8
DataType=0x0007
AccessType=rw
DefaultValue=0
PDOMapping=0
CompactSubObj=2

[1016Value]
NrOfEntries=1
1=0x007F00C8

[1017]
ParameterName=Producer heartbeat time
ObjectType=0x7
DataType=0x0006
AccessType=rw
DefaultValue=0
ParameterValue=100
PDOMapping=0
DCF
env/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import canopen

compact = Path("compact.dcf").read_text()
start, end = compact.index("[1016]"), compact.index("[1017]")
members = """[1016]
ParameterName=Consumer heartbeat time
ObjectType=0x8
SubNumber=2

[1016sub0]
ParameterName=Number of entries
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=1
PDOMapping=0

[1016sub1]
ParameterName=First
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0
ParameterValue=0x007F00C8
PDOMapping=0

"""
Path("expanded.dcf").write_text(compact[:start] + members + compact[end:])


def written_by(name):
    """Objects that load_configuration writes to a drive, with their values."""
    written = {}
    host, bus = canopen.Network(), canopen.Network()
    host.connect(interface="virtual", channel=name)
    bus.connect(interface="virtual", channel=name)
    drive = bus.create_node(5, name)
    drive.add_write_callback(
        lambda index, subindex, od, data: written.update({(index, subindex): int.from_bytes(data, "little")})
    )
    host.add_node(5, name).load_configuration()
    host.disconnect()
    bus.disconnect()
    return {f"{index:04X}h:{subindex}": value for (index, subindex), value in written.items()}


print("canopen", version("canopen"))
print("compact: ", canopen.import_od("compact.dcf")[0x1016][1].value, written_by("compact.dcf"))
print("expanded:", canopen.import_od("expanded.dcf")[0x1016][1].value, written_by("expanded.dcf"))
assert canopen.import_od("compact.dcf")[0x1016][1].value is None
assert written_by("compact.dcf") == {"1017h:0": 100}
assert written_by("expanded.dcf") == {"1016h:1": 0x007F00C8, "1017h:0": 100}
PY
