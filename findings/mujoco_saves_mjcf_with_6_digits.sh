#!/usr/bin/env bash
# MuJoCo 4.0.0, mj_saveLastXML and MjSpec.to_xml.
# Guess: a model that is saved as MJCF and loaded again is the same one: the manual says that all real-valued parameters
#   are copied, and from the same state comes the same motion, as it does with mj_saveModel.
# Seen: numbers are written with 6 digits, like printf's %g. A double pendulum of 0.3 m that was saved is off by 0.3 rad
#   within 5 s and has nothing to do with the original after 10 s. A body at x = 691234.56, as in a map's coordinates,
#   comes back 0.44 m beside its place, and two bodies 0.3 m apart there at one place. No warning.
# Do: mj_saveModel and MjModel.from_binary_path for an exact copy; keep the XML from which the model was made; put the
#   origin of a scene near to it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet mujoco-core==4.0.0 numpy==2.4.6
env/bin/python - <<'PY'
import mujoco
import numpy as np

PENDULUM = """<mujoco><option timestep="0.002" integrator="RK4"/><worldbody><body>
<joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.3217654" size="0.02" mass="0.1234567"/>
<body pos="0 0 -0.3217654"><joint axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2345678" size="0.02" mass="0.2345678" contype="0" conaffinity="0"/>
</body></body></worldbody></mujoco>"""
MAP = """<mujoco><worldbody><geom size="0.1" pos="691234.56 0 0"/><geom size="0.1" pos="691234.86 0 0"/>
</worldbody></mujoco>"""


def saved(model, spec):
    """The model by way of MJCF, and by way of a binary file."""
    mujoco.mj_saveLastXML("saved.xml", model)
    mujoco.mj_saveModel(model, "saved.mjb")
    by_xml, by_spec = mujoco.MjModel.from_xml_path("saved.xml"), mujoco.MjModel.from_xml_string(spec.to_xml())
    assert (by_xml.geom_pos == by_spec.geom_pos).all() and (by_xml.body_mass == by_spec.body_mass).all()
    return by_xml, mujoco.MjModel.from_binary_path("saved.mjb")


def loaded(text):
    spec = mujoco.MjSpec.from_string(text)
    spec.compile()
    return mujoco.MjModel.from_xml_string(text), spec


def swung(model, seconds=15):
    data, angles = mujoco.MjData(model), []
    data.qpos[:] = 2, 2.5
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        angles.append(data.qpos.copy())
    return np.array(angles)


print("MuJoCo", mujoco.__version__)
model, spec = loaded(PENDULUM)
by_xml, binary = saved(model, spec)
right, steps = swung(model), round(5 / model.opt.timestep)
apart = {}
for name, other in {"MJCF": by_xml, "binary file": binary}.items():
    parts = np.abs(swung(other) - right).max(1)
    apart[name] = [float(parts[steps * n : steps * (n + 1)].max()) for n in range(3)]
print(f"masses {model.body_mass[1:]}, saved as MJCF {by_xml.body_mass[1:]}")
print("largest difference in 0 to 5, 5 to 10 and 10 to 15 s, in rad:", apart)
scene, spec = loaded(MAP)
again, _ = saved(scene, spec)
print("places on the map:", scene.geom_pos[:, 0], "saved:", again.geom_pos[:, 0])
assert by_xml.body_mass[1:].tolist() == [0.123457, 0.234568]
assert 0.01 < apart["MJCF"][0] < 1 < apart["MJCF"][2] and apart["binary file"] == [0, 0, 0]
assert again.geom_pos[:, 0].tolist() == [691235.0, 691235.0]
PY
