#!/usr/bin/env bash
# rosbags 0.11.9 with rosbags-image 0.10.4, message_to_cvimage of a sensor_msgs/Image whose rows are padded.
# Guess: `step`, the length of a row in bytes, is followed, as sensor_msgs defines it: cameras and GPUs pad rows to 4,
#   32 or 64 bytes.
# Seen: the rows are taken for width times channels bytes. Each is shifted against the one above by the padding, and
#   the lowest rows are left out: a column of pixels becomes a slanted line. No warning, as the data are long enough.
# Do: where step is not width times channels, cut the rows first: data.reshape(height, step)[:, : width * channels].
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet rosbags==0.11.9 rosbags-image==0.10.4 opencv-python-headless==5.0.0.93 numpy==2.4.6
env/bin/python - <<'PY'
from dataclasses import replace
from importlib.metadata import version

import numpy as np
from rosbags.image import message_to_cvimage
from rosbags.typesys import Stores, get_typestore

HEIGHT, WIDTH, STEP = 6, 6, 8
types = get_typestore(Stores.ROS2_JAZZY).types
header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "camera")
picture = np.zeros((HEIGHT, WIDTH), np.uint8)
picture[:, 2] = 9
rows = np.zeros((HEIGHT, STEP), np.uint8)
rows[:, :WIDTH] = picture
padded = types["sensor_msgs/msg/Image"](header, HEIGHT, WIDTH, "mono8", 0, STEP, rows.ravel())
cut = replace(padded, step=WIDTH, data=padded.data.reshape(HEIGHT, STEP)[:, :WIDTH].ravel())
found, mended = message_to_cvimage(padded), message_to_cvimage(cut)
print("rosbags", version("rosbags"), " rosbags-image", version("rosbags-image"))
print(f"a line in column 2, rows of {STEP} bytes for {WIDTH} pixels:")
print(found)
assert np.array_equal(mended, picture)
assert found.shape == picture.shape
assert [np.flatnonzero(row).tolist() for row in found] == [[2], [4], [], [0], [2], [4]]
PY
