#!/usr/bin/env bash
# python-control 0.10.2, create_estimator_iosystem(sys, QN, RN, P0).
# Guess: as the documentation says, P0 is the initial covariance of the estimator, and by default that of the
#   steady state.
# Seen: a simulation starts with a covariance of 0, with P0 and without: the estimator takes its start for exact.
#   After 10 samples a wrong start is in error by more than 0.1 m; with P0 at the start of the simulation, by
#   less than 0.01 mm.
# Do: give the start of the simulation as [x0, P0], with P0 written once more.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet control==0.10.2 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import control
import numpy as np

PERIOD, AFTER = 0.02, 10
plant = control.ss(
    [[1, PERIOD], [0, 1]], [[PERIOD**2 / 2], [PERIOD]], [[1, 0]], 0, PERIOD
)  # a ball's position and velocity
QN, RN, P0 = np.array([[1e-3]]), np.array([[1e-6]]), np.eye(2)
times = np.arange(0, 2, PERIOD)
ball = control.forced_response(plant, times, 0 * times, [0.1, 0.2])
measured = np.vstack([ball.outputs, 0 * times])


def estimated(start, *covariance):
    """Covariance of the position at the start, and the error of the position after 10 samples, in m."""
    estimator = control.create_estimator_iosystem(plant, QN, RN, *covariance)
    states = control.input_output_response(estimator, times, measured, start).states
    return states[2, 0], abs(states[0, AFTER] - ball.outputs[AFTER])


print("control", control.__version__)
given, default = estimated(0, P0), estimated(0)
by_hand = estimated([np.zeros(2), P0], P0)
for name, (covariance, error) in {
    "P0 given to the estimator": given,
    "P0 left to the default": default,
    "P0 given to the simulation": by_hand,
}.items():
    print(f"{name}: covariance at the start {covariance:.0f}, error after 10 samples {1e3 * error:.4f} mm")
assert given == default
assert given[0] == 0 and given[1] > 0.1
assert by_hand[0] == 1 and by_hand[1] < 1e-5
PY
