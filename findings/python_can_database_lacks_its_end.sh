#!/usr/bin/env bash
# python-can 4.6.1, SqliteWriter.
# Guess: stop() writes all remaining messages to the database, as its docstring says.
# Seen: its thread ends after the batch under way. Of 16,000 frames that are written without a pause, some
#   hundred are in the database, without a word.
# Do: wait until the rows are there before stop(), or write another format. A reader cannot see it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet python-can==4.6.1
env/bin/python - <<'PY'
import can

COUNT = 16_000
writer = can.SqliteWriter("trace.db")
for k in range(COUNT):
    writer(can.Message(timestamp=1.0 + 1e-3 * k, arbitration_id=0x181, data=b"\x01"))
writer.stop()
with can.SqliteReader("trace.db") as reader:
    kept = sum(1 for _ in reader)
print("python-can", can.__version__)
print(f"{kept} of {COUNT} frames are in the database after stop()")
assert 0 < kept < COUNT
PY
