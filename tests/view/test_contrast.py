"""`twin.view`.

Lines can be seen on their ground, by the contrast that WCAG 2 asks of graphics: 3 to 1."""

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from twin.run.picture import RUN_COLOURS
from twin.view.recording import MECHANISM_GROUND, PLOT_GROUND
from twin.view.streams import BLACK, GREY, RUN_LINE_COLOURS, shade

LEAST = 3.0
WHITE = np.ones(3)


def luminance(colour):
    """Relative luminance of WCAG 2 of an sRGB colour, 0 to 1 each."""
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one, other):
    low, high = sorted((luminance(np.asarray(one)), luminance(np.asarray(other))))
    return (high + 0.05) / (low + 0.05)


def in_the_dark(colour):
    """A colour of a picture on a page in a dark browser: the page's filter, as CSS defines it."""
    page = files("twin.base").joinpath("page.html.j2").read_text(encoding="utf-8")
    dark = page[page.index("prefers-color-scheme: dark") :]
    (found,) = re.findall(r"svg \{ filter: invert\((.*?)\) hue-rotate\((.*?)deg\); \}", dark)
    share, angle = float(found[0]), np.radians(float(found[1]))
    weights = np.array([0.213, 0.715, 0.072])
    grey = np.tile(weights, (3, 1))
    across = np.array([weights * -1, [0.143, 0.140, -0.283], [-0.787, 0.715, 0.072]])
    across[0, 2] = 0.928
    turn = grey + np.cos(angle) * (np.eye(3) - grey) + np.sin(angle) * across
    inverted = share * (1 - np.asarray(colour)) + (1 - share) * np.asarray(colour)
    return np.clip(turn @ inverted, 0, 1)


def test_contrast_is_that_of_the_definition():
    assert contrast(WHITE, 0 * WHITE) == pytest.approx(21)
    assert contrast(to_rgb("#777777"), WHITE) == pytest.approx(4.48, abs=0.01)  # a known example
    assert in_the_dark(WHITE) == pytest.approx([0.1] * 3, abs=1e-3)


@pytest.mark.parametrize("colour", RUN_COLOURS)
def test_lines_of_pictures_are_seen_on_white_and_on_a_dark_page(colour):
    assert contrast(to_rgb(colour), WHITE) > LEAST
    assert contrast(in_the_dark(to_rgb(colour)), in_the_dark(WHITE)) > LEAST


def test_lines_of_pictures_differ_from_each_other_on_a_dark_page_too():
    for change in (np.asarray, in_the_dark):
        drawn = [change(to_rgb(colour)) for colour in RUN_COLOURS]
        assert min(np.linalg.norm(one - other) for one, other in combinations(drawn, 2)) > 0.15


@pytest.mark.parametrize("ground", [PLOT_GROUND, MECHANISM_GROUND])
def test_lines_of_the_viewer_are_seen_on_the_ground_that_they_bring(ground):
    shades = [shade(run, number) for run in range(len(RUN_LINE_COLOURS)) for number in (0, 1)]
    for colour in (*RUN_LINE_COLOURS, GREY, BLACK, *shades):
        assert contrast(np.array(colour) / 255, np.array(ground) / 255) > LEAST
