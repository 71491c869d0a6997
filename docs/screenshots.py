"""Regenerates the pictures of the view in this folder: python docs/screenshots.py.

Needs a Vulkan driver, which may be a software one (Debian: mesa-vulkan-drivers), and a minute.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

from twin.run.finished import open_runs, run, save
from twin.scenario import load
from twin.view.recording import screenshot, write

HERE = Path(__file__).parent
UNEVEN = ("plant.surface.spread_percent=40", "plant.surface.slope_deg=0.1", "baseline=false")


def main() -> None:
    """Run the circle, on an even screen and an uneven one, and take the pictures."""
    with TemporaryDirectory() as folder:
        root = Path(folder)
        for name, overrides in (("even-screen", ()), ("uneven-screen", UNEVEN)):
            done = run(load("circle", overrides))
            save(done, root / name, {name: done.motion})
        both = (root / "even-screen", root / "uneven-screen")
        for name, runs in (("view-showing.png", both[:1]), ("view-compare.png", both)):
            write(root / "view.rrd", open_runs(runs))
            screenshot(root / "view.rrd", HERE / name, at=7.0)


if __name__ == "__main__":
    main()
