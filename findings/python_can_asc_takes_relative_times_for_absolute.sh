#!/usr/bin/env bash
# python-can 4.6.1, ASCReader.
# Guess: a Vector .asc whose header says `timestamps relative` gives the times since the start: in such
#   a file each time counts from the event before it.
# Seen: both words of the header are read as absolute. Three frames 10 ms apart all lie at 0.01 s.
# Do: add the times of all lines up, those of statistics and other events as well.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet python-can==4.6.1
cat > relative.asc <<'ASC'
date Mon Nov 13 10:13:20.000 pm 2023
base hex  timestamps relative
no internal events logged
   0.010000 1  181             Rx   d 1 01
   0.010000 1  181             Rx   d 1 02
   0.010000 1  181             Rx   d 1 03
ASC
env/bin/python - <<'PY'
import can

with can.LogReader("relative.asc") as reader:
    times = [message.timestamp for message in reader]
print("python-can", can.__version__)
print("times read   ", times)
print("by the format [0.01, 0.02, 0.03]")
assert times == [0.01, 0.01, 0.01]
PY
