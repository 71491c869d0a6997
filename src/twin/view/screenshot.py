"""Pictures of the view as a person would see it, made without a screen."""

from __future__ import annotations

import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from twin.run.record import write_whole
from twin.view.streams import TIMELINE
from twin.view.viewer import headless

SETTLE = 9.0
"""Seconds after which the viewer has loaded everything and its notices have faded."""

MENU = 36
"""Height of the viewer's own menu, which is cut off."""


def screenshot(
    recording: Path, picture: Path, at: float, size: tuple[int, int] = (1600, 900)
) -> None:
    """Save what the viewer shows of a recording.

    Args:
        recording: The ``.rrd`` file.
        picture: The PNG file to write.
        at: Simulated time in s to show.
        size: Width and height in points.

    Raises:
        ViewError: If the viewer does not start.
        RecordError: If the picture cannot be written.
    """
    with headless(recording, size) as viewer:
        viewer.set_time(TIMELINE, duration=at, play_state="paused")
        time.sleep(SETTLE)
        write_whole(picture, lambda target: _take(viewer, target, size))


def _take(viewer: ViewerClient, target: Path, size: tuple[int, int]) -> None:
    """Save the viewer's window without its menu."""
    viewer.save_screenshot(str(target.resolve()))
    with Image.open(target) as large:
        scale = large.width // size[0]
        page = large.crop((0, scale * MENU, large.width, large.height)).convert("RGB")
        small = page.resize((size[0], size[1] - MENU), Image.Resampling.LANCZOS)
    small.save(target, optimize=True)
