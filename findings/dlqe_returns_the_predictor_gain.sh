#!/usr/bin/env bash
# python-control 0.10.2, dlqe.
# Guess: as in MATLAB, whose dlqe returns the gain M of the measurement update,
#   x[n|n] = x[n|n-1] + M (y[n] - C x[n|n-1]).
# Seen: the gain of the one-step predictor, L = A M, for x[n+1|n] = A x[n|n-1] + L (y[n] - C x[n|n-1]).
#   Used as the gain of a measurement update, its estimate has a larger error than the filter's.
# Do: M = P C' (C P C' + R)^-1 from the returned P, or solve A M = L.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet control==0.10.2 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import control
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

A = np.array([[1.0, 0.1], [0.0, 1.0]])  # a ball's position and velocity, 0.1 s
C = np.array([[1.0, 0.0]])
Q, R = np.diag([1e-6, 1e-2]), np.array([[1e-2]])
L, P, _ = control.dlqe(A, np.eye(2), C, Q, R)
M = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
print("control", control.__version__)
print("returned gain     ", L.ravel())
print("measurement update", M.ravel())


def filter_error(gain):
    """Covariance after an update with this gain, in the steady state."""
    update = np.eye(2) - gain @ C
    return solve_discrete_lyapunov(update @ A, update @ Q @ update.T + gain @ R @ gain.T)


best, mistaken = filter_error(M)[0, 0], filter_error(L)[0, 0]
print(f"variance of the position with it as update: {mistaken:.5f}, with the filter's gain: {best:.5f}")
assert np.allclose(L, A @ M) and not np.allclose(L, M, rtol=1e-2)
assert mistaken > 1.01 * best
PY
