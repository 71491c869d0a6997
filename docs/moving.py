"""The moving pictures of the pages: the same circle from above, and the mechanism in 3D.

``circle.webp`` shows honest twin, clean model and cure; ``mechanism.webp`` the cure, drawn by
MuJoCo, which needs EGL or OSMesa.

uv run python docs/moving.py
"""

from pathlib import Path

import ballplate as bp

if __name__ == "__main__":
    docs = Path(__file__).parent
    bp.run("circle", beside="cure").export(docs / "circle.webp", until=16, seconds=8)
    bp.run("cure").export(docs / "mechanism.webp", until=16, seconds=8, render="mujoco")
