#!/usr/bin/env bash
# scipy 1.17.1, scipy.io.savemat of time stamps (pandas 3.1.1).
# Guess: an array of datetime64 is refused, as MATLAB's file has no such type, or written in one unit, such as MATLAB's
#   days; a log of the same moments gives the same file.
# Seen: it is written as a double that counts from 1970 in the unit in which the stamps are kept: 1767225600 with [s],
#   1000 times as much with [ms], and so on; the file lacks the unit. pandas keeps what it parses in [us], NumPy may
#   keep the same in [s] or [ms]. With [ns] a double has steps of 256 ns, so that the stamps are changed. NaT becomes
#   -9.2e18. timedelta64 is written likewise. No warning.
# Do: write (t - t[0]) / np.timedelta64(1, "s") and the start as text.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet scipy==1.17.1 numpy==2.4.6 pandas==3.1.1
env/bin/python -W error - <<'PY'
import numpy as np
import pandas as pd
import scipy
from scipy.io import loadmat, savemat

START = "2026-01-01T00:00:00"


def kept(stamps):
    """What the file has for the stamps."""
    savemat("log.mat", {"t": stamps})
    return loadmat("log.mat")["t"].ravel()


print("scipy", scipy.__version__, "pandas", pd.__version__)
counts = {unit: kept(np.array([START], f"datetime64[{unit}]"))[0] for unit in ("D", "s", "ms", "us", "ns")}
for unit, count in counts.items():
    print(f"datetime64[{unit}]: {count:.0f}")
parsed = kept(pd.to_datetime([START]).to_numpy())[0]
steps = np.array([START], "datetime64[ns]") + np.arange(1000) * np.timedelta64(100, "ns")
found = kept(steps)
print(f"parsed by pandas: {parsed:.0f}; 1000 stamps 100 ns apart: {len(np.unique(found))} different ones")
lost = kept(np.array(["NaT"], "datetime64[us]"))[0]
spans = [kept(np.array([1500], "timedelta64[ms]").astype(f"timedelta64[{unit}]"))[0] for unit in ("ms", "us")]
print(f"NaT: {lost:.3g}; 1.5 s as timedelta64: {spans}")
seconds = 1767225600
assert counts == {"D": seconds / 86400, "s": seconds, "ms": 1e3 * seconds, "us": 1e6 * seconds, "ns": 1e9 * seconds}
assert all(count.dtype == float for count in counts.values()) and parsed == counts["us"]
assert len(np.unique(found)) < 500 and (np.diff(np.unique(found)) == 256).all()
assert lost < -9e18 and spans == [1500, 1500000]
PY
