#!/usr/bin/env bash
# python-control 0.10.2, eigensys_realization (era) of an impulse_response of a sampled system.
# Guess: with dt given, which its documentation has for the unit-area impulse response of this package, the
#   model that made the response comes back.
# Seen: B is multiplied by dt, D is not: the feedthrough is 1/dt times too large. A lag of 1 s sampled at 10 ms
#   by Tustin's method, which has one, comes back with a gain of 1.49 in place of 1. No warning.
# Do: multiply D by dt, or take the Markov parameters, response.outputs * dt, and give dt to the model after.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet control==0.10.2 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import control
import numpy as np

PERIOD = 0.01
model = control.ss(control.sample_system(control.tf([1], [1, 1]), PERIOD, "tustin"))
response = control.impulse_response(model, np.arange(300) * PERIOD)
found, _ = control.eigensys_realization(response, 1, dt=PERIOD)
mended = control.ss(found.A, found.B, found.C, found.D * PERIOD, PERIOD)
print("control", control.__version__)
for name, each in {"model": model, "found": found, "D times dt": mended}.items():
    print(f"{name}: pole {each.poles()[0].real:.5f}, D {each.D.item():.5f}, gain {each.dcgain():.4f}")
assert np.isclose(found.poles(), model.poles())
assert np.isclose(found.D * PERIOD, model.D) and model.D > 0
assert np.isclose(model.dcgain(), 1) and np.isclose(mended.dcgain(), 1)
assert np.isclose(found.dcgain(), 1.4925, atol=1e-4)
PY
