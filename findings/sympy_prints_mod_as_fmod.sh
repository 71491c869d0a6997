#!/usr/bin/env bash
# sympy 1.14.0, ccode and cxxcode of Mod with real arguments.
# Guess: Mod(angle + pi, 2*pi) - pi, which wraps an angle into -pi to pi, does so in the printed C, too: Mod has the
#   sign of the divisor, and C for integers, Rust, JavaScript, Octave and Julia are printed so that they do.
# Seen: it is printed as fmod, which has the sign of the dividend: an angle below -pi is not wrapped into the range,
#   -1.5 pi comes out as -1.5 pi in place of 0.5 pi. No warning; positive angles are right.
# Do: write x - y*floor(x/y) in place of Mod(x, y), which all languages print alike, or wrap by atan2(sin, cos).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet sympy==1.14.0
cat > print.py <<'PY'
import sympy

angle = sympy.Symbol("angle", real=True)
wrapped = sympy.Mod(angle + sympy.pi, 2 * sympy.pi) - sympy.pi
turns = sympy.floor((angle + sympy.pi) / (2 * sympy.pi))
lines = ["#include <math.h>", "#include <stdio.h>", "#include <stdlib.h>"]
for name, expression in (("by_mod", wrapped), ("by_floor", angle - 2 * sympy.pi * turns)):
    lines.append(f"static double {name}(double angle) {{ return {sympy.ccode(expression)}; }}")
lines.append('int main(int n, char **x) { double a = atof(x[n - 1]);'
             ' printf("%.15g %.15g\\n", by_mod(a), by_floor(a)); return 0; }')
print("\n".join(lines))
PY
env/bin/python print.py > wrap.c
gcc -o wrap wrap.c -lm
env/bin/python - <<'PY'
import math
import subprocess

import sympy

angle = sympy.Symbol("angle", real=True)
wrapped = sympy.Mod(angle + sympy.pi, 2 * sympy.pi) - sympy.pi
print("sympy", sympy.__version__, "  C:", sympy.ccode(wrapped))
for turns in (0.25, 0.75, -0.25, -0.75):
    given = turns * 2 * math.pi
    exact = float(wrapped.subs(angle, given))
    answer = subprocess.run(["./wrap", repr(given)], capture_output=True, text=True, check=True).stdout
    in_c, by_floor = map(float, answer.split())
    print(f"{turns:6.2f} turns: sympy {exact:8.5f}, C by Mod {in_c:8.5f}, C by floor {by_floor:8.5f}")
    assert math.isclose(by_floor, exact, abs_tol=1e-9)
    assert math.isclose(in_c, exact - (2 * math.pi if turns == -0.75 else 0), abs_tol=1e-9)
PY
