#!/usr/bin/env bash
# python-can 4.6.1, ASCReader.
# Guess: classic frames that Vector's tools log on a channel of CAN FD, in lines with CANFD and without bit
#   12 (EDL) in the flags, come back as classic frames; one without data, as CANopen's SYNC, as a data frame.
# Seen: all come back as frames of CAN FD, and one without data as a remote frame. A frame of CAN FD without
#   data is a remote frame, too, when python-can's own writer wrote it.
# Do: test bit 12 of the flags for CAN FD and bit 4 for a remote frame, not the length.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet python-can==4.6.1
cat > classic.asc <<'ASC'
date Mon Nov 13 10:13:20.000 pm 2023
base hex  timestamps absolute
no internal events logged
   0.010000 CANFD   1 Rx         80                                  0 0 0  0    56000   47   200000 0 0 0 0 0
   0.010500 CANFD   1 Rx        181                                  0 0 1  1 05 64000   55   200000 0 0 0 0 0
ASC
env/bin/python - <<'PY'
import can

with can.LogReader("classic.asc") as reader:
    sync, data = reader
message = can.Message(timestamp=1.0, arbitration_id=0x80, is_extended_id=False, is_fd=True)
with can.Logger("own.asc") as writer:
    writer(message)
with can.LogReader("own.asc") as reader:
    (own,) = reader
print("python-can", can.__version__)
for name, each in {"SYNC": sync, "one byte": data, "own CAN FD frame without data": own}.items():
    print(f"{name}: CAN FD {each.is_fd}, remote {each.is_remote_frame}, {len(each.data)} bytes")
assert sync.is_fd and sync.is_remote_frame
assert data.is_fd and not data.is_remote_frame
assert own.is_remote_frame and not message.is_remote_frame
PY
