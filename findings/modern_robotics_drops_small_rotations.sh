#!/usr/bin/env bash
# modern_robotics 1.1.1, MatrixExp3 and MatrixExp6 of small rotations (scipy 1.17.1 for comparison).
# Guess: the exponential of a rotation of 4e-7 rad is that rotation, so that the rates of a gyroscope can be multiplied
#   up at any sampling rate.
# Seen: below 1e-6 rad the result is exactly the identity. At 1 kHz all rates below 1e-3 rad/s (0.06 deg/s), as of slow
#   drift, vanish: after 1000 s at 4e-4 rad/s the attitude has not changed and is off by 23 degrees; sampled at 100 Hz
#   it is right. MatrixExp6 drops the rotation and keeps the translation. No warning.
# Do: scipy's Rotation.from_rotvec, or add the steps up until they are larger.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet modern_robotics==1.1.1 numpy==2.4.6 scipy==1.17.1
env/bin/python -W error - <<'PY'
from importlib.metadata import version

import numpy as np
from modern_robotics import MatrixExp3, MatrixExp6, VecTose3, VecToso3
from scipy.spatial.transform import Rotation

RATE, TIME = np.array([0.0, 0.0, 4e-4]), 1000.0  # rad/s, s


def attitude(step, exponential):
    """Angle in degrees after TIME of a constant rate that is multiplied up in steps; shape ()."""
    one = exponential(RATE * step)
    matrix = np.linalg.matrix_power(one, round(TIME / step))
    return float(np.degrees(np.arctan2(matrix[1, 0], matrix[0, 0])))


print("modern_robotics", version("modern_robotics"))
true = float(np.degrees(RATE[2] * TIME))
for step, expected in ((1e-3, 0.0), (1e-2, true)):
    angle = attitude(step, lambda vector: MatrixExp3(VecToso3(vector)))
    other = attitude(step, lambda vector: Rotation.from_rotvec(vector).as_matrix())
    print(f"steps of {step:g} s: {angle:.4f} degrees, scipy {other:.4f}, true {true:.4f}")
    assert abs(angle - expected) < 1e-6 and abs(other - true) < 1e-6
for angle, kept in ((9.9e-7, False), (1.1e-6, True)):
    matrix = MatrixExp3(VecToso3([0, 0, angle]))
    print(f"{angle:g} rad: {'kept' if matrix[1, 0] else 'the identity'}")
    assert (matrix != np.eye(3)).any() == kept
screw = MatrixExp6(VecTose3([0, 0, 9.9e-7, 1e-6, 0, 0]))
assert (screw[:3, :3] == np.eye(3)).all() and screw[0, 3] == 1e-6
PY
