#!/usr/bin/env bash
# scipy 1.17.1, scipy.signal.lsim with times that begin later than 0, such as a window of a log.
# Guess: X0 is the state at the first of the times: its page calls it the initial conditions on the state vector, and
#   T the times at which the input is defined and the output desired.
# Seen: X0 is the state at time 0, and lsim first simulates from there to the first time without input. For a lag
#   of 1 s and a window that begins at 5 s, a start of 1 has become 0.0067. No warning; a fit of the start to such a
#   window finds it 148 times too large.
# Do: give lsim t - t[0].
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet scipy==1.17.1 numpy==2.4.6
env/bin/python - <<'PY'
import numpy as np
import scipy
from scipy.signal import lsim

t, none = 5 + np.arange(4) * 0.25, np.zeros(4)
lag = ([-1.0], [1.0], [1.0], [0.0])
_, late, _ = lsim(lag, none, t, X0=[1.0])
_, moved, _ = lsim(lag, none, t - t[0], X0=[1.0])
print("scipy", scipy.__version__)
print("times         ", t)
print("lsim          ", late.round(5))
print("lsim, t - t[0]", moved.round(5))
assert np.allclose(moved, np.exp(-(t - 5)))
assert np.allclose(late, np.exp(-t))
PY
