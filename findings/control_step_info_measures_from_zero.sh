#!/usr/bin/env bash
# control 0.10.2, step_info of a logged step: its documentation takes "a time series of step response data".
# Guess: rise time and overshoot are those of the step, from where the log begins to where it ends: a ball that goes from
#   60 to 80 mm has the numbers of one that goes from 0 to 20 mm.
# Seen: all is measured from 0, also where the step does not begin there. The same motion has an overshoot of 16 % from 0
#   to 20 mm and of 4 % from 60 to 80 mm, settles in 2.7 and in 1.7 s, and from 80 to 60 mm has a rise time of 0. No
#   warning, and no argument for the first value, as MATLAB's stepinfo has.
# Do: step_info(y - y[0], t).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet control==0.10.2 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import control
import numpy as np

t = np.arange(0, 10, 0.01)
DAMPING, FREQUENCY = 0.5, 3.0  # rad/s
KEYS = "Overshoot", "RiseTime", "SettlingTime", "PeakTime"
unit = control.step_response(control.tf([FREQUENCY**2], [1, 2 * DAMPING * FREQUENCY, FREQUENCY**2]), t).outputs
exact = 100 * np.exp(-np.pi * DAMPING / np.sqrt(1 - DAMPING**2))
print("control", control.__version__, f" exact overshoot {exact:.1f} %")
seen = {}
for begin, step in ((0, 20), (60, 20), (80, -20)):
    seen[begin, step] = found = control.step_info(begin + step * unit, t)
    print(f"{begin} to {begin + step} mm: overshoot {found['Overshoot']:.1f} %, rise {found['RiseTime']:.2f} s, "
          f"settles in {found['SettlingTime']:.2f} s")
    moved = control.step_info(begin + step * unit - begin, t)
    assert all(np.isclose(moved[key], seen[0, 20][key]) for key in KEYS)
assert np.isclose(seen[0, 20]["Overshoot"], exact, atol=0.01)
assert np.isclose(seen[60, 20]["Overshoot"], exact * 20 / 80, atol=0.01)
assert seen[0, 20]["SettlingTime"] > 2.6 and seen[60, 20]["SettlingTime"] < 1.7
assert seen[80, -20]["RiseTime"] == 0
PY
