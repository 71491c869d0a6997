#!/usr/bin/env bash
# fxpmath 0.4.10, division of fixed-point numbers (Fxp) with a rounding method.
# Guess: a quotient is rounded as `rounding` says: by default "trunc", towards zero, -7 / 2 without bits for fractions
#   is -3, as Fxp(-3.5) is and as C divides integers; the page of truediv says that it honours the rounding.
# Seen: quotients are rounded down whatever the method is: -7 / 2 is -4 with "trunc", "fix" and "ceil", and 7 / 2 is 3
#   with "ceil" and "around". Means of 8 values are 0.44 units too small on average, also with "around". Multiplication
#   and storing follow the method. No warning.
# Do: divide the real value and store it, Fxp(x() / y, like=x), or call truediv with method="repr".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet fxpmath==0.4.10 numpy==2.4.6
env/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from fxpmath import Fxp
from fxpmath.functions import truediv

ROUND = {"trunc": np.trunc, "fix": np.fix, "ceil": np.ceil, "floor": np.floor, "around": np.around}


def fixed(value, method):
    """Fixed-point integer of 16 bits."""
    return Fxp(value, signed=True, n_word=16, n_frac=0, rounding=method)


print("fxpmath", version("fxpmath"))
sums = np.arange(-4000, 4001)
for method, rounded in ROUND.items():
    quotients = [float(fixed(value, method) / 2) for value in (-7, 7)]
    stored = [float(fixed(value / 2, method)) for value in (-7, 7)]
    means = np.asarray((fixed(sums, method) / 8)(), float)
    by_value = np.asarray(Fxp(fixed(sums, method)() / 8, like=fixed(0, method))(), float)
    by_repr = truediv(fixed(sums, method), 8, out_like=fixed(0, method), method="repr")
    bias = float((means - sums / 8).mean())
    print(
        f"{method}: -7 / 2 and 7 / 2 are {quotients}, stored -3.5 and 3.5 {stored}; mean error of a division by 8: "
        f"{bias:.3f}, by the value {(by_value - sums / 8).mean():.3f}"
    )
    assert quotients == [-4, 3] and stored == [rounded(-3.5), rounded(3.5)]
    assert (means == np.floor(sums / 8)).all() and abs(bias + 0.4375) < 1e-3
    assert (by_value == rounded(sums / 8)).all()
    assert (np.asarray(by_repr(), float) == rounded(sums / 8)).all()
product = Fxp(-0.75, True, 8, 2, rounding="ceil", op_sizing="same") * Fxp(0.75, True, 8, 2, rounding="ceil")
assert float(product) == -0.5
PY
