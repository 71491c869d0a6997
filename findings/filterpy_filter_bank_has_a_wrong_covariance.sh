#!/usr/bin/env bash
# filterpy 2.0.0, MMAEFilterBank.update, the bank of Kalman filters that weighs several models of a rig.
# Guess: P is the covariance of the mixture: the weighted sum of each P and of how far each estimate is from the mean.
#   A bank of twice the same filter has the P of that filter.
# Seen: x and the weights are right. P takes the entries of the mean one by one in the place of the mean, entry k with
#   filter k: a bank of twice the same filter of a ball at 200 mm has a variance of 0.02 m2 in the place of 1.4e-6 m2.
#   With more filters than entries of the state the last filters are left out of P. No warning.
# Do: IMMEstimator, whose P is right; or sum p (P + (x - mean)(x - mean)^T) over bank.filters.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import filterpy
import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter, MMAEFilterBank

PERIOD, PLACE = 0.02, 0.2  # s, m


def make_filter(noise=1.0):
    """Of a ball at constant speed, seen with 2 mm of noise."""
    made = KalmanFilter(2, 1)
    made.x = np.array([[PLACE], [0.0]])
    made.F = np.array([[1.0, PERIOD], [0.0, 1.0]])
    made.H = np.array([[1.0, 0.0]])
    made.Q = noise * np.diag([0.0, 1e-4])
    made.R = np.array([[4e-6]])
    made.P = np.diag([1e-4, 1e-2])
    return made


def make_bank(kind, filters):
    shares = [1 / len(filters)] * len(filters)
    if kind is MMAEFilterBank:
        return MMAEFilterBank(filters, shares, 2, H=filters[0].H)
    return IMMEstimator(filters, shares, np.full((len(filters), len(filters)), shares[0]))


def follow(each, places):
    for place in places:
        each.predict()
        each.update(np.array([[place]]))
    return each


def mix(bank, weights):
    away = [each.x - bank.x for each in bank.filters]
    return sum(w * (each.P + y @ y.T) for w, each, y in zip(weights, bank.filters, away))


places = PLACE + 0.002 * np.random.default_rng(0).standard_normal(50)
alone = follow(make_filter(), places)
twice = follow(make_bank(MMAEFilterBank, [make_filter(), make_filter()]), places)
print("filterpy", filterpy.__version__)
print(f"one filter: {alone.P[0, 0]:.1e} m2, a bank of it twice: {twice.P[0, 0]:.1e} m2")
assert np.allclose(twice.x, alone.x) and np.allclose(twice.p, 0.5)
assert alone.P[0, 0] < 4e-6 and twice.P[0, 0] > 0.015
entries = [each.x - entry for each, entry in zip(twice.filters, twice.x, strict=True)]
assert np.allclose(twice.P, sum(0.5 * (alone.P + y @ y.T) for y in entries))
three = follow(make_bank(MMAEFilterBank, [make_filter(), make_filter(), make_filter()]), places)
entries = [three.filters[k].x - three.x[k] for k in range(2)]
assert np.allclose(three.P, sum((alone.P + y @ y.T) / 3 for y in entries))
other = follow(make_bank(MMAEFilterBank, [make_filter(), make_filter(1.5)]), places)
right = follow(make_bank(IMMEstimator, [make_filter(), make_filter(1.5)]), places)
print(f"two models: bank {other.P[0, 0]:.1e}, its mixture {mix(other, other.p)[0, 0]:.1e}, IMM {right.P[0, 0]:.1e} m2")
assert other.P[0, 0] > 100 * mix(other, other.p)[0, 0]
assert np.allclose(right.P, mix(right, right.mu))
PY
