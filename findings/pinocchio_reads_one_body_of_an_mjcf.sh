#!/usr/bin/env bash
# Pinocchio 4.1.0 (pin), buildModelFromMJCF of a mechanism and a free ball (MuJoCo 4.0.0 for comparison).
# Guess: the model has all bodies of the file, as in MuJoCo, or the reader refuses what it cannot represent, as it
#   does with shell inertias. Gravity is that of <option gravity>.
# Seen: only the first child of <worldbody> is read. Plate and ball come back as the plate alone, 1 degree of freedom
#   in place of 7; with the ball first as the ball alone. Gravity is 9.81 m/s2 whatever the file says. No warning.
# Do: compare nv with MuJoCo's after loading, join the models of single bodies by appendModel, and set
#   model.gravity.linear.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pin==4.1.0 mujoco-core==4.0.0 numpy==2.4.6
env/bin/python - <<'PY'
import mujoco
import pinocchio

PLATE = """<body name="plate"><joint name="theta" axis="1 0 0"/>
    <geom type="box" size="0.2 0.2 0.005" mass="1"/></body>"""
BALL = """<body name="ball" pos="0 0 0.03"><freejoint name="free"/><geom size="0.02" mass="0.03"/></body>"""
MOON = 1.62  # m/s2


def models(bodies):
    text = f'<mujoco><option gravity="0 0 {-MOON}"/><worldbody>{bodies}</worldbody></mujoco>'
    with open("rig.xml", "w") as file:
        file.write(text)
    return mujoco.MjModel.from_xml_path("rig.xml"), pinocchio.buildModelFromMJCF("rig.xml")


print("Pinocchio", pinocchio.__version__, " MuJoCo", mujoco.__version__)
found, single = {}, []
for name, bodies in {"plate, ball": PLATE + BALL, "ball, plate": BALL + PLATE}.items():
    whole, read = models(bodies)
    single.append(read)
    mass = sum(each.mass for each in read.inertias)
    found[name] = (whole.nv, read.nv, list(read.names)[1:])
    print(
        f"{name}: MuJoCo nv {whole.nv}, {whole.body_mass.sum():.2f} kg, g {-whole.opt.gravity[2]}; "
        f"Pinocchio nv {read.nv}, {mass:.2f} kg, g {-read.gravity.linear[2]}"
    )
    assert whole.opt.gravity[2] == -MOON and read.gravity.linear[2] == -9.81
joined = pinocchio.appendModel(*single, 0, pinocchio.SE3.Identity())
print("joined by appendModel: nv", joined.nv)
assert joined.nv == 7
assert found == {"plate, ball": (7, 1, ["theta"]), "ball, plate": (7, 6, ["free"])}
PY
