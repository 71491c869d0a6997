#!/usr/bin/env bash
# python-control 0.10.2, model_reduction(sys, states, method="truncate") of a discrete-time system.
# Guess: the reduced model has the sampling time of the model, as with modred in MATLAB. Its documentation
#   says of discrete time that the method "matchdc" is not implemented.
# Seen: the result is a system of continuous time, dt = 0, with the matrices of the sampled one. Its poles,
#   0.9 and 0.5, now are unstable ones; the gain at rest changes its sign, and no warning comes.
# Do: make the system again, control.ss(r.A, r.B, r.C, r.D, sys.dt).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet control==0.10.2 numpy==2.4.6 scipy==1.17.1
env/bin/python -W error - <<'PY'
import control
import numpy as np

model = control.ss(np.diag([0.9, 0.5, 0.01]), np.ones((3, 1)), np.ones((1, 3)), 0, 0.1)
reduced = control.model_reduction(model, [2], method="truncate")
again = control.ss(reduced.A, reduced.B, reduced.C, reduced.D, model.dt)
print("control", control.__version__)
for name, each in {"model": model, "reduced": reduced, "made again": again}.items():
    response = control.step_response(each, np.arange(0, 5.05, 0.1))
    print(f"{name}: dt {each.dt}, gain {each.dcgain():.2f}, step response after 5 s {response.outputs[-1]:.1f}")
assert model.dt == again.dt == 0.1
assert reduced.dt == 0
assert model.dcgain() > 0 and reduced.dcgain() < 0
assert np.isclose(again.dcgain(), 12) and np.isclose(model.dcgain(), 12 + 1 / 0.99)
assert response.outputs[-1] < 13
PY
