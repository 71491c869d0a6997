#!/usr/bin/env bash
# canopen 2.4.1, PdoVariable.raw of objects in a PDO that maps single bits.
# Guess: objects follow one another without gaps (CiA 301), so that a torque of 16 bits that is mapped after a BOOLEAN
#   of 1 bit takes bits 1 to 16, and raw reads and writes it there: add_variable takes lengths in bits.
# Seen: only the 16 bits from the byte on in which the value begins are read and written. The highest bit, the sign, is
#   lost: a torque of 20000 reads as -12768, and -20000 as 12768; 20000 raises struct.error when it is written, and
#   -100 is sent as 32668. Of a field of 4 bits, -8 reads as 8 in any place. No warning.
# Do: map objects of whole bytes first and bits last; a field of 4 bits that reads 8 is -8.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet canopen==2.4.1
env/bin/python - <<'PY'
import struct
from importlib.metadata import version

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable, ObjectDictionary, datatypes

MAPPED = (("enabled", datatypes.BOOLEAN, 1), ("torque", datatypes.INTEGER16, 16), ("error", datatypes.INTEGER8, 4))


def node(order):
    """A node whose first TPDO maps the objects in this order."""
    objects = ObjectDictionary()
    for kind, index, types in (
        (ODRecord, 0x1800, (datatypes.UNSIGNED8, datatypes.UNSIGNED32, datatypes.UNSIGNED8)),
        (ODArray, 0x1A00, (datatypes.UNSIGNED8, *4 * (datatypes.UNSIGNED32,))),
    ):
        group = kind(hex(index), index)
        for sub, type_ in enumerate(types):
            member = ODVariable(f"{index:X} {sub}", index, sub)
            member.data_type = type_
            group.add_member(member)
        objects.add_object(group)
    for k, (name, type_, _) in enumerate(MAPPED):
        variable = ODVariable(name, 0x2000 + k)
        variable.data_type = type_
        objects.add_object(variable)
    pdo = canopen.RemoteNode(1, objects).tpdo[1]
    pdo.cob_id = 0x181
    for k in order:
        pdo.add_variable(MAPPED[k][0], 0, MAPPED[k][2])
    return pdo


def packed(order, values):
    """The frame by CiA 301: each object in the next bits, the lowest first."""
    frame, begin = 0, 0
    for k in order:
        frame |= (values[k] & (1 << MAPPED[k][2]) - 1) << begin
        begin += MAPPED[k][2]
    return bytearray(frame.to_bytes(3, "little"))


def read(order, values):
    pdo = node(order)
    pdo.data = packed(order, values)
    found = {each.name: int(each.raw) for each in pdo.map}
    return [found[name] for name, *_ in MAPPED]


def written(order, torque):
    """The torque in the frame after it was written into one of zeros, or the exception."""
    pdo = node(order)
    pdo.data = bytearray(3)
    try:
        pdo["torque"].raw = torque
    except struct.error as error:
        return type(error)
    begin = sum(MAPPED[k][2] for k in order[: order.index(1)])
    return int.from_bytes(pdo.data, "little") >> begin & 0xFFFF


print("canopen", version("canopen"))
tight, whole = (0, 1, 2), (1, 0, 2)  # the bit first; the whole bytes first
for values in ((1, 100, -7), (1, 20000, -1), (0, -20000, -8)):
    print(f"sent {list(values)}: read {read(tight, values)}, with the torque first {read(whole, values)}")
for torque in (100, -100, 20000):
    print(f"torque {torque}: written as {written(tight, torque)}, first as {written(whole, torque)}")
assert read(tight, (1, 100, -7)) == [1, 100, -7]
assert read(tight, (1, 20000, -1)) == [1, -12768, -1] and read(tight, (0, -20000, -8)) == [0, 12768, 8]
assert read(whole, (1, 20000, -1)) == [1, 20000, -1] and read(whole, (0, -20000, -8)) == [0, -20000, 8]
assert written(tight, 100) == 100 and written(tight, -100) == 32668 and written(tight, 20000) is struct.error
assert written(whole, 20000) == 20000 and written(whole, -100) == -100 & 0xFFFF
PY
