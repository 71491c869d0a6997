#!/usr/bin/env bash
# filterpy 2.0.0, FixedLagSmoother.
# Guess: it gives the estimates of a Kalman smoother that knows the next N - 1 measurements, which are exact for a
#   linear system with known noise, and its newest estimate is that of the Kalman filter.
# Seen: it corrects by the covariance after the measurement, where the algorithm takes the one before it. For a
#   ball at 0.1 s and N = 8 the rms error of its position is 15 % above that of rts_smoother of the same package,
#   and that of the newest estimate 3.5 % above the filter's. No warning.
# Do: filter with KalmanFilter, keep the last N steps, and call rts_smoother for them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import filterpy
import numpy as np
from filterpy.kalman import FixedLagSmoother, KalmanFilter

F = np.array([[1.0, 0.1], [0.0, 1.0]])  # a ball's position and velocity, 0.1 s
H = np.array([[1.0, 0.0]])
Q, R, P0 = np.diag([1e-4, 1e-2]), np.array([[0.01]]), np.eye(2)
LAG, STEPS = 8, 400
random = np.random.default_rng(0)


def set_up(estimator):
    estimator.F, estimator.H, estimator.Q, estimator.R = F, H, Q, R
    estimator.P, estimator.x = P0.copy(), np.zeros((2, 1))
    return estimator


errors = []
for _ in range(10):
    state, truth, measured = random.multivariate_normal([0, 0], P0), [], []
    for _ in range(STEPS):
        state = F @ state + random.multivariate_normal([0, 0], Q)
        truth.append(state)
        measured.append(H @ state + random.normal(0, 0.1, 1))
    smoother = set_up(FixedLagSmoother(dim_x=2, dim_z=1, N=LAG))
    newest = []
    for z in measured:
        smoother.smooth(z)
        newest.append(smoother.xSmooth[-1].ravel())
    theirs = np.array([x.ravel() for x in smoother.xSmooth])
    kalman = set_up(KalmanFilter(dim_x=2, dim_z=1))
    means, covariances, _, _ = kalman.batch_filter(measured)
    exact = means[..., 0].copy()
    for k in range(STEPS):
        ahead = slice(k, k + LAG)  # their estimate k has seen the measurements k to k + LAG - 1
        exact[k] = kalman.rts_smoother(means[ahead], covariances[ahead])[0][0, :, 0]
    inner = slice(50, STEPS - LAG)
    found = (theirs, exact, means[..., 0], np.array(newest))
    errors.append([np.mean((one - truth)[inner] ** 2, axis=0) for one in found])
smoothed, by_rts, filtered, latest = np.sqrt(np.mean(errors, axis=0))
print("filterpy", filterpy.__version__, "  rms errors of position and velocity, with what follows:")
print("FixedLagSmoother        ", smoothed.round(5))
print("rts_smoother, same lag  ", by_rts.round(5))
print("and without what follows:")
print("FixedLagSmoother, newest", latest.round(5))
print("KalmanFilter            ", filtered.round(5))
assert 1.1 < smoothed[0] / by_rts[0] < 1.25
assert 1.02 < latest[0] / filtered[0] < 1.06
PY
