from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from twin.run.picture import COLOURS

CHAPTER_8 = Path(__file__).parents[2] / "docs" / "chapter8.py"


@pytest.mark.long
def test_lines_keep_their_colours_in_a_picture_of_few_colours(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(CHAPTER_8.parent)
    time = np.linspace(0, 25, 2000)
    page = run_path(str(CHAPTER_8))
    title = "Three laws, and the mechanism over them"
    with page["_drawn"](tmp_path / "few.png", 3, title, mechanism=True) as panels:
        for panel in panels.flat:
            for index, colour in enumerate(COLOURS[:3]):
                values = 10 * time * np.exp(-time * (index + 1) / 2) + np.sin(time / 3)
                panel.plot(time, values, color=colour)
                panel.plot(time, values, zorder=4, **page["MECHANISM"])
    with Image.open(tmp_path / "few.png") as picture:
        shown = np.array(picture.convert("RGB"), float).reshape(-1, 3)
    for colour in COLOURS[:3]:
        apart = np.abs(shown - 255 * np.array(to_rgb(colour))).max(axis=1)
        assert (apart <= 4).sum() > 50, colour
