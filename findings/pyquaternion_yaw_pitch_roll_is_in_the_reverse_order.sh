#!/usr/bin/env bash
# pyquaternion 0.9.9, Quaternion.yaw_pitch_roll (scipy 1.17.1 for comparison).
# Guess: the angles are those of its page: intrinsic, first about z, then y', then x'', so that R = Rz Ry Rx, as in
#   aviation and as scipy's as_euler("ZYX"). The page also says R = Rx Ry Rz, which is the reverse order.
# Seen: R = Rx Ry Rz is what holds: intrinsic about x, y', z''. For one axis both are equal. A plate that is tilted by
#   10 and 20 degrees after a turn by 90 has pitch 10 and roll -20 in place of 20 and 10; the angles of small tilts
#   differ by their product. No warning.
# Do: scipy's Rotation.from_quat([*q.vector, q.scalar]).as_euler("ZYX"), or take the angles as those of x, y', z''.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pyquaternion==0.9.9 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation

X, Y, Z = np.eye(3)


def turn(axis, degrees):
    return Quaternion(axis=axis, degrees=degrees)


def angles(q):
    """Yaw, pitch and roll in degrees."""
    return np.degrees(q.yaw_pitch_roll)


print("pyquaternion", version("pyquaternion"))
plate = turn(Z, 90) * turn(Y, 20) * turn(X, 10)
scipys = Rotation.from_quat([*plate.vector, plate.scalar])
assert np.allclose(scipys.as_matrix(), plate.rotation_matrix)
print("yaw 90, pitch 20, roll 10 degrees come back as", angles(plate).round(2))
print("scipy, ZYX:", scipys.as_euler("ZYX", degrees=True).round(2))
assert np.allclose(scipys.as_euler("ZYX", degrees=True), [90, 20, 10])
assert np.allclose(angles(plate), [90, 10, -20])
for axis, expected in ((Z, [30, 0, 0]), (Y, [0, 30, 0]), (X, [0, 0, 30])):
    assert np.allclose(angles(turn(axis, 30)), expected)
reverse = turn(X, 10) * turn(Y, 20) * turn(Z, 90)
print("about x by 10, then y' by 20, then z'' by 90 come back as", angles(reverse).round(2))
assert np.allclose(angles(reverse), [90, 20, 10])
rng = np.random.default_rng(0)
for _ in range(1000):
    q = Quaternion(rng.normal(size=4)).normalised
    yaw, pitch, roll = q.yaw_pitch_roll
    assert np.allclose(Rotation.from_euler("XYZ", [roll, pitch, yaw]).as_matrix(), q.rotation_matrix)
PY
