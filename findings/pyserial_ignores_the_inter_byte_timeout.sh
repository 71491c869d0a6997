#!/usr/bin/env bash
# pyserial 3.5, Serial(inter_byte_timeout=...), on Linux.
# Guess: a read ends when no byte has come for that time after the last one, so that frames that are separated by
#   pauses, as those of Modbus RTU or of a touch controller, come one by one.
# Seen: it changes nothing. A read of 100 bytes waits for the whole timeout though the frame of 5 bytes was there at
#   once, and two frames 0.5 s apart come as one. The number goes to the driver (VMIN, VTIME), but read waits in
#   select for each next byte before it asks the driver. No warning.
# Do: read(max(1, in_waiting)) with the pause as the timeout, and end the frame when that returns nothing.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pyserial==3.5
env/bin/python - <<'PY'
import os
import pty
import threading
import time
import tty
from importlib.metadata import version

import serial

PAUSE, TIMEOUT = 0.1, 1.5  # s
device, end = pty.openpty()
tty.setraw(device)


def frame(port):
    """The bytes up to a pause, by reads that end with the first silence."""
    found = b""
    while more := port.read(max(1, port.in_waiting)):
        found += more
    return found


def two_frames():
    os.write(device, b"AB")
    time.sleep(0.5)
    os.write(device, b"CDE")


print("pyserial", version("pyserial"))
with serial.Serial(os.ttyname(end), timeout=TIMEOUT, inter_byte_timeout=PAUSE) as port:
    os.write(device, b"12345")
    begin = time.monotonic()
    one, waited = port.read(100), time.monotonic() - begin
    print(f"5 bytes are there: read returns {one} after {waited:.1f} s")
    thread = threading.Thread(target=two_frames)
    thread.start()
    both = port.read(100)
    thread.join()
    print(f"two frames 0.5 s apart: read returns {both}")
with serial.Serial(os.ttyname(end), timeout=PAUSE) as port:
    os.write(device, b"12345")
    begin = time.monotonic()
    mended, least = frame(port), time.monotonic() - begin
    print(f"with the pause as the timeout: {mended} after {least:.1f} s")
assert one == mended == b"12345" and waited > 0.99 * TIMEOUT
assert both == b"ABCDE"
PY
