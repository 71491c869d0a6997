#!/usr/bin/env bash
# SymPy 1.14.0, ccode, fcode and codegen of a quotient of integer symbols (a C compiler is needed).
# Guess: the printed code computes the quotient, as codegen declares symbols with integer=True as int and as i / 2 is
#   printed as (1.0/2.0)*i, so that C does not divide integers.
# Seen: i / j is printed as i/j, which C and Fortran cut to an integer: a share of 3 counts in 8 is 0, and an angle plus
#   a fraction loses the fraction. codegen returns it as double. Numbers and real symbols are right, and 2*pi*i/j, where
#   the product comes first. No warning.
# Do: declare the symbols as real, or replace one by a real symbol before printing.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet sympy==1.14.0
env/bin/python - <<'PY'
import ctypes
import subprocess
from pathlib import Path

import sympy
from sympy import ccode, fcode, pi, symbols
from sympy.utilities.codegen import codegen

i, j = symbols("i j", integer=True)
x, y = symbols("x y", real=True)
EXPRESSIONS = {
    "share": i / j, "half": i / 2, "offset": x + i / j, "mean": (i + j) / (i - j), "turn": 2 * pi * i / j,
    "of_reals": x / y,
}  # fmt: skip
VALUES = {i: 3, j: 8, x: 1.5, y: 4.0}

(name, code), (header, declarations) = codegen(list(EXPRESSIONS.items()), "C99", "shares")
Path(name).write_text(code)
Path(header).write_text(declarations)
subprocess.run(["cc", "-shared", "-fPIC", "-o", "shares.so", name, "-lm"], check=True)
library = ctypes.CDLL("./shares.so")
print("sympy", sympy.__version__)
wrong = set()
for name, expression in EXPRESSIONS.items():
    arguments = sorted(expression.free_symbols, key=str)
    function = getattr(library, name)
    function.restype = ctypes.c_double
    function.argtypes = [ctypes.c_int if each.is_integer else ctypes.c_double for each in arguments]
    computed = function(*(VALUES[each] for each in arguments))
    right = float(expression.subs(VALUES))
    print(f"{name}: {expression} printed as {ccode(expression)}: {computed:.6g}, right is {right:.6g}")
    if abs(computed - right) > 1e-12:
        wrong.add(name)
assert wrong == {"share", "offset", "mean"}
assert fcode(i / j, source_format="free") == "i/j" and ccode(i / 2) == "(1.0/2.0)*i"
PY
