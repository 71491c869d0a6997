#!/usr/bin/env bash
# advanced-pid 0.0.8, PID(Kp, Ki, Kd, Tf): Tf is the time constant of the filter of the derivative.
# Guess: the shorter the filter, the closer the derivative to the true one; of an error that grows by 1 a second the
#   output of Kd = 2 is 2 once the filter has settled, whatever Tf and the step are: Kd s / (Tf s + 1) has this limit.
# Seen: the error of the end of a step is taken for that of the whole step, so that the filter has nearly reached it
#   when the difference is taken. Settled, the output is Kd a / (exp(a) - 1) with a = step / Tf: 5 % too small with Tf
#   of 10 steps, 42 % with one step, and nothing with a tenth of a step or with Tf=0. A ball on a plate, a double
#   integrator, so swings for ever at 100 Hz with a filter of 1 ms, and comes to rest with one of 30 ms. No warning.
# Do: Tf of 10 steps or more, or multiply Kd by (exp(a) - 1) / a.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet advanced-pid==0.0.8
env/bin/python - <<'PY'
import warnings
from importlib.metadata import version
from math import exp

from advanced_pid import PID

warnings.simplefilter("error")
STEP = 0.01
print("advanced-pid", version("advanced-pid"))


def derivative(filter_time):
    """The settled output of Kd = 2 alone for an error that grows by 1 in a second; 2 by the difference."""
    pid = PID(Kp=0.0, Ki=0.0, Kd=2.0, Tf=filter_time)
    return [pid(k * STEP, k * STEP) for k in range(2000)][-1]


def amplitude(filter_time):
    """The largest deviation in m in the last 5 of 20 s of a ball that begins 0.1 m beside its setpoint."""
    pid = PID(Kp=1.0, Ki=0.0, Kd=1.5, Tf=filter_time)
    x, v, late = 0.1, 0.0, 0.0
    for k in range(2000):
        v += STEP * pid(k * STEP, -x)
        x += STEP * v
        late = max(late, abs(x)) if k >= 1500 else late
    return late


found = {filter_time: (derivative(filter_time), amplitude(filter_time)) for filter_time in (0.1, 0.03, 0.01, 1e-3, 0.0)}
for filter_time, (output, late) in found.items():
    print(f"Tf = {filter_time * 1000:3g} ms: derivative {output:.3f} in place of 2, ball at the end within {late:.2g} m")
    a = STEP / filter_time if filter_time else float("inf")
    assert abs(output - (2 * a / (exp(a) - 1) if filter_time else 0)) < 1e-6
assert 1.89 < found[0.1][0] < 1.91
assert 1.15 < found[0.01][0] < 1.18
assert found[1e-3][0] < 0.002
assert found[1e-3][1] > 0.09 and found[0.03][1] < 1e-3
PY
