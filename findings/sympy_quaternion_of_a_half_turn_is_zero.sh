#!/usr/bin/env bash
# SymPy 1.14.0, Quaternion.from_rotation_matrix of half turns (scipy 1.17.1 for comparison).
# Guess: a matrix that is orthogonal with determinant 1 becomes a unit quaternion that turns as it does, as the page
#   says; with exact numbers there is no rounding to fear.
# Seen: every half turn becomes 0 + 0 i + 0 j + 0 k: the three parts get their signs from differences of elements, which
#   are 0 for a half turn, and sign(0) is 0. So does a turn by a symbol in which pi is set later, and a matrix of floats
#   that is symmetric. No warning; the quaternion turns every vector into nan.
# Do: go by way of scipy's Rotation.from_matrix, or by Quaternion.from_axis_angle where the axis is known.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet sympy==1.14.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import numpy as np
import sympy
from scipy.spatial.transform import Rotation
from sympy import Matrix, Quaternion, Rational, cos, eye, pi, sin

AXES = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (Rational(3, 5), 0, Rational(4, 5)), (Rational(1, 3),) + (Rational(2, 3),) * 2]
ZERO = Quaternion(0, 0, 0, 0)


def half_turn(axis):
    """Exact rotation matrix of a half turn about a unit vector."""
    column = Matrix(axis)
    return 2 * column * column.T - eye(3)


print("sympy", sympy.__version__)
for axis in AXES:
    matrix = half_turn(axis)
    assert matrix * matrix.T == eye(3) and matrix.det() == 1
    found = Quaternion.from_rotation_matrix(matrix)
    other = Rotation.from_matrix(np.array(matrix, float)).as_quat(scalar_first=True)
    print("half turn about", axis, "->", found, "- scipy:", other.round(4))
    assert found == ZERO and Quaternion.from_rotation_matrix(matrix.evalf()).norm() == 0
    assert Quaternion.from_axis_angle(axis, pi).to_rotation_matrix() == matrix
    assert np.allclose(np.abs(other), [0, *map(float, axis)])

angle = sympy.Symbol("angle", real=True)
about_x = Matrix([[1, 0, 0], [0, cos(angle), -sin(angle)], [0, sin(angle), cos(angle)]])
symbolic = Quaternion.from_rotation_matrix(about_x)
print("about x by pi / 2 and pi:", *(symbolic.subs(angle, each) for each in (pi / 2, pi)))
assert symbolic.subs(angle, pi) == ZERO and symbolic.subs(angle, pi / 2).norm() == 1
turned = Quaternion.rotate_point((0, 0, 1), ZERO)
print("a vector turned by it:", turned)
assert all(each is sympy.nan for each in turned)
PY
