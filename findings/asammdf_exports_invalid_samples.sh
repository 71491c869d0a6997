#!/usr/bin/env bash
# asammdf 8.8.28, MDF.export and MDF.resample of a channel with invalidation bits.
# Guess: samples that the file marks as invalid are not used, as in MDF.get, which leaves them out.
# Seen: .mat and HDF5 have them like any others; resample interpolates between a valid and an invalid sample,
#   and calls the result valid: 49.51 between 0.02 and a 99 that is marked; CSV and Parquet have a straight
#   line across the gap. So a ball that a camera lost is somewhere in each of them, without a mark.
# Do: take each channel by MDF.get, and its own times, before resampling or writing it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet asammdf==8.8.28 canmatrix==1.2 scipy==1.17.1 h5py==3.16.0 pyarrow==26.0.1
env/bin/python -W ignore - <<'PY'
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
from asammdf import MDF, Signal
from scipy.io import loadmat

LOST = 99.0
time = 0.01 * np.arange(8)
lost = (3 <= np.arange(8)) & (np.arange(8) < 6)
position = Signal(np.where(lost, LOST, time), time, name="x", unit="m", invalidation_bits=lost)
with MDF() as log:
    log.append([position, Signal(np.ones(8), time, name="u")], common_timebase=True)
    log.save("log.mf4")
log = MDF("log.mf4")
got = log.get("x")
for kind in ("mat", "hdf5", "csv", "parquet"):
    log.export(kind, f"log.{kind}")
matlab = loadmat("log.mat")["DG0_x"].ravel()
with h5py.File(next(Path().glob("log*.hdf*"))) as file:
    hdf = file["ChannelGroup_0/x"][:]
csv = pd.read_csv(next(Path().glob("log*.csv")))["x"].to_numpy()
parquet = pd.read_parquet("log.parquet")["x"].to_numpy()
resampled = log.resample(0.005).get("x")
invented = dict(zip(resampled.timestamps.round(6).tolist(), resampled.samples.round(6).tolist()))[0.025]
print("asammdf", version("asammdf"))
print("get:     ", got.timestamps.tolist(), got.samples.tolist())
print(".mat:    ", matlab.tolist())
print("HDF5:    ", hdf.tolist())
print(".csv:    ", csv.tolist())
print("Parquet: ", parquet.tolist())
print("resample: at 0.025 s", invented)
assert got.samples.tolist() == time[~lost].tolist()
assert (matlab[lost] == LOST).all() and (hdf[lost] == LOST).all()
assert all(len(found) == len(time) and np.allclose(found, time) for found in (csv, parquet))
assert invented == (0.02 + LOST) / 2
PY
