#!/usr/bin/env bash
# python-control 0.10.2, the third result of stability_margins, for loops in continuous time.
# Guess: it is the minimum distance of the Nyquist plot from -1, as its page says: the inverse of the largest
#   sensitivity, and never above 1 for a loop whose gain falls to 0 at high frequencies.
# Seen: only minima between the ends of the frequency axis count, where the distance has a derivative of 0. A ball in a
#   magnetic levitation, unstable without control, is closest to -1 at frequency 0: the distance is 0.2 and the result
#   inf, or 0.99 with a resonance at 30 rad/s. A plain lag gives inf in place of 1. No warning.
# Do: take the minimum of this result, abs(1 + L(0)) and, for a gain that falls to 0, 1.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet control==0.10.2 numpy==2.4.6 scipy==1.17.1
env/bin/python -W error - <<'PY'
import control
import numpy as np

s = control.tf("s")
levitated = 1.2 * (1 + s) / ((s**2 - 1) * (1 + 0.005 * s))
loops = {
    "lag": 1 / (s + 1),
    "levitated ball": levitated,
    "levitated ball, resonance": levitated * (1 + 0.02 * s**2 / (s**2 + 0.6 * s + 900)),
}
omega = np.concatenate([[0], np.geomspace(1e-4, 1e5, 200_000)])
found = {}
print("control", control.__version__)
for name, loop in loops.items():
    assert (control.feedback(loop, 1).poles().real < 0).all()
    distance = float(np.abs(1 + loop(1j * omega)).min())
    found[name] = round(distance, 3), round(float(control.stability_margins(loop)[2]), 2)
    print(f"{name}: minimum distance {distance:.3f}, stability_margins {found[name][1]}")
assert found["lag"] == (1.0, np.inf)
assert found["levitated ball"] == (0.2, np.inf)
assert found["levitated ball, resonance"] == (0.2, 0.99)
PY
