#!/usr/bin/env bash
# filterpy 2.0.0, CubatureKalmanFilter of a linear system.
# Guess: for a linear system a cubature filter is the Kalman filter, as UnscentedKalmanFilter of the same package is to
#   13 digits: its points give the exact mean and covariance.
# Seen: the measurement is predicted by the points before the process noise Q was added, so S and the gain lack Q. For a
#   ball at 0.1 s with accelerations of 5 m/s2 and a camera of 20 mm, the rms error of the velocity is 11 % above the
#   Kalman filter's; P is double for the velocity and for the position nearly three times as large. No warning; with
#   little process noise nothing is seen.
# Do: take UnscentedKalmanFilter, whose MerweScaledSigmaPoints(n, 1, 0, 0) are the cubature points.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from filterpy.kalman import CubatureKalmanFilter, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

STEP, ACCELERATION, CAMERA, STEPS = 0.1, 5.0, 0.02, 3000  # s, m/s2, m, number
F, H = np.array([[1, STEP], [0, 1]]), np.array([[1.0, 0]])
noise = np.array([STEP**2 / 2, STEP]) * ACCELERATION
Q, R = np.outer(noise, noise), np.array([[CAMERA**2]])


def move(x, dt):
    return F @ x


def look(x):
    return H @ x


points = MerweScaledSigmaPoints(2, 1.0, 0.0, 0.0)
filters = {
    "Kalman": KalmanFilter(2, 1),
    "unscented": UnscentedKalmanFilter(2, 1, STEP, look, move, points),
    "cubature": CubatureKalmanFilter(2, 1, STEP, look, move),
}
filters["Kalman"].F, filters["Kalman"].H = F, H
for name, each in filters.items():
    each.x, each.P, each.Q, each.R = np.zeros((2, 1) if name == "Kalman" else 2), np.eye(2), Q, R
rng = np.random.default_rng(0)
state, errors = np.zeros(2), {name: [] for name in filters}
for _ in range(STEPS):
    state = F @ state + noise * rng.normal()
    measured = np.array([state[0] + CAMERA * rng.normal()])
    for name, each in filters.items():
        each.predict()
        each.update(measured)
        errors[name].append(np.ravel(each.x) - state)
print("filterpy", version("filterpy"))
rms = {name: np.sqrt((np.array(each)[100:] ** 2).mean(axis=0)) for name, each in errors.items()}
for name, each in filters.items():
    print(f"{name}: rms error {rms[name].round(4)} m, m/s; P {each.P.ravel().round(5)}")
assert np.allclose(rms["unscented"], rms["Kalman"]) and np.allclose(filters["unscented"].P, filters["Kalman"].P)
assert 1.08 < rms["cubature"][1] / rms["Kalman"][1] < 1.14
ratio = np.diag(filters["cubature"].P) / np.diag(filters["Kalman"].P)
print("variances of P, cubature to Kalman:", ratio.round(2))
assert 2.5 < ratio[0] < 3 and 2 < ratio[1] < 2.2
PY
