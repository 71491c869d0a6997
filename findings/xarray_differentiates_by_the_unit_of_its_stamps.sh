#!/usr/bin/env bash
# xarray 2026.9.0, differentiate, integrate and polyfit over a coordinate of time stamps.
# Guess: the same log has the same slope whatever the resolution of its stamps is: per second, or per nanosecond as in
#   older pandas and xarray.
# Seen: differentiate and integrate count in the unit in which the stamps are kept: a slope of 3 m/s is 3 with
#   datetime64[s], 0.003 with [ms], 3e-6 with [us] and 3e-9 with [ns]. polyfit of the same array is always per
#   nanosecond for datetime64, and by the unit for timedelta64. No warning.
# Do: differentiate(..., datetime_unit="s"), or a coordinate of seconds as numbers.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet xarray==2026.9.0 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import xarray as xr

SPEED, START = 3.0, np.datetime64("2026-01-01T00:00:00")  # m/s
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
seconds = np.arange(11)
print("xarray", version("xarray"), " pandas", version("pandas"))
for unit, second in UNITS.items():
    spans = seconds.astype("timedelta64[s]").astype(f"timedelta64[{unit}]")
    found = {}
    for kind, stamps in {"datetime64": START.astype(f"datetime64[{unit}]") + spans, "timedelta64": spans}.items():
        log = xr.DataArray(SPEED * seconds, coords={"time": stamps}, dims="time")
        assert log.time.dtype == f"{kind}[{unit}]"
        found[kind] = (
            float(log.differentiate("time")[5]),
            float(log.integrate("time")),
            float(log.polyfit("time", 1).polyfit_coefficients[0]),
        )
        print(f"{kind}[{unit}]: differentiate {found[kind][0]:.1e}, integrate {found[kind][1]:.1e}, "
              f"polyfit {found[kind][2]:.1e}")
        assert np.isclose(found[kind][0], SPEED * second)
        assert np.isclose(found[kind][1], SPEED * 50 / second)
        assert np.isclose(float(log.differentiate("time", datetime_unit="s")[5]), SPEED)
    assert np.isclose(found["datetime64"][2], SPEED * 1e-9)
    assert np.isclose(found["timedelta64"][2], SPEED * second)
PY
