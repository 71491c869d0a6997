#!/usr/bin/env bash
# filterpy 2.0.0, log_likelihood and likelihood of InformationFilter.
# Guess: they are those of KalmanFilter, as the estimates are to 13 digits: the density of the measurement
#   given the earlier ones, the normal density of the residual with its covariance H P H' + R.
# Seen: the inverse of the new covariance of the state, which the filter keeps as S, is taken for it. With one
#   measurement of two states the residual is put in for both. So the more the filter knows, the less likely each
#   measurement is: for data made with noise of 0.2 m the likelihood is largest at 4 m, not at 0.2 m. No warning.
# Do: take KalmanFilter for a likelihood, as for a bank of filters or for tuning.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from filterpy.kalman import InformationFilter, KalmanFilter
from scipy.stats import multivariate_normal

STEP, CAMERA, STEPS = 0.1, 0.2, 300  # s, m, number
F, H = np.array([[1, STEP], [0, 1]]), np.array([[1.0, 0]])
noise = np.array([[STEP**2 / 2], [STEP]])
Q = noise @ noise.T
CAMERAS = [0.05, 0.1, 0.2, 0.4, 0.8, 1.0, 2.0, 4.0]  # m


def both(camera, measured):
    """Log likelihoods of the measurements by KalmanFilter and InformationFilter, and largest difference of states."""
    kalman, information = KalmanFilter(2, 1), InformationFilter(2, 1)
    for each in (kalman, information):
        each.F, each.H, each.Q, each.x = F, H, Q, np.zeros((2, 1))
    kalman.R, information.R_inv = np.array([[camera**2]]), np.array([[camera**-2]])
    kalman.P = information.P_inv = np.eye(2)
    sums, difference = np.zeros(2), 0.0
    for value in measured:
        for index, each in enumerate((kalman, information)):
            each.predict()
            each.update(np.array([[value]]))
            sums[index] += each.log_likelihood
        difference = max(difference, float(np.abs(kalman.x - information.x).max()))
    return *sums, difference


def exact(camera, measured):
    """Log density of all measurements at once, from their joint covariance."""
    covariance = np.zeros((len(measured),) * 2)
    P = np.eye(2)
    for k in range(len(measured)):
        P = F @ P @ F.T + Q
        column = P @ H.T
        for later in range(k, len(measured)):
            covariance[k, later] = covariance[later, k] = (H @ column).item()
            column = F @ column
    return multivariate_normal(cov=covariance + camera**2 * np.eye(len(measured))).logpdf(measured)


rng = np.random.default_rng(0)
state, measured = np.zeros((2, 1)), []
for _ in range(STEPS):
    state = F @ state + noise * rng.normal()
    measured.append(state[0, 0] + CAMERA * rng.normal())
print("filterpy", version("filterpy"))
found = np.array([both(camera, measured) for camera in CAMERAS])
for camera, (kalman, information, difference) in zip(CAMERAS, found):
    print(
        f"noise of {camera:g} m: KalmanFilter {kalman:.1f}, InformationFilter {information:.1f}, "
        f"states differ by {difference:.1g}"
    )
    assert difference < 1e-9
assert abs(found[2, 0] - exact(CAMERA, measured)) < 1e-6
best = [CAMERAS[index] for index in found[:, :2].argmax(axis=0)]
print("most likely noise, m:", best)
assert best == [CAMERA, 4.0]
PY
