#!/usr/bin/env bash
# Pint 0.25.3, numpy.remainder, mod and fmod of quantities (NumPy 2.4.6).
# Guess: units are converted, as in the operator % and as in numpy.add, hypot or clip: 370 degrees wrapped by a turn of
#   2 pi rad are 10 degrees.
# Seen: the numbers are taken as they are, 370 modulo 6.28, and the result has the unit of the first: 5.58 degrees. A
#   modulus of a different dimension is taken, too: 7 m modulo 2 s is 1 m. No warning.
# Do: the operator %, which converts and refuses other dimensions, or .to(...) before the call.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pint==0.25.3 numpy==2.4.6
env/bin/python -W error - <<'PY'
from importlib.metadata import version

import numpy as np
import pint

unit = pint.UnitRegistry()
angles = unit.Quantity(np.array([370.0, 725.0, 90.0]), "degree")
turn = unit.Quantity(2 * np.pi, "radian")
right = [10.0, 5.0, 90.0]
print("pint", version("pint"))
by_operator = (angles % turn).to("degree").magnitude
print("operator %:", by_operator.round(6), "degrees")
assert np.allclose(by_operator, right)
for function in (np.remainder, np.mod, np.fmod):
    found = function(angles, turn).to("degree").magnitude
    lengths = function(unit.Quantity(7.0, "meter"), unit.Quantity(200.0, "centimeter")).to("meter").magnitude
    mixed = function(unit.Quantity(7.0, "meter"), unit.Quantity(2.0, "second"))
    print(f"{function.__name__}: {found.round(6)} degrees; 7 m by 200 cm: {lengths:.6g} m; 7 m by 2 s: {mixed}")
    assert np.allclose(found, np.array([370, 725, 90]) % (2 * np.pi))
    assert np.isclose(lengths, 7.0) and mixed == unit.Quantity(1.0, "meter")
try:
    unit.Quantity(7.0, "meter") % unit.Quantity(2.0, "second")
    raise AssertionError("the operator took a different dimension")
except pint.DimensionalityError as refusal:
    print("operator %:", refusal)
assert np.isclose(np.hypot(unit.Quantity(3.0, "meter"), unit.Quantity(400.0, "centimeter")).to("meter").magnitude, 5)
PY
