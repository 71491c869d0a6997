#!/usr/bin/env bash
# CasADi 3.8.2, C code generation with casadi_real = "float".
# Guess: code for a processor with a 32-bit floating-point unit computes in 32 bits.
# Seen: the variables are float, but sqrt, sin and tanh are the functions for double. Each call
#   widens its argument and narrows its result, and is computed in 64 bits: on a Cortex-M4F in
#   software. The type of indices, casadi_int, is long long.
# Do: map the functions to sqrtf, sinf, ... by macros before the generated file, and let gcc's
#   -Wfloat-conversion list those that were missed. -Wdouble-promotion does not report them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
command -v gcc >/dev/null || { echo "needs gcc"; exit 1; }
python3 -m venv env
env/bin/pip install --quiet casadi==3.8.2 numpy==2.4.6
env/bin/python - <<'PY'
import re
import casadi

x = casadi.SX.sym("x", 2)
law = casadi.Function("law", [x], [casadi.sqrt(x[0]) + 2.5 * casadi.sin(x[1]) + casadi.tanh(x[0])])
law.generate("law.c", {"casadi_real": "float"})
text = open("law.c").read()
print("CasADi", casadi.__version__)
print("type of numbers:", re.search(r"#define casadi_real (\w+)", text)[1])
print("type of indices:", re.search(r"#define casadi_int ([\w ]+)", text)[1])
called = sorted(set(re.findall(r"=(sqrtf?|sinf?|tanhf?)\(", text)))
print("functions called:", *called)
assert called == ["sin", "sqrt", "tanh"], called
assert re.search(r"#define casadi_real float", text)
assert re.search(r"#define casadi_int long long", text)
PY
LC_ALL=C gcc -std=c99 -c -Wfloat-conversion -Wdouble-promotion law.c 2>warnings.txt
narrowed=$(grep -c 'Wfloat-conversion' warnings.txt || true)
widened=$(grep -c 'Wdouble-promotion' warnings.txt || true)
echo "results narrowed, by gcc -Wfloat-conversion: $narrowed; by -Wdouble-promotion: $widened"
[ "$narrowed" -ge 3 ] && [ "$widened" = 0 ]
