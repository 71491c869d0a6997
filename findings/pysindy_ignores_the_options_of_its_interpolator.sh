#!/usr/bin/env bash
# pysindy 2.1.0, SINDy.simulate of a model with control inputs that are given as an array.
# Guess: interpolator_kws={"kind": "previous"} holds each command until the next, as the documentation has
#   these options for the interpolator, which is scipy's interp1d by default.
# Seen: without interpolator the options are not used and not checked. A cubic spline goes through the
#   commands: it reaches 1.2 where the commands are 1 and -1, and the simulation of an exact model is wrong.
# Do: give both, interpolator=scipy.interpolate.interp1d and its options with axis=0, or u as a function.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pysindy==2.1.0 numpy==2.3.5 scipy==1.17.1
env/bin/python - <<'PY'
import warnings
from importlib.metadata import version

warnings.filterwarnings("ignore", message="Last time point dropped")
import numpy as np
import pysindy
from scipy.interpolate import interp1d

PERIOD = 0.1
times = np.arange(0, 20, PERIOD)
u = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], size=20), 10)  # held for 1 s each
x = np.zeros_like(times)
for k in range(len(times) - 1):  # x' = u - x, exact for a held command
    x[k + 1] = np.exp(-PERIOD) * x[k] + (1 - np.exp(-PERIOD)) * u[k]
model = pysindy.SINDy(
    optimizer=pysindy.STLSQ(threshold=0.1), feature_library=pysindy.PolynomialLibrary(degree=1)
)
model.fit(x[:, None], t=PERIOD, u=u[:, None], x_dot=(u - x)[:, None])
assert np.allclose(model.coefficients(), [[0, -1, 1]])
SOLVER = {"method": "LSODA", "rtol": 1e-9, "atol": 1e-9, "max_step": 0.02}
HOLD = {"kind": "previous", "axis": 0, "fill_value": "extrapolate"}


def error(**interpolation):
    """Largest error of the simulated state."""
    found = model.simulate(x[:1], times, u=u[:, None], integrator_kws=SOLVER, **interpolation)
    return np.abs(found[:, 0] - x[:-1]).max()


print("pysindy", version("pysindy"))
default, ignored = error(), error(interpolator_kws=HOLD)
unchecked = error(interpolator_kws={"no such": "option"})
both = error(interpolator=interp1d, interpolator_kws=HOLD)
spline = interp1d(times, u, kind="cubic")(np.linspace(0, times[-1], 5000))
print(f"largest error: default {default:.4f}, options alone {ignored:.4f}, both {both:.1e}")
print(f"the spline reaches {spline.max():.2f}")
assert default == ignored == unchecked > 0.05
assert both < 1e-6
assert spline.max() > 1.2
PY
