#!/usr/bin/env bash
# SciPy 1.17.1, scipy.io.savemat of a masked array (NumPy 2.4.6).
# Guess: samples that are masked, such as those in which a camera lost the ball, are NaN in the file, as pandas
#   has them, or the array is refused, as MATLAB knows no masks.
# Seen: each becomes the fill value of its type: 1e20 in floats, 999999 in integers, True in booleans and, as 999999
#   does not fit in 16 bits, 16959 in int16, which is a number like any other. The mask itself is not in the file. So a
#   mean or a fit in MATLAB takes a ball at 1e20 m. No warning.
# Do: x.filled(np.nan), integers as floats, and the mask as a variable of its own.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet scipy==1.17.1 numpy==2.4.6
env/bin/python - <<'PY'
import warnings

import numpy as np
import scipy
from scipy.io import loadmat, savemat

print("SciPy", scipy.__version__, "NumPy", np.__version__)
LOST = [False, True, False]
kinds = ("f8", "f4", "i4", "i2", "?")
with warnings.catch_warnings():
    warnings.simplefilter("error")
    savemat("log.mat", {f"x_{n}": np.ma.masked_array(np.array([1, 0, 1], k), LOST) for n, k in enumerate(kinds)})
    found = {kind: loadmat("log.mat")[f"x_{n}"].ravel() for n, kind in enumerate(kinds)}
for kind, values in found.items():
    print(f"1, masked, 1 as {kind}: {values}")
assert found["f8"].tolist() == [1, 1e20, 1]
assert found["f4"].tolist() == [1, np.float32(1e20), 1]
assert found["i4"].tolist() == [1, 999999, 1]
assert found["i2"].tolist() == [1, 999999 - 65536 * 15, 1]
assert found["?"].tolist() == [1, 1, 1]
PY
