#!/usr/bin/env bash
# python-can 4.6.1, the interface slcan, with an adapter that refuses a command (pyserial 3.5; on Linux).
# Guess: send() raises CanOperationError, as its page says of a frame that could not be sent, when the adapter answers
#   with BELL (7) in place of z and CR, as Lawicel's protocol has it for a full buffer or a closed channel; and the bus
#   is not opened where the adapter refuses the bit rate.
# Seen: no command waits for its answer, and recv() takes a BELL for the end of a line that it drops. With an adapter
#   that refuses everything the bus opens, reports itself active, and sends a hundred frames of which none is on the bus.
#   No warning.
# Do: look for BELL among the answers yourself (_read in a subclass), or wait for each answer of a node, as SDO does.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet python-can==4.6.1 pyserial==3.5
env/bin/python - <<'PY'
import os
import pty
import threading
import tty

import can

print("python-can", can.__version__)
adapter, port = pty.openpty()
tty.setraw(adapter)
tty.setraw(port)
commands = []


def refuse():
    """An adapter that answers each command with BELL."""
    waiting = b""
    while True:
        waiting += os.read(adapter, 1000)
        *lines, waiting = waiting.split(b"\r")
        for line in lines:
            commands.append(line)
            os.write(adapter, b"\a")


threading.Thread(target=refuse, daemon=True).start()
failed = []
with can.Bus(interface="slcan", channel=os.ttyname(port), bitrate=1_000_000, sleep_after_open=0.1) as bus:
    state = bus.state
    for number in range(100):
        try:
            bus.send(can.Message(arbitration_id=0x201, data=[number], is_extended_id=False), timeout=1)
            received = bus.recv(0.01)
        except can.CanError as error:
            failed.append(error)
    assert received is None
refused = [line for line in commands if line.startswith(b"t")]
print(f"state {state.name}; frames refused by the adapter {len(refused)}, errors raised {len(failed)}")
assert b"S8" in commands and b"O" in commands
assert state is can.BusState.ACTIVE
assert len(refused) == 100 and not failed
PY
