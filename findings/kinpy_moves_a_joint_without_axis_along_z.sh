#!/usr/bin/env bash
# kinpy 0.6.1, build_chain_from_urdf and build_serial_chain_from_urdf of a joint without <axis> (yourdfpy 0.0.60 for
#   comparison).
# Guess: such a joint turns or slides along x, (1, 0, 0), the default that the specification of URDF gives.
# Seen: it moves along z, and a file without <axis>, as a joint along x is often written, gives other positions: the
#   tip of an arm that is lifted out of its plane stays in it. The Jacobian follows. With <axis> all is right. No
#   warning.
# Do: write <axis xyz="1 0 0"/> into the file.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet kinpy==0.6.1 yourdfpy==0.0.60 numpy==2.4.6
env/bin/python -W ignore - <<'PY'
import io
import logging
from importlib.metadata import version

import kinpy
import numpy as np
import yourdfpy

logging.disable()
X_AXIS = '<axis xyz="1 0 0"/>'
VALUE = 0.5  # rad or m


def arm(kind, axis):
    """URDF of a joint of this kind and a tip 0.2 m along y of its link."""
    return f"""<robot name="arm"><link name="base"/><link name="moved"/><link name="tip"/>
<joint name="joint" type="{kind}"><parent link="base"/><child link="moved"/>{axis}
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="moved"/><child link="tip"/><origin xyz="0 0.2 0"/></joint></robot>"""


def tip(urdf):
    """Position of the tip in m by kinpy, shape (3,)."""
    return kinpy.build_chain_from_urdf(urdf).forward_kinematics({"joint": VALUE})["tip"].pos


def others_tip(urdf):
    """Position of the tip in m by yourdfpy, shape (3,)."""
    model = yourdfpy.URDF.load(io.BytesIO(urdf.encode()))
    model.update_cfg({"joint": VALUE})
    return model.get_transform("tip", "base")[:3, 3]


sine, cosine = 0.2 * np.sin(VALUE), 0.2 * np.cos(VALUE)
print("kinpy", version("kinpy"))
for kind, along_x, along_z in (
    ("revolute", [0, cosine, sine], [-sine, cosine, 0]),
    ("prismatic", [VALUE, 0.2, 0], [0, 0.2, VALUE]),
):
    without, given, other = tip(arm(kind, "")), tip(arm(kind, X_AXIS)), others_tip(arm(kind, ""))
    print(f"{kind} without <axis>: tip at {without.round(4)} m, with x {given.round(4)}, yourdfpy {other.round(4)}")
    assert np.allclose(without, along_z) and np.allclose(given, along_x) and np.allclose(other, along_x)
serial = kinpy.build_serial_chain_from_urdf(arm("revolute", ""), "tip")
turning = serial.jacobian([VALUE])[3:, 0]
print("axis in the Jacobian:", turning)
assert np.allclose(turning, [0, 0, 1])
PY
