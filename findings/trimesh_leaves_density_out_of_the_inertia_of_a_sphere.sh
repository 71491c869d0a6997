#!/usr/bin/env bash
# trimesh 5.2.0, moment_inertia of the primitives Sphere and Cylinder whose density is set.
# Guess: density scales the moments of inertia as it scales the mass, as for a mesh and for the primitives Box and
#   Capsule: a steel ball of 20 mm radius has 2/5 m r**2.
# Seen: the mass follows, the moments of inertia of spheres and cylinders stay those of a density of 1: 7850 times too
#   small for steel in kg and m. So do principal_inertia_components and the inertia in another frame.
#   mass_properties of the same object is right. No warning.
# Do: take mass_properties.inertia, or multiply by the density.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet trimesh==5.2.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import numpy as np
import trimesh
from trimesh.primitives import Box, Capsule, Cylinder, Sphere

STEEL = 7850.0  # kg/m3
parts = {
    "sphere": Sphere(radius=0.02, subdivisions=4),
    "cylinder": Cylinder(radius=0.02, height=0.3, sections=128),
    "capsule": Capsule(radius=0.02, height=0.3, sections=128),
    "box": Box([0.1, 0.2, 0.3]),
}
print("trimesh", trimesh.__version__)
ratios = {}
for name, part in parts.items():
    part.density = STEEL
    mesh = trimesh.Trimesh(part.vertices, part.faces)
    mesh.density = STEEL
    assert np.isclose(part.mass, mesh.mass)
    ratios[name] = part.moment_inertia[0, 0] / mesh.moment_inertia[0, 0]
    print(f"{name}: mass {part.mass:.3f} kg, moment of inertia {ratios[name]:.3g} times that of its mesh")
    assert np.isclose(part.mass_properties.inertia[0, 0], mesh.moment_inertia[0, 0])
    principal = part.principal_inertia_components.max() / mesh.principal_inertia_components.max()
    assert np.isclose(principal, ratios[name], rtol=5e-3)
ball = parts["sphere"]
right = 2 / 5 * STEEL * 4 / 3 * np.pi * 0.02**3 * 0.02**2
print(f"sphere: {ball.moment_inertia[0, 0]:.3g} kg m2; 2/5 m r**2 is {right:.3g}")
assert np.isclose(ball.moment_inertia[0, 0], right / STEEL)
assert all(np.isclose(ratios[name] * STEEL, 1, rtol=5e-3) for name in ("sphere", "cylinder"))
assert all(np.isclose(ratios[name], 1, rtol=5e-3) for name in ("capsule", "box"))
PY
