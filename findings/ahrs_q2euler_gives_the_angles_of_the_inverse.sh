#!/usr/bin/env bash
# AHRS 0.4.0, ahrs.common.orientation.q2euler (scipy 1.17.1 for comparison).
# Guess: the angles about x, y and z are those of the formulas that its page refers to, roll, pitch and yaw of the
#   quaternion, as q2rpy of the same module gives them: a turn about x by 30 degrees has the angles 30, 0, 0.
# Seen: they are those of the inverse rotation: -30, 0, 0. And each quaternion with a sum of exactly 1 is taken for no
#   rotation: half turns about x, y and z and turns by 120 degrees give 0, 0, 0. No warning.
# Do: q2rpy of the same module, which is right unless the pitch is 90 degrees.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet ahrs==0.4.0 numpy==2.4.6 scipy==1.17.1
env/bin/python -W error - <<'PY'
from importlib.metadata import version

import numpy as np
from ahrs.common.orientation import q2euler, q2rpy
from scipy.spatial.transform import Rotation


def turn(rotation):
    """Angles in degrees by q2euler, by q2rpy and by scipy (roll, pitch, yaw), each of shape (3,)."""
    q = rotation.as_quat(scalar_first=True)
    return np.degrees(q2euler(q)), np.degrees(q2rpy(q)), rotation.as_euler("ZYX", degrees=True)[::-1]


print("ahrs", version("ahrs"))
for axis in "xyz":
    found, other, true = turn(Rotation.from_euler(axis, 30, degrees=True))
    print(f"30 degrees about {axis}: q2euler {found.round(4)}, q2rpy {other.round(4)}, scipy {true.round(4)}")
    assert np.allclose(found, -true) and np.allclose(other, true)
rng = np.random.default_rng(0)
for rotation in Rotation.random(1000, rng):
    found, other, true = turn(rotation)
    inverse = rotation.inv().as_euler("ZYX", degrees=True)[::-1]
    assert np.allclose(found, inverse, atol=1e-5) and np.allclose(other, true, atol=1e-5)
for q in ([0.0, 1, 0, 0], [0.0, 0, 1, 0], [0.0, 0, 0, 1], [0.5, 0.5, 0.5, -0.5], [0.5, -0.5, 0.5, 0.5]):
    rotation = Rotation.from_quat(q, scalar_first=True)
    angles = q2euler(np.array(q))
    print(f"{q}, a turn by {np.degrees(rotation.magnitude()):.0f} degrees: q2euler {angles}")
    assert (angles == 0).all() and rotation.magnitude() > 2
    if abs(rotation.as_matrix()[2, 0]) < 1:  # pitch not 90 degrees
        assert (Rotation.from_euler("ZYX", q2rpy(np.array(q))[::-1]) * rotation.inv()).magnitude() < 1e-6
PY
