#!/usr/bin/env bash
# OpenCV 5.0.0 (opencv-python-headless 5.0.0.93), warpAffine, remap and resize with INTER_CUBIC (scipy 1.17.1 for
#   comparison).
# Guess: cubic interpolation is the more exact one for a shift by parts of a pixel, as scipy's of order 3 is, so that
#   a spot that is moved by 0.1 pixel has its centre 0.1 pixel further on.
# Seen: the centre moves by 0.136 pixel, and by 0.297 for 0.25: shifts between whole and half pixels are off by up to
#   0.048, alike for all spots, since the kernel (a = -0.75) does not reproduce a straight line. A ramp that is
#   enlarged four times has steps of 0.19, 0.24, 0.33 and 0.24 in place of 0.25. INTER_LINEAR is exact, INTER_LANCZOS4
#   is off by up to 0.027. An image that is undistorted with it, or enlarged to find a marker, has this error.
# Do: INTER_LINEAR where positions are measured, or undistort the points that were found in the raw image.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import cv2
import numpy as np
from scipy import ndimage

SIZE = 64
y, x = np.mgrid[:SIZE, :SIZE]
spot = np.exp(-((x - SIZE / 2) ** 2 + (y - SIZE / 2) ** 2) / (2 * 5.0**2)).astype(np.float32)
METHODS = {"linear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC, "Lanczos": cv2.INTER_LANCZOS4}


def moved(image):
    return float((image.astype(float) * x).sum() / image.astype(float).sum() - SIZE / 2)


def warped(shift, flags):
    return moved(cv2.warpAffine(spot, np.array([[1, 0, shift], [0, 1, 0]]), (SIZE, SIZE), flags=flags))


def remapped(shift, flags):
    return moved(cv2.remap(spot, (x - shift).astype(np.float32), y.astype(np.float32), flags))


print("OpenCV", cv2.__version__)
shifts = np.linspace(0, 1, 41)
worst = {}
for name, flags in METHODS.items():
    found = [warped(shift, flags) for shift in shifts]
    worst[name] = float(np.abs(found - shifts).max())
    print(f"{name}: 0.1 and 0.25 become {warped(0.1, flags):.3f}, {warped(0.25, flags):.3f}, worst {worst[name]:.3f}")
    assert np.allclose(found, [remapped(shift, flags) for shift in shifts], atol=2e-4)
scipy_worst = max(abs(moved(ndimage.shift(spot, (0, shift), order=3)) - shift) for shift in shifts)
print(f"scipy, order 3: worst {scipy_worst:.4f}")
ramp = cv2.resize(x.astype(np.float32), (4 * SIZE, SIZE), interpolation=cv2.INTER_CUBIC)[SIZE // 2]
steps = np.diff(ramp[100:105])
print("steps of an enlarged ramp:", steps.round(3))
assert abs(warped(0.1, cv2.INTER_CUBIC) - 0.136) < 1e-3 and abs(warped(0.25, cv2.INTER_CUBIC) - 0.297) < 1e-3
assert worst["linear"] < 1e-4 and abs(worst["cubic"] - 0.048) < 1e-3 and abs(worst["Lanczos"] - 0.027) < 1e-3
assert scipy_worst < 1e-3
assert np.allclose(np.sort(steps), [0.191, 0.238, 0.238, 0.332], atol=2e-3)
PY
