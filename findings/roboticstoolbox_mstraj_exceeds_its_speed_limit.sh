#!/usr/bin/env bash
# roboticstoolbox-python 1.5.0, mstraj with a limit of the speed, qdmax, and an acceleration time.
# Guess: no axis is faster than qdmax, which its page calls the maximum speed: the blends are where it accelerates from
#   rest and slows down.
# Seen: the first blend has half of the acceleration time for the whole distance that the straight part would cover in
#   it, and so has the last one. From rest this takes up to 1.5 times the speed: 1.44 with tacc=0.2 s, 1.34 with 0.5 s,
#   for a way of 2 at a limit of 1. Blends between segments keep the limit. No warning.
# Do: give qdmax two thirds of the limit, or add a via point next to each end; check abs(q.qd).max().
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet roboticstoolbox-python==1.5.0 spatialmath-python==1.1.18 numpy==2.4.6 scipy==1.17.1
env/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from roboticstoolbox import mstraj

WAY, LIMIT, STEP = np.array([[0.0], [2.0], [4.0]]), 1.0, 0.001
print("roboticstoolbox-python", version("roboticstoolbox-python"))
for acceleration_time, expected in ((0.2, 1.44), (0.5, 1.344)):
    motion = mstraj(WAY, dt=STEP, tacc=acceleration_time, qdmax=LIMIT)
    speeds = np.abs(np.diff(motion.q[:, 0])) / STEP
    middle = speeds[int(acceleration_time / STEP) : -int(acceleration_time / STEP)]
    print(f"tacc {acceleration_time} s: fastest {speeds.max():.3f}, between the ends {middle.max():.3f}, limit {LIMIT}")
    assert abs(speeds.max() - expected) < 0.01 and np.isclose(speeds.max(), np.abs(motion.qd).max(), rtol=1e-3)
    assert middle.max() <= LIMIT
PY
