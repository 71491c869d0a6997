#!/usr/bin/env bash
# urchin 0.0.30, URDF.load and URDF.save of a robot with links that are only frames (MuJoCo 4.0.0 reads both files).
# Guess: the saved file is the robot that was loaded. A link without <inertial>, as base, tool and sensor frames are
#   written, has no mass: that is what the specification of URDF says.
# Seen: each such link is saved with a mass of 1 kg and moments of inertia of 1 kg m2. A plate of 0.2 kg that carries
#   a camera frame 0.1 m above it weighs 1.2 kg afterwards and has 300 times its moment of inertia about the axis; it
#   then tilts that much more slowly. No warning.
# Do: edit the XML itself, or delete the <inertial> of these links in the saved file.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet urchin==0.0.30 mujoco==4.0.0
cat >plate.urdf <<'XML'
<robot name="rig">
  <link name="base"/>
  <link name="plate">
    <inertial>
      <mass value="0.2"/>
      <inertia ixx="0.0033" iyy="0.0033" izz="0.0066" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="camera"/>
  <joint name="tilt" type="revolute">
    <parent link="base"/>
    <child link="plate"/>
    <axis xyz="0 1 0"/>
    <limit lower="-0.3" upper="0.3" effort="1" velocity="1"/>
  </joint>
  <joint name="mount" type="fixed">
    <parent link="plate"/>
    <child link="camera"/>
    <origin xyz="0 0 0.1"/>
  </joint>
</robot>
XML
env/bin/python - <<'PY'
from importlib.metadata import version

import mujoco
import numpy as np
import urchin

print("urchin", version("urchin"), "MuJoCo", mujoco.__version__)
robot = urchin.URDF.load("plate.urdf")
robot.save("saved.urdf")
mass, inertia = {}, {}
for name in ("plate", "saved"):
    model = mujoco.MjModel.from_xml_path(f"{name}.urdf")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    mass[name], inertia[name] = model.body_mass.sum(), full[0, 0]
    print(f"{name}.urdf: {mass[name]:.2f} kg move, {inertia[name]:.4f} kg m2 about the axis")
assert np.isclose(mass["plate"], 0.2) and np.isclose(inertia["plate"], 0.0033)
assert np.isclose(mass["saved"], 1.2)
assert np.isclose(inertia["saved"], 0.0033 + 1.0 + 1.0 * 0.1**2)
PY
