#!/usr/bin/env bash
# roboticstoolbox-python 1.5.0, a robot from a URDF with a joint whose axis is along none of x, y and z (scipy 1.17.1
#   for comparison).
# Guess: the joint turns about its axis and at an angle of 0 adds no rotation, as the specification of URDF says and as
#   for axes along x, y and z; an axis that the reader cannot represent is refused.
# Seen: the axis is taken for a rotation vector: at an angle of 0 the link is turned by 1 rad (57 degrees) about it, and
#   the joint then turns about the z of the turned frame. A tilt by 2 degrees, and an axis of "1 0.00001 0", as
#   CAD exports write it, do so. The lengths of all links stay, so that the picture looks like an arm. No warning.
# Do: put the tilt into the rpy of the origin and use axis "0 0 1" or another principal axis, with no digit elsewhere.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet roboticstoolbox-python==1.5.0 spatialmath-python==1.1.18 numpy==2.4.6 scipy==1.17.1
cat > read.py <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
import roboticstoolbox
from scipy.spatial.transform import Rotation

ARM = """<robot name="arm"><link name="base"/><link name="tip"/><joint name="joint" type="revolute">
<parent link="base"/><child link="tip"/><origin xyz="0 0 0" rpy="0 0 0"/><axis xyz="{}"/>
<limit lower="-3" upper="3" effort="10" velocity="10"/></joint></robot>"""
ANGLE = 0.7


def off(axis, angle):
    """Angle between the link and where the specification has it, in degrees."""
    Path("arm.urdf").write_text(ARM.format(" ".join(map(str, axis))))
    found = roboticstoolbox.Robot.URDF(str(Path("arm.urdf").resolve())).fkine([angle]).R
    right = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis))
    return np.degrees((Rotation.from_matrix(found) * right.inv()).magnitude())


print("roboticstoolbox-python", version("roboticstoolbox-python"))
errors = {}
for axis in ((1, 0, 0), (0, -1, 0), (0, 0, 1), (0.6, 0, 0.8), (0.0348995, 0, 0.9993908), (1, 0.00001, 0)):
    errors[axis] = off(axis, 0), off(axis, ANGLE)
    print(f"axis {axis}: off by {errors[axis][0]:.1f} degrees at 0, by {errors[axis][1]:.1f} at {ANGLE} rad")
principal = [axis for axis in errors if sum(map(bool, axis)) == 1]
assert len(principal) == 3 and all(max(errors[axis]) < 1e-5 for axis in principal)
others = [error for axis, error in errors.items() if axis not in principal]
assert all(abs(at_zero - np.degrees(1)) < 0.01 for at_zero, _ in others)
assert all(turned > 40 for _, turned in others)
PY
env/bin/python -W ignore read.py
