"""Makes gallery.md and its thumbnails: each picture by the command that stands below it.

uv run python docs/gallery.py
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from docs.pages import HERE, filled, planned, write

WIDTH, HEIGHT = 320, 200
COLUMNS = 2
PICTURES = planned("gallery")["pictures"]


def thumbnail(picture: Path, name: str) -> None:
    """A picture, the middle frame of a moving one, small on white."""
    with Image.open(picture) as image:
        image.seek(getattr(image, "n_frames", 1) // 2)
        whole = image.convert("RGBA")
    paper = Image.new("RGBA", whole.size, "white")
    paper.alpha_composite(whole)
    paper.thumbnail((WIDTH, HEIGHT), Image.Resampling.LANCZOS)
    small = Image.new("RGB", (WIDTH, HEIGHT), "white")
    small.paste(paper, ((WIDTH - paper.width) // 2, (HEIGHT - paper.height) // 2))
    small.quantize(128).save(HERE / "figures" / f"gallery-{name}.png", optimize=True)


def main() -> None:
    """Run every command once, in one folder, and write the page."""
    with TemporaryDirectory() as folder:
        before = ""
        for each in PICTURES:
            picture = HERE / each["page"] if "page" in each else Path(folder) / each["file"]
            if "page" not in each and each["command"] != before:
                _, *arguments = shlex.split(each["command"])
                subprocess.run([sys.executable, "-m", "twin", *arguments], cwd=folder, check=True)
                before = each["command"]
            thumbnail(picture, each["name"])
    rows = [PICTURES[at : at + COLUMNS] for at in range(0, len(PICTURES), COLUMNS)]
    write(HERE / "gallery.md", filled("gallery", rows=rows, columns=COLUMNS))


if __name__ == "__main__":
    main()
