#!/usr/bin/env bash
# modern_robotics 1.1.1, MatrixLog3 (and MatrixLog6, which calls it); scipy 1.17.1 for comparison.
# Guess: the logarithm of a rotation matrix turns by the matrix, to within 1e-7 or so, also next to a half turn, for
#   which it has a case of its own.
# Seen: that case is taken only if rounding puts the trace at or below -1. Of 1000 half turns about random axes, 128
#   come back as another rotation, off by up to 180 degrees. Short of a half turn by 1e-6 rad the result is off by up
#   to 1e-3 rad, by 1e-7 rad up to 0.1 rad. No warning. So a path that turns a tool around is wrong for one axis and
#   right for the next.
# Do: scipy's Rotation.from_matrix(R).as_rotvec(), which is right for all of them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet modern_robotics==1.1.1 numpy==2.4.6 scipy==1.17.1
env/bin/python -W error - <<'PY'
from importlib.metadata import version

import numpy as np
from modern_robotics import MatrixLog3, so3ToVec
from scipy.spatial.transform import Rotation

rng = np.random.default_rng(0)
axes = rng.normal(size=(1000, 3))
axes /= np.linalg.norm(axes, axis=1, keepdims=True)


def errors(short):
    """Angles in rad between turns about the axes and what two libraries make of their matrices, shape (1000,)."""
    turns = Rotation.from_rotvec((np.pi - short) * axes)
    matrices = turns.as_matrix()
    assert np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max() < 1e-14
    logs = [so3ToVec(MatrixLog3(each)) for each in matrices]
    others = Rotation.from_matrix(matrices).as_rotvec()
    return [(Rotation.from_rotvec(each) * turns.inv()).magnitude() for each in (logs, others)]


print("modern_robotics", version("modern_robotics"))
wrong = {}
for short in (0.0, 1e-7, 1e-6, 1e-3):
    log, other = errors(short)
    wrong[short] = int((log > np.radians(1)).sum()), float(log.max())
    print(
        f"half turn less {short:g} rad: MatrixLog3 off by > 1 deg for {wrong[short][0]} axes, by up to "
        f"{wrong[short][1]:.2g} rad; scipy by {other.max():.1g} rad"
    )
    assert other.max() < 1e-7
assert 100 < wrong[0.0][0] < 160 and wrong[0.0][1] > 3
assert 0.01 < wrong[1e-7][1] < 1 and 1e-4 < wrong[1e-6][1] < 1e-2
assert wrong[1e-3][1] < 1e-8
PY
