#!/usr/bin/env bash
# MuJoCo 4.0.0, actuator pid with slewmax, a keyframe with qpos and ctrl.
# Guess: an arm that is reset to a keyframe whose command is its angle stays there, as it does with a position
#   servo and a pid without slewmax: nothing changes, so there is no rate to limit.
# Seen: the limited setpoint is an activation that a keyframe without act sets to 0. The servo drives the arm
#   from 1 rad to 0.06 rad, and the arm is back at 1 rad at the end, 4 s later. No warning.
# Do: give the keyframe act="..." with the command.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet mujoco==4.0.0 numpy==2.4.6
env/bin/python - <<'PY'
import mujoco


def held(actuator, act=""):
    """The smallest and the last angle in 4 s after a reset to 1 rad with a command of 1 rad."""
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
      <worldbody>
        <body>
          <joint name="arm" axis="0 1 0"/>
          <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.5"/>
        </body>
      </worldbody>
      <actuator>{actuator}</actuator>
      <keyframe><key qpos="1" ctrl="1" {act}/></keyframe>
    </mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    angles = []
    for _ in range(2000):
        mujoco.mj_step(model, data)
        angles.append(data.qpos[0])
    return min(angles), angles[-1]


GAINS = 'joint="arm" kp="50" kv="2"'
LIMITED = f'<pid {GAINS} input="pos" slewmax="0.5"/>'
cases = {
    "position": held(f"<position {GAINS}/>"),
    "pid": held(f'<pid {GAINS} input="pos"/>'),
    "pid with slewmax": held(LIMITED),
    "pid with slewmax and act": held(LIMITED, 'act="1"'),
}
print("MuJoCo", mujoco.__version__)
for name, (least, last) in cases.items():
    print(f"{name}: smallest angle {least:.3f} rad, at the end {last:.3f} rad")
position, pid, limited, mended = cases.values()
assert position == pid == mended == (1, 1)
assert limited[0] < 0.1 and abs(limited[1] - 1) < 1e-6
PY
