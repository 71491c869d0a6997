#!/usr/bin/env bash
# python-can 4.6.1, CanutilsLogReader and CanutilsLogWriter.
# Guess: an error frame of SocketCAN in the log of candump -L comes back as one, with its class: 20000040h
#   is bus-off.
# Seen: the reader takes it for a data frame with an extended identifier; those with bit 7 (bus error) come
#   back without identifier, data and channel. The writer writes every error frame as a bus error, 20000080h.
# Do: test bit 29 of the identifier in the text, and write error frames yourself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet python-can==4.6.1
printf '(1.0) can0 20000040#0000000000000000\n(1.1) can0 20000088#0000000000000000\n' > read.log
env/bin/python - <<'PY'
from pathlib import Path

import can

with can.LogReader("read.log") as reader:
    off, error = reader
writer = can.CanutilsLogWriter("written.log", channel="can0")
writer(can.Message(timestamp=1.0, arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
writer.stop()
line = Path("written.log").read_text().strip()
print("python-can", can.__version__)
print(f"bus-off read: error frame {off.is_error_frame}, extended identifier {off.is_extended_id}")
print(f"bus error read: error frame {error.is_error_frame}, channel {error.channel}")
print(f"bus-off written: {line}")
assert not off.is_error_frame and off.is_extended_id
assert error.is_error_frame and error.channel is None
assert "20000080#" in line
PY
