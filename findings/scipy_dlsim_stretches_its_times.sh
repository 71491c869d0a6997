#!/usr/bin/env bash
# scipy 1.17.1, scipy.signal.dlsim of a sampled system with the times of the inputs.
# Guess: with times that are those of the samples, the answer is that without times: one output for each input.
# Seen: the number of steps is t[-1] / dt rounded down, and 0.3 / 0.1 is 2.9999999999999996: four inputs at 0, 0.1,
#   0.2 and 0.3 s give three outputs at 0, 0.15 and 0.3 s, of inputs that are interpolated to these times. So do 173
#   of the 498 lengths up to 499 at 10 Hz, and 61 at 100 Hz. A window that begins at 5 s is simulated from 0, with
#   inputs that are extrapolated from the first two: the second output is 51 in place of 1. No warning.
# Do: leave t out, and give the outputs the times of the inputs.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet scipy==1.17.1 numpy==2.4.6
env/bin/python - <<'PY'
import numpy as np
import scipy
from scipy.signal import dlsim, dlti

pulse = np.array([1.0, 0, 0, 0])
lag = dlti([1.0], [1.0, -0.5], dt=0.1)
_, right = dlsim(lag, pulse)
times, found = dlsim(lag, pulse, t=[0, 0.1, 0.2, 0.3])
later, window = dlsim(lag, pulse, t=5 + np.arange(4) / 10)
print("scipy", scipy.__version__)
print("without times:     ", right.ravel())
print("0, 0.1, 0.2, 0.3 s:", found.ravel(), "at", times)
print(f"5, 5.1, 5.2, 5.3 s: {len(window)} outputs from {later[0]} s on, the second {window[1, 0]:.1f}")


def short(rate):
    system = dlti([1.0], [1.0, -0.5], dt=1 / rate)
    return sum(len(dlsim(system, np.ones(n), t=np.arange(n) / rate)[0]) != n for n in range(2, 500))


counts = {rate: short(rate) for rate in (10, 100)}
print("lengths from 2 to 499 that lose a sample, by rate in Hz:", counts)
assert np.allclose(right.ravel(), [0, 1, 0.5, 0.25])
assert len(found) == 3 and np.allclose(times, [0, 0.15, 0.3]) and np.allclose(found.ravel(), [0, 1, 0.5])
assert counts == {10: 173, 100: 61}
assert len(window) > 50 and later[0] == 0 and abs(window[1, 0] - 51) < 1e-6
PY
