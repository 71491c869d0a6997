#!/usr/bin/env bash
# ikpy 4.2.1 and yourdfpy 0.0.60, a URDF whose joint axes are not of length 1 (scipy 1.17.1 for comparison).
# Guess: the axis is a direction: "1 1 0" and "0.577 0.577 0.577", as people write a diagonal, turn and move a link by
#   the angle and the way of the joint. The specification says that the vector should be normalized; Pinocchio, MuJoCo,
#   Drake, urchin and pytransform3d do it, and so does yourdfpy for joints that turn.
# Seen: ikpy puts the vector into the formula for unit vectors, whose result is no rotation: with "1 1 0" a link of 1 m
#   is 1.73 m long at 90 degrees, with "0.577 0.577 0.577" its tip is off by 1 mm. Both move a prismatic joint by the
#   way times the length of the axis: with "0 1 1" by 0.28 m in place of 0.2. No warning.
# Do: write axes with 16 digits and length 1, or normalize the file before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet ikpy==4.2.1 yourdfpy==0.0.60 trimesh==5.2.0 numpy==2.4.6 scipy==1.17.1
env/bin/python -W ignore - <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
from ikpy.chain import Chain
from scipy.spatial.transform import Rotation
from yourdfpy import URDF

ROBOT = """<robot name="arm"><link name="base"/><link name="moved"/><link name="tip"/>
<joint name="joint" type="{}"><parent link="base"/><child link="moved"/><axis xyz="{}"/>
<limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="end" type="fixed"><parent link="moved"/><child link="tip"/><origin xyz="1 0 0"/></joint></robot>"""
QUARTER, WAY = np.pi / 2, 0.2


def tips(kind, axis, position):
    """Of the link of 1 m by ikpy, by yourdfpy and by hand."""
    Path("arm.urdf").write_text(ROBOT.format(kind, axis))
    chain = Chain.from_urdf_file("arm.urdf", base_elements=["base"])
    robot = URDF.load("arm.urdf")
    robot.update_cfg([position])
    direction = np.fromstring(axis, sep=" ")
    direction /= np.linalg.norm(direction)
    turned = Rotation.from_rotvec(position * direction).apply([1, 0, 0])
    right = turned if kind == "revolute" else np.array([1, 0, 0]) + position * direction
    return chain.forward_kinematics([0, position, 0])[:3, 3], robot.get_transform("tip", "base")[:3, 3], right


print("ikpy", version("ikpy"), "yourdfpy", version("yourdfpy"))
off, length = {}, {}
for kind, axis in (
    ("revolute", "0 0 1"),
    ("revolute", "0.577 0.577 0.577"),
    ("revolute", "1 1 0"),
    ("prismatic", "0 1 0"),
    ("prismatic", "0 1 1"),
):
    by_ikpy, by_yourdfpy, right = tips(kind, axis, QUARTER if kind == "revolute" else WAY)
    off[kind, axis] = [float(np.linalg.norm(found - right)) for found in (by_ikpy, by_yourdfpy)]
    length[axis] = float(np.linalg.norm(by_ikpy))
    print(f"{kind}, axis {axis}: ikpy off by {off[kind, axis][0]:.4f} m, yourdfpy by {off[kind, axis][1]:.4f} m")
print(f"length of the link by ikpy, axis 1 1 0: {length['1 1 0']:.3f} m")
assert all(max(off[unit]) < 1e-9 for unit in (("revolute", "0 0 1"), ("prismatic", "0 1 0")))
assert 5e-4 < off["revolute", "0.577 0.577 0.577"][0] < 2e-3 and abs(length["1 1 0"] - np.sqrt(3)) < 1e-6
assert all(off["revolute", axis][1] < 1e-9 for axis in ("0.577 0.577 0.577", "1 1 0"))
assert np.allclose(off["prismatic", "0 1 1"], WAY * (np.sqrt(2) - 1))
PY
