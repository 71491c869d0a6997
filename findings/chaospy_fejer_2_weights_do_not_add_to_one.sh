#!/usr/bin/env bash
# chaospy 4.3.21, generate_quadrature with the rule "fejer_2", nested for Clenshaw-Curtis without the ends.
# Guess: as for every rule, the weights of a probability distribution add to 1, and a rule of order n is exact for
#   polynomials up to n: the mean of a constant is the constant.
# Seen: they add to 0.667, 0.889, 0.933, 0.960 and 0.971 for the orders 0 to 4, and to 0.994 for 11. So the mean of a
#   quantity that is 10 everywhere is 9.71 with 5 points, and its variance by E(x**2) - E(x)**2 is 2.8 in place of 0.
#   "fejer_1", "clenshaw_curtis" and "legendre" add to 1. No warning.
# Do: take "fejer_1" or "clenshaw_curtis", and check w.sum() of every rule.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet chaospy==4.3.21 numpoly==1.3.9 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
from importlib.metadata import version

import chaospy
import numpy as np

EVERYWHERE = 10.0
friction = chaospy.Uniform(0, 1)
print("chaospy", version("chaospy"))
sums = {}
for rule in ("fejer_2", "fejer_1", "clenshaw_curtis", "legendre"):
    weights = [chaospy.generate_quadrature(order, friction, rule=rule)[1] for order in range(12)]
    sums[rule] = np.array([each.sum() for each in weights])
    print(f"{rule}: sums of weights for the orders 0 to 11: {sums[rule].round(3).tolist()}")
_, weights = chaospy.generate_quadrature(4, friction, rule="fejer_2")
mean = float(weights.sum() * EVERYWHERE)
spread = float(weights.sum() * EVERYWHERE**2 - mean**2)
print(f"{EVERYWHERE} everywhere: mean {mean:.2f}, variance {spread:.2f}")
assert sums["fejer_2"].round(3).tolist()[:5] == [0.667, 0.889, 0.933, 0.96, 0.971]
assert (sums["fejer_2"] < 0.995).all()
assert all(np.allclose(sums[rule], 1) for rule in sums if rule != "fejer_2")
assert round(mean, 2) == 9.71 and round(spread, 1) == 2.8
PY
