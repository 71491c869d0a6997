#!/usr/bin/env bash
# python-can 4.6.1, TRCWriter and TRCReader (BLF and ASC of the same package for comparison).
# Guess: channel 1 is bus 1 of the file, and comes back as channel 1, as from .blf and .asc, which count from 1 in
#   the file, too.
# Seen: the writer adds 1, as .blf and .asc do, but the reader does not subtract it. Channel 1 is bus 2 in PCAN-View, and
#   comes back as 2; each copy of the trace counts up once more. A frame of Vector's channel 1, converted for PEAK's
#   tools, so is on another bus, and rules by channel find nothing. No warning.
# Do: give the writer channels that are 1 smaller, or subtract 1 from what the reader returns.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet python-can==4.6.1
env/bin/python - <<'PY'
from pathlib import Path

import can

print("python-can", can.__version__)


def copy(frames, name):
    """The channels of the frames after they were written and read."""
    with can.Logger(name) as log:
        for frame in frames:
            log(frame)
    with can.LogReader(name) as frames:
        return list(frames)


first = [
    can.Message(timestamp=1.7e9 + channel, arbitration_id=0x181, data=[1], is_extended_id=False, channel=channel)
    for channel in (1, 2)
]
found = {}
for ending in ("blf", "asc", "trc"):
    frames, found[ending] = first, []
    for number in range(3):
        frames = copy(frames, f"{number}.{ending}")
        found[ending].append([frame.channel for frame in frames])
    print(f"channels 1, 2 after 1, 2 and 3 copies as .{ending}: {found[ending]}")
rows = [line.split() for line in Path("0.trc").read_text().splitlines() if not line.startswith(";")]
print("buses in the first .trc:", [row[3] for row in rows])
assert found["blf"] == found["asc"] == [[1, 2]] * 3
assert [row[3] for row in rows] == ["2", "3"]
assert found["trc"] == [[2, 3], [3, 4], [4, 5]]
PY
