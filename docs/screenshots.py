"""Regenerates the pictures of the view in this folder: python docs/screenshots.py.

Needs a Vulkan driver, which may be a software one (Debian: mesa-vulkan-drivers), and a minute.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from rerun.experimental import ViewerClient

from twin.base.errors import ViewError
from twin.base.jobs import wait_until
from twin.base.writing import write_whole
from twin.run.finished import run, save
from twin.run.opened import open_runs
from twin.scenario import load
from twin.view.recording import write
from twin.view.streams import TIMELINE_NAME
from twin.view.viewer import Opened, start_viewer

HERE = Path(__file__).parent
UNEVEN = ("plant.surface.spread_percent=40", "plant.surface.slope_deg=0.1", "baseline=false")
NEEDS = "it needs a Vulkan driver (Debian: mesa-vulkan-drivers)"
SIZE = (1600, 900)
"""Width and height of the viewer in points."""
WAIT = 30.0
"""Longest time in s for its starting and for its loading."""
SETTLE = 9.0
"""Seconds after which the viewer has loaded everything and its notices have faded."""
MENU = 36
"""Height of the viewer's own menu, which is cut off."""


@contextmanager
def headless(path: Path) -> Iterator[tuple[ViewerClient, str]]:
    """A viewer without a window that has loaded an ``.rrd`` file, and its address.

    Raises:
        ViewError: If it does not start, does not load the file, or ends by itself.
    """
    viewer = start_viewer("--headless", "--window-size", "{}x{}".format(*SIZE))
    try:
        client = _connect(viewer)
        client.open(str(path.resolve()))
        if not wait_until(lambda: _loaded(client), WAIT, 0.1):
            raise ViewError(f"the viewer did not load {path} within {WAIT:g} s")
        yield client, viewer.url
    except ConnectionError as error:
        raise ViewError(f"the viewer ended by itself; {NEEDS}") from error
    finally:
        viewer.close()


def _loaded(client: ViewerClient) -> bool:
    state = client.get_state()
    return not state.loading and any(each.timelines for each in state.recordings)


def _connect(viewer: Opened) -> ViewerClient:
    until = time.monotonic() + WAIT
    while viewer.process.poll() is None and time.monotonic() < until:
        try:
            client = ViewerClient.connect(viewer.url)
            client.get_state()
        except (RuntimeError, ValueError, OSError):
            time.sleep(0.1)
        else:
            return client
    raise ViewError(f"the viewer did not start; {NEEDS}")


def screenshot(recording: Path, picture: Path, at: float) -> None:
    """Save what the viewer shows of an ``.rrd`` file at a simulated time in s as a PNG file.

    Raises:
        ViewError: If the viewer does not start.
        RecordError: If the picture cannot be written.
    """
    with headless(recording) as (viewer, _):
        viewer.set_time(TIMELINE_NAME, duration=at, play_state="paused")
        time.sleep(SETTLE)
        write_whole(picture, lambda target: _take(viewer, target))


def _take(viewer: ViewerClient, target: Path) -> None:
    """Save the viewer's window without its menu."""
    viewer.save_screenshot(str(target.resolve()))
    with Image.open(target) as large:
        scale = large.width // SIZE[0]
        page = large.crop((0, scale * MENU, large.width, large.height)).convert("RGB")
        small = page.resize((SIZE[0], SIZE[1] - MENU), Image.Resampling.LANCZOS)
    small.save(target, optimize=True)


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
