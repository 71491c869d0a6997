#!/usr/bin/env bash
# asammdf 8.8.28, MDF.get of integer samples with a table of ranges (conversion "value range to value").
# Guess: a raw value from the lower to the upper end of a range has its number, others the default; of integers both ends
#   belong to the range, of floats the lower one alone (ASAM MDF 4.1).
# Seen: of a range from 0 to 9 the integer 9 alone has its number, 0 to 8 have the default: the upper ends are searched
#   as if they were lower ones. Integers above all ranges have the number of the last one. So a gain or a state that
#   belongs to a range of codes is its default most of the time. Floats are right. No warning.
# Do: MDF.get(..., raw=True) and the ranges of signal.conversion, or raw samples as floats with upper ends raised by 1.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet asammdf==8.8.28
env/bin/python - <<'PY'
import asammdf
import numpy as np
from asammdf import MDF, Signal
from asammdf.blocks.conversion_utils import from_dict

RAW = [0, 5, 8, 9, 10, 15, 20, 25]
RANGES = {"lower_0": 0, "upper_0": 9, "phys_0": 0.5, "lower_1": 10, "upper_1": 20, "phys_1": 1.25, "default": -1}
print("asammdf", asammdf.__version__)
found = {}
for kind in ("u1", "i2", "i8", "f8"):
    samples = np.array(RAW, dtype=kind)
    log = MDF()
    log.append(Signal(samples, np.arange(len(RAW)) * 0.1, name="gain", conversion=from_dict(RANGES)))
    log.save("log.mf4", overwrite=True)
    with MDF("log.mf4") as read:
        assert read.get("gain", raw=True).samples.tolist() == RAW
        found[kind] = read.get("gain").samples.tolist()
    print(f"{RAW} as {kind}: {found[kind]}")
expected_of_integers = [0.5, 0.5, 0.5, 0.5, 1.25, 1.25, 1.25, -1]
assert found["f8"] == [0.5, 0.5, 0.5, -1, 1.25, 1.25, -1, -1]
for kind in ("u1", "i2", "i8"):
    assert found[kind] == [-1, -1, -1, 0.5, -1, -1, 1.25, 1.25] != expected_of_integers
PY
