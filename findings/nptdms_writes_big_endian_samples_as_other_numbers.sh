#!/usr/bin/env bash
# npTDMS 1.13.0, TdmsWriter with samples in an array of big-endian numbers (NumPy 2.4.6).
# Guess: an array whose dtype is ">f8" or ">i2", as NumPy has it for what was read from a network, from HDF5 or from
#   a recorder of Motorola's byte order, is written with its values: NumPy computes with it as with any other.
# Seen: the bytes are written as they are and the file calls them little-endian: 1, 2 and 3 are read back as 3.04e-319,
#   3.16e-322 and 1.04e-320, and integers of 16 bits as 256, 512 and 768. No warning; properties are right.
# Do: samples.astype(samples.dtype.newbyteorder("=")) before writing.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet nptdms==1.13.0 numpy==2.4.6
env/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from nptdms import ChannelObject, TdmsFile, TdmsWriter

print("npTDMS", version("nptdms"), "NumPy", np.__version__)
found = {}
for kind in ("<f8", ">f8", "<i2", ">i2"):
    samples = np.array([1, 2, 3], dtype=kind)
    assert samples.sum() == 6
    with TdmsWriter("log.tdms") as writer:
        writer.write_segment([ChannelObject("rig", "angle", samples)])
    found[kind] = TdmsFile.read("log.tdms")["rig"]["angle"][:]
    print(f"1, 2, 3 as {kind}: {found[kind]}")
assert found["<f8"].tolist() == found["<i2"].tolist() == [1, 2, 3]
assert found[">i2"].tolist() == [256, 512, 768]
assert np.all((0 < found[">f8"]) & (found[">f8"] < 1e-300))
assert found[">f8"].byteswap().tolist() == [1, 2, 3]
PY
