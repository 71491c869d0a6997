#!/usr/bin/env bash
# pymodbus 3.16.1, convert_from_registers and convert_to_registers with DATATYPE.BITS.
# Guess: element n of the list is bit n of the register, counted from the lowest, as a drive's manual numbers the bits
#   of its status word and as read_coils counts coils; registers are words of 16 bits whose bytes nobody sees.
# Seen: the list has the two bytes in the order of the wire: elements 0 to 7 are bits 8 to 15, and 8 to 15 are bits 0 to
#   7. Of the status word 0x0007 elements 8, 9 and 10 are True; [True] is written as 256. word_order="little" exchanges
#   the registers, not the bytes, so it does not help. And convert_to_registers lengthens the list that it is given. No
#   warning; 3.10 had another order, as its list of changes says.
# Do: bool(register >> n & 1), and sum(bit << n for n, bit in enumerate(bits)) to write.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pymodbus==3.16.1
env/bin/python - <<'PY'
import pymodbus
from pymodbus.client import ModbusTcpClient as Client

BITS = Client.DATATYPE.BITS
READY, ON, ENABLED = 0, 1, 2  # bits of a status word


def places(registers, **options):
    return [n for n, bit in enumerate(Client.convert_from_registers(registers, BITS, **options)) if bit]


status = 1 << READY | 1 << ON | 1 << ENABLED
print("pymodbus", pymodbus.__version__)
print(f"status word {status:#06x}: elements {places([status])} are True; as a number it is",
      Client.convert_from_registers([status], Client.DATATYPE.UINT16))
order = [places([1 << bit])[0] for bit in range(16)]
print("element of each bit:", order)
two = {word_order: places([0x0001, 0x0000], word_order=word_order) for word_order in ("big", "little")}
print("bit 0 of the first of two registers, by word_order:", two)
command = [True]
written = Client.convert_to_registers(command, BITS)
print(f"[True] is written as {written}; the list given has {len(command)} elements after")
assert Client.convert_from_registers([status], Client.DATATYPE.UINT16) == status
assert places([status]) == [8, 9, 10]
assert order == [*range(8, 16), *range(8)]
assert two == {"big": [8], "little": [24]}
assert written == [256] and len(command) == 16
PY
