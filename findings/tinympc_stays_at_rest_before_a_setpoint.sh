#!/usr/bin/env bash
# TinyMPC 0.0.8 (tinympc, its Python package), set_x_ref. No wheel for Python 3.11 on Linux: pip
#   compiles it once, 13 min on two busy cores.
# Guess: a mass that rests at 0 is driven to a setpoint of 1, as it is from a start at 0.1.
# Seen: it stays at 0 for ever, and every solve() says that it converged, in 1 iteration: the first one rolls out
#   the inputs of the last solve, before the reference is looked at, and finds nothing left to change. From 0.001,
#   below the tolerance, it is driven to 0 in place of 1. So a rig does not follow its first setpoint.
# Do: begin the first solve elsewhere than at 0 (set_x0 with 0.1, solve, then the true state), and check that the
#   first input is not 0.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet tinympc==0.0.8 scipy==1.11.4 numpy==1.26.4
env/bin/python - <<'PY' > said.txt
import numpy as np
import tinympc

A = np.array([[1.0, 0.05], [0.0, 1.0]])  # a mass, 50 ms
B = np.array([[0.05**2 / 2], [0.05]])


def drive(start, primed=False):
    """Where the mass is after 20 s with a setpoint of 1."""
    mpc = tinympc.TinyMPC()
    limit = np.array([3.0])
    mpc.setup(A, B, np.diag([10.0, 1.0]), np.array([[0.1]]), 20, rho=0.1, u_min=-limit, u_max=limit)
    mpc.set_x_ref(np.array([1.0, 0.0]))
    if primed:
        mpc.set_x0(np.array([0.1, 0.0]))
        mpc.solve()
    x = np.array([start, 0.0])
    for _ in range(400):
        mpc.set_x0(x)
        x = A @ x + B @ mpc.solve()["controls"]
    return x[0]


np.save("ends.npy", [drive(0.1), drive(0.001), drive(0.0), drive(0.0, primed=True)])
PY
env/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np

ends = np.load("ends.npy")
solved = Path("said.txt").read_text().count("converged")
print("tinympc", version("tinympc"), f"  {solved} of 1601 solutions converged")
for start, end in zip(("0.1", "0.001", "0", "0, after a solve from 0.1"), ends, strict=True):
    print(f"setpoint 1, start {start}: ends at {end:.6f}")
assert abs(ends[0] - 1) < 0.01
assert abs(ends[1]) < 0.001 and ends[2] == 0
assert abs(ends[3] - 1) < 0.01
PY
