#!/usr/bin/env bash
# cantools 45.1.0, generate_c_source.
# Guess: the encode functions of the C code give the raw values that Database.encode of the same package gives,
#   the nearest ones: with a factor of 0.01 an angle of 0.29 is sent as 29.
# Seen: 28: the quotient 28.999999999999996 is cut, not rounded. Of the 65536 values of a signed signal of 16
#   bits, each a raw value times 0.01, 4858 are sent one step too close to 0. Python rounds.
# Do: give encode() the value plus half a step away from 0 (with an offset: half a step beyond it), or write the
#   raw value yourself with lround.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet cantools==45.1.0
cat > p.dbc <<'DBC'
VERSION ""
NS_ :
BS_:
BU_: Drive
BO_ 385 Status: 2 Drive
 SG_ angle : 0|16@1- (0.01,0) [-327.68|327.67] "deg" Vector__XXX
DBC
env/bin/python -m cantools generate_c_source p.dbc > generated.txt
cat > try.c <<'C'
#include "p.h"
#include <stdio.h>

int main(void)
{
    int too_small = 0, too_large = 0;
    for (int raw = -32768; raw <= 32767; raw++) {
        int sent = p_status_angle_encode(raw * 0.01);
        too_small += (raw < 0 ? -sent : sent) < (raw < 0 ? -raw : raw);
        too_large += (raw < 0 ? -sent : sent) > (raw < 0 ? -raw : raw);
    }
    printf("%d %d %d\n", p_status_angle_encode(0.29), too_small, too_large);
    return 0;
}
C
gcc -o try try.c p.c
./try > counts.txt
env/bin/python - <<'PY'
from pathlib import Path

import cantools

message = cantools.database.load_file("p.dbc").get_message_by_name("Status")


def encode(angle):
    return int.from_bytes(message.encode({"angle": angle}), "little", signed=True)


in_c, too_small, too_large = map(int, Path("counts.txt").read_text().split())
print("cantools", cantools.__version__)
print("0.29 deg by Python", encode(0.29), "by the C code", in_c)
print(f"of 65536 raw values {too_small} are sent too close to 0, {too_large} too far from it")
assert encode(0.29) == 29
assert all(encode(raw * 0.01) == raw for raw in range(-32768, 32768, 17))
assert in_c == 28
assert too_large == 0 and 4000 < too_small < 6000
PY
