#!/usr/bin/env bash
# Pinocchio 4.1.0 (pin), buildModelFromMJCF of a body whose geom is a mesh (MuJoCo 4.0.0 for comparison).
# Guess: without <inertial>, mass and inertia come from the geoms, meshes included, as in MuJoCo; for boxes, spheres
#   and cylinders they are equal. Or the reader refuses the mesh, as it refuses shell inertias.
# Seen: a mesh counts as 1 kg with a moment of inertia of 1 kg m2 about the place of the geom, whatever its size, its
#   density and the mass of the geom are. An arm of 0.2 kg has 1000 times its inertia about its axis. No warning.
# Do: write <inertial> for each body with a mesh: save the file as MuJoCo compiled it, by mj_saveLastXML with
#   saveinertial="true" in <compiler>.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pin==4.1.0 mujoco-core==4.0.0 numpy==2.4.6
cat > arm.obj <<'OBJ'
v 0 0 0
v 0.1 0 0
v 0 0.2 0
v 0 0 0.3
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
OBJ
env/bin/python - <<'PY'
import mujoco
import numpy as np
import pinocchio

RIG = """<mujoco><compiler saveinertial="true"/><asset><mesh name="arm" file="arm.obj"/></asset><worldbody>
  <body name="arm"><joint name="angle" axis="0 0 1"/>{geom}</body></worldbody></mujoco>"""


def inertias(geom):
    """Mass and inertia about the joint's axis, of MuJoCo, of Pinocchio, and of Pinocchio by <inertial>."""
    with open("rig.xml", "w") as file:
        file.write(RIG.format(geom=geom))
    model = mujoco.MjModel.from_xml_path("rig.xml")
    mujoco.mj_saveLastXML("saved.xml", model)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = [(model.body_mass[1], data.M[0])]
    for path in ("rig.xml", "saved.xml"):
        read = pinocchio.buildModelFromMJCF(path)
        found.append((read.inertias[1].mass, pinocchio.crba(read, read.createData(), np.zeros(1))[0, 0]))
    return np.array(found)


print("Pinocchio", pinocchio.__version__, " MuJoCo", mujoco.__version__)
box = inertias('<geom type="box" size="0.1 0.05 0.02" mass="0.2"/>')
mesh = inertias('<geom type="mesh" mesh="arm" mass="0.2"/>')
dense = inertias('<geom type="mesh" mesh="arm" density="500"/>')
for name, found in {"box of 0.2 kg": box, "mesh of 0.2 kg": mesh, "mesh of 500 kg/m3": dense}.items():
    told = ["{:.4f} kg, {:.6f} kg m2".format(*each) for each in found]
    print(f"{name}: MuJoCo {told[0]}; Pinocchio {told[1]}; as saved {told[2]}")
assert np.allclose(box, box[0]) and np.isclose(box[0, 0], 0.2)
for found in (mesh, dense):
    assert np.allclose(found[1], [1, 1]) and np.allclose(found[2], found[0], rtol=1e-4)
assert np.isclose(mesh[0, 0], 0.2) and np.isclose(mesh[1, 1] / mesh[0, 1], 1000, rtol=1e-3)
PY
