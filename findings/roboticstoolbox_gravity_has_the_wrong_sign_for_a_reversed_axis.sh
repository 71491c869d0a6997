#!/usr/bin/env bash
# roboticstoolbox-python 1.5.0, rne and gravload of a robot from a URDF with a joint axis such as "0 -1 0".
# Guess: the torque has the sign of the joint: gravload is the derivative of the potential energy by the joint's angle,
#   as it is for an axis of "0 1 0". fkine and jacob0 of the same robot follow the sign of the axis.
# Seen: for axes along -x, -y and -z the torque of gravity has the wrong sign, so that a controller that adds it doubles
#   the load in place of carrying it. In a chain, the torques by velocities of the joints before are wrong in
#   size, too. The mass matrix of one joint is right, as its sign cancels. No warning.
# Do: change the axis to the positive one and the sign of the angle, or turn the origin by 180 degrees.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet roboticstoolbox-python==1.5.0 spatialmath-python==1.1.18 numpy==2.4.6 scipy==1.17.1
cat > hold.py <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
import roboticstoolbox

LINK = """<link name="link{0}"><inertial><origin xyz="0.3 0.05 -0.02"/><mass value="1.5"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.025"/></inertial></link>
<joint name="joint{0}" type="revolute"><parent link="{1}"/><child link="link{0}"/>
<origin xyz="0.3 0.1 0.2" rpy="0.5 0.3 0.1"/><axis xyz="{2}"/>
<limit lower="-3" upper="3" effort="90" velocity="10"/></joint>"""
CENTRE, MASS, GRAVITY, STEP = np.array([0.3, 0.05, -0.02]), 1.5, 9.81, 1e-6


def arm(*axes):
    links = [LINK.format(n, f"link{n - 1}" if n else "base", axis) for n, axis in enumerate(axes)]
    Path("arm.urdf").write_text(f'<robot name="arm"><link name="base"/>{"".join(links)}</robot>')
    return roboticstoolbox.Robot.URDF(str(Path("arm.urdf").resolve()))


def energy(robot, angles):
    """Potential energy by the robot's own forward kinematics, in J."""
    poses = [robot.fkine(angles, end=f"link{n}") for n in range(robot.n)]
    return sum(MASS * GRAVITY * (pose.R @ CENTRE + pose.t)[2] for pose in poses)


def torques(*axes):
    """Torque of gravity by gravload, and by the derivative of the energy, in N m."""
    robot, angles = arm(*axes), np.array([0.4, 0.3])[: len(axes)]
    steps = STEP * np.eye(len(axes))
    right = [(energy(robot, angles + step) - energy(robot, angles - step)) / (2 * STEP) for step in steps]
    return robot.gravload(angles), np.array(right)


print("roboticstoolbox-python", version("roboticstoolbox-python"))
for axes in (["1 0 0"], ["0 1 0"], ["0 0 1"], ["-1 0 0"], ["0 -1 0"], ["0 0 -1"], ["0 1 0", "0 -1 0"]):
    found, right = torques(*axes)
    print(f"{axes}: gravload {found.round(3)}, by the energy {right.round(3)}")
    signs = np.array([-1 if "-" in axis else 1 for axis in axes])
    assert np.allclose(found, signs * right, atol=1e-4) and np.abs(right).min() > 0.1
PY
env/bin/python -W ignore hold.py
