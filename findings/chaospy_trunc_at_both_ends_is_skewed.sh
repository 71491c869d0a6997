#!/usr/bin/env bash
# chaospy 4.3.21, Trunc of a distribution at both ends (scipy 1.17.1 for comparison).
# Guess: Trunc(Normal(0, 1), lower=-1, upper=1), a dimension whose parts beyond the tolerance were sorted out, has the
#   density of the normal one between the limits and 0 beyond, so that its samples have the mean that E returns, 0.
# Seen: the probabilities are divided by (1 - F(lower)) F(upper) in place of F(upper) - F(lower). The samples lean to
#   the upper limit: at 1 sigma their mean is 0.036 and their deviation 0.561 in place of 0.540, at 0.5 sigma 0.100 and
#   0.323 in place of 0.284, a fifth of them at the limit itself. E and Std are right, and so disagree with the samples.
#   A limit at one end alone is right. No warning.
# Do: TruncNormal(lower, upper, mu, sigma), or truncate twice: Trunc(Trunc(d, lower=a), upper=b).
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
from scipy.stats import truncnorm

PROBABILITIES = (np.arange(10_000) + 0.5) / 10_000  # of samples without chance
normal = chaospy.Normal(0, 1)


def samples(distribution):
    return distribution.inv(PROBABILITIES)


print("chaospy", version("chaospy"))
found = {}
for limit in (1.0, 0.5):
    both = chaospy.Trunc(normal, lower=-limit, upper=limit)
    twice = chaospy.Trunc(chaospy.Trunc(normal, lower=-limit), upper=limit)
    true = truncnorm(-limit, limit)
    drawn = samples(both)
    at_limit = float((drawn >= limit - 1e-9).mean())
    found[limit] = round(float(drawn.mean()), 3), round(float(drawn.std()), 3), round(at_limit, 2)
    print(
        f"limits of {limit}: samples have mean {drawn.mean():.3f}, deviation {drawn.std():.3f}, {at_limit:.0%} at the "
        f"limit; E {chaospy.E(both):.3f}, Std {chaospy.Std(both):.3f}; true deviation {true.std():.3f}"
    )
    assert abs(chaospy.E(both)) < 1e-6 and abs(chaospy.Std(both) - true.std()) < 1e-6
    named = chaospy.TruncNormal(lower=-limit, upper=limit, mu=0, sigma=1)
    for other in (twice, named):
        assert abs(samples(other).mean()) < 1e-6 and abs(samples(other).std() - true.std()) < 1e-4
one = samples(chaospy.Trunc(normal, upper=1.0))
assert abs(one.mean() - truncnorm(-np.inf, 1.0).mean()) < 1e-3
assert found == {1.0: (0.036, 0.561, 0.04), 0.5: (0.1, 0.323, 0.2)}
PY
