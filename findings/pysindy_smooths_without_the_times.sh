#!/usr/bin/env bash
# pysindy 2.1.0, SmoothedFiniteDifference with times that are not quite even (FiniteDifference for comparison).
# Guess: times are given for that: FiniteDifference, of which it is a kind, uses each of them and is as exact with
#   uneven times as with even ones, and smoothing makes the result better.
# Seen: the smoothing counts samples and does not see the times. With stamps that are off by up to 1 % of the period the
#   error of the derivative of a smooth signal grows 26 times, with 10 % 300 times; one sample that is missing gives an
#   error of 7 % beside it. So the jitter of a log, which FiniteDifference takes without loss, becomes noise, and a
#   larger one than the noise that was to be smoothed. No warning.
# Do: interpolate to even times before, or FiniteDifference of signals that were filtered with their times.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pysindy==2.1.0 numpy==2.3.5 scipy==1.17.1
env/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from pysindy import FiniteDifference, SmoothedFiniteDifference

PERIOD, SAMPLES, RATE = 0.01, 500, 3.0  # s, 1, rad/s
jitter = np.random.default_rng(0).uniform(-1, 1, SAMPLES)


def errors(method, times):
    """Of the derivative of a sine away from the ends."""
    found = method()(np.sin(RATE * times)[:, None], times)[:, 0]
    return (found - RATE * np.cos(RATE * times))[10:-10]


def rms(method, part):
    return float(np.sqrt(np.mean(errors(method, PERIOD * (np.arange(SAMPLES) + part * jitter)) ** 2)))


print("pysindy", version("pysindy"))
growth = {}
for method in (FiniteDifference, SmoothedFiniteDifference):
    growth[method] = {part: rms(method, part) / rms(method, 0) for part in (0.01, 0.1)}
    print(f"{method.__name__}: even {rms(method, 0):.1e}, off by 1 and 10 %:", list(growth[method].values()), "times")
gap = np.delete(PERIOD * np.arange(SAMPLES), SAMPLES // 2)
missing = {method: float(np.abs(errors(method, gap)).max() / RATE) for method in growth}
print("one sample missing, error in parts of the amplitude:", list(missing.values()))
assert all(abs(times - 1) < 0.01 for times in growth[FiniteDifference].values())
assert 20 < growth[SmoothedFiniteDifference][0.01] < 32 and 250 < growth[SmoothedFiniteDifference][0.1] < 360
assert missing[FiniteDifference] < 3e-4 and 0.06 < missing[SmoothedFiniteDifference] < 0.075
PY
