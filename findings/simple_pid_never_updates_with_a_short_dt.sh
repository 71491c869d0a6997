#!/usr/bin/env bash
# simple-pid 2.0.1, PID called with the time step of a simulation: pid(measurement, dt=0.002).
# Guess: its documentation offers dt for simulations and computes an output if sample_time has passed since the
#   last one. With the default sample_time of 0.01 s every fifth call does, or with dt each.
# Seen: dt itself is compared with sample_time, and the time since the last update is not added up. With a
#   step below 0.01 s the first output is returned for ever: the loop runs open, without a warning.
# Do: PID(..., sample_time=None) wherever dt is given.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet simple-pid==2.0.1
env/bin/python - <<'PY'
from importlib.metadata import version

from simple_pid import PID

STEP, END = 0.002, 5.0


def simulated(**settings):
    """The last output of a first-order plant (0.5 s) under PI control, and how many commands differ."""
    pid = PID(2.0, 4.0, 0.0, setpoint=1.0, **settings)
    y, commands = 0.0, set()
    for _ in range(round(END / STEP)):
        u = pid(y, dt=STEP)
        commands.add(u)
        y += STEP * (u - y) / 0.5
    return y, len(commands)


print("simple-pid", version("simple-pid"))
default, each = simulated(), simulated(sample_time=None)
print(f"default sample_time:  output {default[0]:.3f} for a setpoint of 1, {default[1]} command(s) in 5 s")
print(f"sample_time=None:     output {each[0]:.3f} for a setpoint of 1, {each[1]} commands")
assert default[1] == 1 and abs(default[0] - 2.008) < 1e-3
assert each[1] > 100 and abs(each[0] - 1) < 1e-3
PY
