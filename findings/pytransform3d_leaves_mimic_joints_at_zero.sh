#!/usr/bin/env bash
# pytransform3d 3.17.0, UrdfTransformManager of a robot with a joint that has <mimic> (yourdfpy 0.0.60 for comparison).
# Guess: such a joint follows the one that it names, by multiplier and offset, when that is set, as in yourdfpy, urchin and
#   MuJoCo; or the file is refused, as other errors in a URDF are.
# Seen: <mimic> is not read. The joint stays at 0 and is one to be set like any other: a camera that a linkage turns
#   back by the angle of the plate, so that it stays level, tilts with it. No warning.
# Do: set_joint for each mimic joint, with multiplier * angle + offset, after every set_joint of the other.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pytransform3d==3.17.0 lxml yourdfpy==0.0.60
cat >plate.urdf <<'XML'
<robot name="rig">
  <link name="base"/>
  <link name="plate"/>
  <link name="camera"/>
  <joint name="tilt" type="revolute">
    <parent link="base"/>
    <child link="plate"/>
    <axis xyz="0 1 0"/>
    <limit lower="-0.5" upper="0.5" effort="1" velocity="1"/>
  </joint>
  <joint name="level" type="revolute">
    <parent link="plate"/>
    <child link="camera"/>
    <origin xyz="0.1 0 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-0.5" upper="0.5" effort="1" velocity="1"/>
    <mimic joint="tilt" multiplier="-1"/>
  </joint>
</robot>
XML
env/bin/python - <<'PY'
import warnings
from importlib.metadata import version

import numpy as np
from pytransform3d.urdf import UrdfTransformManager
from yourdfpy import URDF

ANGLE = 0.3
print("pytransform3d", version("pytransform3d"), "yourdfpy", version("yourdfpy"))


def tilt(frame):
    """The angle about y of a frame in rad."""
    return np.arctan2(frame[0, 2], frame[0, 0])


with warnings.catch_warnings():
    warnings.simplefilter("error")
    frames = UrdfTransformManager()
    with open("plate.urdf") as file:
        frames.load_urdf(file.read())
    frames.set_joint("tilt", ANGLE)
    before = tilt(frames.get_transform("camera", "base"))
    frames.set_joint("level", -ANGLE)
    after = tilt(frames.get_transform("camera", "base"))
robot = URDF.load("plate.urdf")
robot.update_cfg({"tilt": ANGLE})
other = tilt(robot.get_transform("camera", "base"))
print(f"tilt {ANGLE} rad; camera by pytransform3d {before:.3f}, by hand {after:.3f}; by yourdfpy {other:.3f} rad")
assert abs(other) < 1e-9 and abs(after) < 1e-9
assert abs(before - ANGLE) < 1e-9
PY
