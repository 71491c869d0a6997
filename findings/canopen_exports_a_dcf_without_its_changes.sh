#!/usr/bin/env bash
# canopen 2.4.1, import_od and export_od.
# Guess: to change a setting in a DCF, load it, set `value` of the object, and export it; in an EDS `default`.
# Seen: the file has the old number. What the import read is kept as text (value_raw, default_raw), and the
#   export prefers that to `value` and `default`. Objects that had no ParameterValue get the new one, so a
#   file may have half of the changes. No warning.
# Do: set value_raw (default_raw) to None with each change, and load what was exported.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet canopen==2.4.1
cat > drive.dcf <<'DCF'
[FileInfo]
FileName=drive.dcf
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
1=0x1017
2=0x6065

[1017]
ParameterName=Producer heartbeat time
ObjectType=0x7
DataType=0x0006
AccessType=rw
DefaultValue=0
ParameterValue=1000
PDOMapping=0

[6065]
ParameterName=Following error window
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=2000
PDOMapping=0
DCF
env/bin/python -W ignore - <<'PY'
from importlib.metadata import version

from canopen import export_od, import_od

settings = import_od("drive.dcf")
settings[0x1017].value = 100
settings[0x1017].default = 50
settings[0x6065].value = 500
export_od(settings, "changed.dcf")
changed = import_od("changed.dcf")
settings[0x1017].value_raw = settings[0x1017].default_raw = None
export_od(settings, "again.dcf")
again = import_od("again.dcf")
print("canopen", version("canopen"))
for name, found in {"changed": changed, "value_raw None": again}.items():
    heartbeat, window = found[0x1017], found[0x6065]
    print(f"{name}: 1017h {heartbeat.value}, default {heartbeat.default}; 6065h {window.value}")
assert (changed[0x1017].value, changed[0x1017].default, changed[0x6065].value) == (1000, 0, 500)
assert (again[0x1017].value, again[0x1017].default, again[0x6065].value) == (100, 50, 500)
PY
