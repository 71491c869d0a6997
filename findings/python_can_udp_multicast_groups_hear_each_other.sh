#!/usr/bin/env bash
# python-can 4.6.1, udp_multicast, on Linux.
# Guess: two channels are two buses, as their addresses are two multicast groups; and a bus does not hear what
#   it sends, as receive_own_messages is False.
# Seen: both groups of the default port hear each other's frames on one computer (the socket is bound to every
#   address), and each bus hears its own.
# Do: give each bus a port of its own, and drop frames that were just sent.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet 'python-can[multicast]==4.6.1'
env/bin/python - <<'PY'
import can

GROUPS = "239.74.163.2", "239.74.163.3"
FRAME = can.Message(arbitration_id=0x123, is_extended_id=False)


def heard(ports):
    """Which of two buses hear a frame of the first."""
    first, second = (
        can.Bus(interface="udp_multicast", channel=group, port=port)
        for group, port in zip(GROUPS, ports)
    )
    with first, second:
        first.send(FRAME)
        return tuple(bus.recv(0.5) is not None for bus in (first, second))


print("python-can", can.__version__)
same, apart = heard((43555, 43555)), heard((43556, 43557))
print("same port:   own frame heard", same[0], "- the other group's heard", same[1])
print("other ports: own frame heard", apart[0], "- the other group's heard", apart[1])
assert same == (True, True)
assert apart == (True, False)
PY
