#!/usr/bin/env bash
# CasADi 3.8.2, interpolant with the method "bspline".
# Guess: outside its grid a table goes on from the last interval, as with the method "linear" of the same function
#   and with scipy's BSpline, or keeps its last value, as numpy.interp does.
# Seen: 0, with a slope of 0, from the last digit after the edge on: a gain of 4 at the edge is 0 beyond. An
#   optimizer that leaves the grid for one iteration, and a cam or torque table in a simulation, jump. No warning.
# Do: widen the grid beyond all that occurs, or give the spline fmin(fmax(x, first), last).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet casadi==3.8.2 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import casadi
import numpy as np
from scipy.interpolate import make_interp_spline

grid = np.linspace(0.0, 3.0, 7)
table = 1 + grid
m = casadi.MX.sym("m")
spline = casadi.interpolant("spline", "bspline", [grid], table)
linear = casadi.interpolant("linear", "linear", [grid], table)
slope = casadi.Function("slope", [m], [casadi.jacobian(spline(m), m)])
peer = make_interp_spline(grid, table, k=3)
held = casadi.Function("held", [m], [spline(casadi.fmin(casadi.fmax(m, grid[0]), grid[-1]))])
print("casadi", casadi.__version__)
print("     x  bspline  its slope  linear  scipy  held")
for place in (-0.5, 0.0, 1.25, 3.0, np.nextafter(3.0, 4.0), 3.5):
    row = [float(f(place)) for f in (spline, slope, linear, peer, held)]
    print(f"{place:6.2f} " + " ".join(f"{value:8.3f}" for value in row))
    inside = grid[0] <= place <= grid[-1]
    assert np.isclose(row[0], 1 + place) if inside else row[0] == row[1] == 0
    assert np.isclose(row[2], 1 + place) and np.isclose(row[3], 1 + place)
    assert np.isclose(row[4], 1 + np.clip(place, 0, 3))
PY
