#!/usr/bin/env bash
# mdfreader 4.3, Mdf.get_channel_data of integer samples with a table of ranges (conversion "value range to value");
#   the file is written by asammdf 8.8.28; mdfreader needs scipy (1.17.1) for it.
# Guess: the numbers of the table, which are doubles in the file, are returned as such, as those of a plain table ("value
#   to value", with or without interpolation) and of a linear conversion are.
# Seen: they are put into the array of the raw samples, with its type: 0.5 and 1.25 come back as 0 and 1. No warning. A
#   number that does not fit, such as 200 for raw samples of int8, ends in an OverflowError at opening, of the
#   whole file.
# Do: convert_after_read=False, and apply the table to samples that were made floats; asammdf has another
#   error here (asammdf_gives_integers_within_a_range_the_default.sh).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet mdfreader==4.3 asammdf==8.8.28 scipy==1.17.1
env/bin/python - <<'PY'
from importlib.metadata import version

import mdfreader
import numpy as np
from asammdf import MDF, Signal
from asammdf.blocks.conversion_utils import from_dict

RAW = [0, 5, 9, 10, 15]
RANGES = {"lower_0": 0, "upper_0": 9, "phys_0": 0.5, "lower_1": 10, "upper_1": 20, "phys_1": 1.25, "default": -1}
TABLE = {"raw_0": 0, "phys_0": 0.5, "raw_1": 15, "phys_1": 1.25, "interpolation": False}
print("mdfreader", version("mdfreader"))


def read(kind, conversion):
    """The samples of a channel with the conversion, as mdfreader returns them."""
    log = MDF()
    samples = np.array(RAW, dtype=kind)
    log.append(Signal(samples, np.arange(len(RAW)) * 0.1, name="gain", conversion=from_dict(conversion)))
    log.save("log.mf4", overwrite=True)
    return mdfreader.Mdf("log.mf4").get_channel_data("gain").tolist()


found = {kind: read(kind, RANGES) for kind in ("i1", "i4", "f8")}
table = read("i1", TABLE)
print(f"ranges of {RAW}: {found}")
print(f"table of {RAW} as i1: {table}")
assert table == [0.5, 0.5, 1.25, 1.25, 1.25]
assert found["f8"] == [0.5, 0.5, -1, 1.25, 1.25]
assert found["i1"] == found["i4"] == [0, 0, 0, 1, 1]
try:
    read("i1", RANGES | {"phys_1": 200.0})
    refused = False
except OverflowError as error:
    refused = True
    print("200 with i1:", error)
assert refused
PY
