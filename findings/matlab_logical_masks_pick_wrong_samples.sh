#!/usr/bin/env bash
# scipy 1.17.1 (loadmat) and pymatreader 1.3.2, a logical array in a .mat file (mat73 0.65 for comparison).
# Guess: a logical array is a mask in Python, too: x[valid] has the samples where it is true.
# Seen: it comes as uint8, and x[valid] takes its zeros and ones for places: x[1], x[0], x[1], ... in place of the
#   valid samples: the first two samples again and again. mat73 returns bool for a file of MATLAB 7.3, pymatreader
#   uint8. No warning.
# Do: valid.astype(bool), or mat_dtype=True for scipy's loadmat.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet scipy==1.17.1 numpy==2.4.6 pymatreader==1.3.2 mat73==0.65 hdf5storage==0.2.2 h5py==3.16.0
env/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import hdf5storage
import mat73
import numpy as np
import pymatreader
from scipy.io import loadmat, savemat

log = {"x": np.array([10.0, 20.0, 30.0, 40.0]), "valid": np.array([True, False, False, True])}
savemat("v5.mat", log)
hdf5storage.savemat("v73.mat", log, format="7.3", oned_as="column")
found = {
    "scipy, 5": loadmat("v5.mat", squeeze_me=True),
    "pymatreader, 5": pymatreader.read_mat("v5.mat"),
    "pymatreader, 7.3": pymatreader.read_mat("v73.mat"),
    "mat73, 7.3": mat73.loadmat("v73.mat"),
    "scipy, 5, mat_dtype": loadmat("v5.mat", squeeze_me=True, mat_dtype=True),
}
print("scipy", version("scipy"), "  pymatreader", version("pymatreader"), "  mat73", version("mat73"))
for name, file in found.items():
    print(f"{name:20} {file['valid'].dtype!s:6} x[valid] =", file["x"][file["valid"]])
for name in ("scipy, 5", "pymatreader, 5", "pymatreader, 7.3"):
    assert found[name]["valid"].dtype == np.uint8
    assert found[name]["x"][found[name]["valid"]].tolist() == [20, 10, 10, 20]
for name in ("mat73, 7.3", "scipy, 5, mat_dtype"):
    assert found[name]["x"][found[name]["valid"]].tolist() == [10, 40]
PY
