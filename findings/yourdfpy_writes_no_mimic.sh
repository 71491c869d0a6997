#!/usr/bin/env bash
# yourdfpy 0.0.60, URDF.write_xml_file of a gripper whose second finger follows the first by <mimic>.
# Guess: the written file is the robot that was read, perhaps without comments and what is no part of URDF: yourdfpy
#   reads <mimic> and moves the finger by it, and limits and dynamics of joints are written.
# Seen: <mimic> is not written. Read back, by this package or another, the second finger is a joint of its own that
#   stays open when the first closes, and the robot has 2 actuated joints in place of 1. So are <calibration>
#   and <safety_controller>. validate() of the new robot is True, and no warning.
# Do: edit the XML itself, or write joint.mimic into the tree of write_xml() before saving it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet yourdfpy==0.0.60 trimesh==5.2.0 numpy==2.4.6
cat > gripper.urdf <<'URDF'
<robot name="gripper">
  <link name="palm"/>
  <link name="left"/>
  <link name="right"/>
  <joint name="left_joint" type="prismatic">
    <parent link="palm"/>
    <child link="left"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="0.05" effort="20" velocity="0.2"/>
    <dynamics damping="3" friction="0.7"/>
  </joint>
  <joint name="right_joint" type="prismatic">
    <parent link="palm"/>
    <child link="right"/>
    <axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.05" effort="20" velocity="0.2"/>
    <mimic joint="left_joint" multiplier="1" offset="0.01"/>
    <calibration rising="0.02"/>
    <safety_controller soft_lower_limit="0.001" soft_upper_limit="0.049" k_position="10" k_velocity="10"/>
  </joint>
</robot>
URDF
env/bin/python -W ignore - <<'PY'
from importlib.metadata import version
from pathlib import Path

import yourdfpy


def fingers(file):
    """Actuated joints, and where both fingers are when the first is moved by 20 mm, in m."""
    robot = yourdfpy.URDF.load(file)
    assert robot.validate()
    robot.update_cfg({"left_joint": 0.02})
    return robot, [float(robot.get_transform(link, "palm")[1, 3]) for link in ("left", "right")]


robot, before = fingers("gripper.urdf")
robot.write_xml_file("written.urdf")
written, after = fingers("written.urdf")
print("yourdfpy", version("yourdfpy"))
print(f"read:    {robot.num_actuated_joints} actuated joint, fingers at {before} m")
print(f"written: {written.num_actuated_joints} actuated joints, fingers at {after} m")
kept = {tag: f"<{tag} " in Path("written.urdf").read_text() for tag in ("limit", "dynamics", "mimic", "calibration")}
kept["safety_controller"] = "<safety_controller " in Path("written.urdf").read_text()
print("in the written file:", kept)
assert robot.num_actuated_joints == 1 and before == [0.02, -0.03]
assert written.num_actuated_joints == 2 and after == [0.02, 0.0]
assert [tag for tag, there in kept.items() if there] == ["limit", "dynamics"]
PY
