#!/usr/bin/env bash
# minimalmodbus 2.1.1, Instrument.write_register with number_of_decimals (pyserial 3.5).
# Guess: value=0.29 with number_of_decimals=2 is written as 29, as the manual has 77.0 with 1 written as 770.
# Seen: 28: the product 28.999999999999996 is cut, not rounded. With 2 decimals 4586 of the 65536 values of a
#   register come out one too low, with 3 decimals 741, with 4 decimals 4576, with 1 decimal none.
# Do: write_register(address, round(value * 100)), without number_of_decimals.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet minimalmodbus==2.1.1 pyserial==3.5
env/bin/python - <<'PY'
from importlib.metadata import version

import minimalmodbus
from serial.urlhandler.protocol_loop import Serial


class Device(Serial):
    """A device that confirms each write of one register, as Modbus does: by the request itself."""

    sent = b""

    def write(self, data):
        self.sent = bytes(data)
        return super().write(data)


device = Device("loop://", baudrate=115200, timeout=1)
instrument = minimalmodbus.Instrument(device, 1)


def written(value, decimals):
    instrument.write_register(0, value, number_of_decimals=decimals, functioncode=6)
    return int.from_bytes(device.sent[4:6], "big")


low = [k for k in range(1001) if written(k / 100, 2) != k]
print("minimalmodbus", version("minimalmodbus"))
print(f"0.29 is written as {written(0.29, 2)}, 1.13 as {written(1.13, 2)}, 77.0 as {written(77.0, 1)}")
print(f"0 to 10 in hundredths: {len(low)} of 1001 are not what was asked for")
wrong = [sum(int(float(k / 10**n) * 10**n) != k for k in range(65536)) for n in (1, 2, 3, 4)]
print("of all registers, cut in the same way:", wrong)
assert written(77.0, 1) == 770 and written(0.29, 2) == 28 and written(1.13, 2) == 112
assert len(low) == 69 and all(written(k / 100, 2) == k - 1 for k in low)
assert wrong == [0, 4586, 741, 4576]
PY
