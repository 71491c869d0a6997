#!/usr/bin/env bash
# TinyMPC 0.0.8 (tinympc, its Python package), setup(A, B, Q, R, N, rho). No wheel for Python 3.11 on Linux: pip
#   compiles it once, 13 min on two busy cores.
# Guess: rho is the penalty of the solver's iterations (ADMM): it sets how fast they converge, not where to. Without
#   limits and with a long horizon the first input is that of the LQR with Q and R, whatever rho is.
# Seen: the first input is that of the LQR with Q + rho I and R + rho I, though the solver converged to 1e-9. With
#   Q = diag(10, 1), R = 0.1 and the default rho of 1 the gain is 2.9 in place of 8.7. No warning.
# Do: give setup Q - rho I and R - rho I, with a rho below all weights, and compare the first input with the LQR.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet tinympc==0.0.8 scipy==1.11.4 numpy==1.26.4
env/bin/python - <<'PY' | grep -v converged
from importlib.metadata import version

import numpy as np
import tinympc
from scipy.linalg import solve_discrete_are

A = np.array([[1.0, 0.05], [0.0, 1.0]])  # a mass, 50 ms
B = np.array([[0.05**2 / 2], [0.05]])
Q, R = np.diag([10.0, 1.0]), np.array([[0.1]])
start = np.array([1.0, 0.0])


def by_lqr(Q, R):
    P = solve_discrete_are(A, B, Q, R)
    return float((-np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A) @ start)[0])


def by_tinympc(Q, R, rho):
    mpc = tinympc.TinyMPC()
    mpc.setup(A, B, Q, R, 80, rho=rho, abs_pri_tol=1e-9, abs_dua_tol=1e-9, max_iter=5000)
    mpc.set_x0(start)
    return float(mpc.solve()["controls"][0])


print("tinympc", version("tinympc"), "  LQR with Q and R:", round(by_lqr(Q, R), 4))
for rho in (0.01, 0.1, 1.0, 10.0):
    found = by_tinympc(Q, R, rho)
    heavier = by_lqr(Q + rho * np.eye(2), R + rho)
    print(f"rho {rho:5}: TinyMPC {found:.4f}, LQR with rho added to the weights {heavier:.4f}")
    assert np.isclose(found, heavier, rtol=0.01)
    assert abs(found / by_lqr(Q, R) - 1) > 0.02
corrected = by_tinympc(Q - 0.05 * np.eye(2), R - 0.05, 0.05)
print(f"rho  0.05 taken from the weights: {corrected:.4f}")
assert np.isclose(corrected, by_lqr(Q, R), rtol=0.01)
PY
