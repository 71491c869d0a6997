"""The moving picture of the README: honest twin, clean model and cure on the same circle.

uv run python docs/moving.py
"""

from pathlib import Path

import ballplate as bp

if __name__ == "__main__":
    done = bp.run("circle", beside="cure")
    done.export(Path(__file__).parent / "circle.webp", until=16, seconds=8)
