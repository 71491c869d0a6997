#!/usr/bin/env bash
# numpy-quaternion 2024.0.13, mean_rotor_in_chordal_metric (scipy 1.17.1 for comparison).
# Guess: the mean of attitudes does not depend on the signs of the quaternions, as q and -q are one rotation: the
#   package interpolates (slerp) and measures rotations (rotation_intrinsic_distance) without regard to the sign.
#   Its page has the closest one to all in the least-squares sense, and asks for normalized input alone.
# Seen: the numbers are added as they are. Trackers, ROS and scipy's canonical form keep w positive, so that the sign
#   changes at a half turn: headings of 175 and 185 degrees have the mean 0 in place of 180, and twelve headings from
#   170 to 192 have 1 in place of 181. optimal_alignment_in_chordal_metric, which takes this mean, follows. No warning.
# Do: unflip_rotors before, for a series in time, or scipy's Rotation.mean, which is right for any signs.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet numpy-quaternion==2024.0.13 numpy==2.3.5 scipy==1.17.1
env/bin/python -W ignore - <<'PY'
import numpy as np
import quaternion
from scipy.spatial.transform import Rotation


def means(headings):
    """By numpy-quaternion, after unflip_rotors, and by scipy, as headings in degrees from 0 to 360."""
    attitudes = Rotation.from_rotvec(np.radians(headings)[:, None] * [0, 0, 1])
    numbers = attitudes.as_quat(canonical=True, scalar_first=True)
    assert (numbers[:, 0] >= 0).all()
    rotors = quaternion.as_quat_array(numbers)
    unflipped = quaternion.unflip_rotors(rotors)
    found = [quaternion.mean_rotor_in_chordal_metric(each) for each in (rotors, unflipped)]
    vectors = [*(quaternion.as_rotation_vector(each) for each in found), attitudes.mean().as_rotvec()]
    return [float(np.degrees(vector[2]) % 360) for vector in vectors]


print("numpy-quaternion", quaternion.__version__)
two, twelve, away = means([175, 185]), means(np.linspace(170, 192, 12)), means([5, 15])
for name, found in {"175 and 185": two, "170 to 192": twelve, "5 and 15": away}.items():
    print(f"{name} degrees: mean {found[0]:.2f}, unflipped {found[1]:.2f}, scipy {found[2]:.2f}")
assert min(two[0], 360 - two[0]) < 1e-6 and np.allclose(two[1:], 180)
assert abs(twelve[0] - 1) < 1e-6 and np.allclose(twelve[1:], 181)
assert np.allclose(away, 10)
turned = Rotation.from_rotvec([[0, 0, angle] for angle in np.radians([175, 185])])
Ra = quaternion.as_quat_array(turned.as_quat(canonical=True, scalar_first=True))
aligned = quaternion.optimal_alignment_in_chordal_metric(Ra, np.array([quaternion.one, quaternion.one]))
print("alignment of 175 and 185 degrees with 0:", float(np.degrees(aligned.angle()).round(2)), "degrees")
assert aligned.angle() < 1e-6
PY
