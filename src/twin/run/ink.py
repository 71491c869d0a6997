"""Colours and pen of moving pictures, in software: smooth lines, and letters.

The fonts are those that matplotlib brings, none of the system, which is another on each machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import chain
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from controllers.arrays import Array

FINE = 3
"""Pixels that are drawn for each of the picture, along x and y: edges become smooth."""

Colour = tuple[int, int, int]
Point = tuple[float, float]
Box = tuple[float, float, float, float]
"""Left, top, right, bottom."""
CARD, GROUND, BLACK = (240, 243, 246), (255, 255, 255), (0, 0, 0)
DARK, GREY, RIM, PATH, FAINT = (
    (31, 41, 51),
    (91, 103, 114),
    (143, 155, 166),
    (186, 195, 203),
    (224, 229, 233),
)
ALPHAS = 8
"""Colours of the palette that are left for the picture's corners, through which a page is seen."""


def mix(one: Colour, other: Colour, share: float) -> Colour:
    """A colour with a share of another one."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(one, other, strict=True))
    return red, green, blue


def palette(own: Sequence[Colour]) -> Image.Image:
    """All colours with the tones at their edges: one for all frames keeps a picture small.

    Args:
        own: The colours of the runs.
    """
    inks = [*own, DARK, GREY, RIM, PATH, FAINT]
    tones = [share / 9 for share in range(9)]
    colours = {mix(ink, on, tone) for ink in inks for on in (GROUND, CARD) for tone in tones}
    # what is nearly one of the grounds would be taken for it, all over the picture
    colours = {each for each in colours if math.dist(each, GROUND) > 9 < math.dist(each, CARD)}
    colours |= {GROUND, CARD, *(mix(each, BLACK, share) for each in own for share in (0.12, 0.3))}
    assert len(colours) <= 256 - ALPHAS
    found = Image.new("P", (1, 1))
    found.putpalette([*chain.from_iterable(sorted(colours))])
    return found


def rounded(frames: Iterator[Image.Image], radius: float) -> Iterator[Image.Image]:
    """Frames of a palette with round corners, through which a page is seen.

    Args:
        frames: The frames, all of one size.
        radius: Of the corners, ``FINE`` to a pixel.
    """
    for frame in frames:
        beyond, corners = _corners(frame.size, radius)
        frame.paste(corners, mask=beyond)
        colours = np.full((256, 4), (*CARD, 255))
        known = np.reshape(frame.getpalette() or [], (-1, 3))[: 256 - ALPHAS]
        colours[: len(known), :3] = known
        colours[-ALPHAS:, 3] = np.arange(ALPHAS) * 255 // ALPHAS
        frame.putpalette(colours.ravel().tolist(), "RGBA")
        yield frame


@cache
def _corners(size: tuple[int, int], radius: float) -> tuple[Image.Image, Image.Image]:
    """Where corners are, and with which of the last colours."""
    card = Image.new("L", (FINE * size[0], FINE * size[1]), 0)
    edges = (0, 0, card.width - 1, card.height - 1)
    ImageDraw.Draw(card).rounded_rectangle(edges, radius, 255)
    alpha = card.reduce(FINE)
    tones = alpha.point([256 - ALPHAS + share * ALPHAS // 256 for share in range(256)])
    corners = Image.frombytes("P", size, tones.tobytes())
    return alpha.point([255] * 255 + [0]), corners


class Pen:
    """Draws onto a part of a picture, in the lengths of its layout.

    Args:
        image: The part, with ``FINE`` pixels for each of the picture.
        scale: Pixels of the image for each length.
        corner: Where the part begins, in pixels of the image.
    """

    def __init__(self, image: Image.Image, scale: float, corner: Point = (0, 0)) -> None:
        self._draw, self._scale, self._corner = ImageDraw.Draw(image), scale, np.array(corner)

    def _placed(self, points: Array) -> Array:
        placed: Array = points * self._scale - self._corner
        return placed

    def line(self, points: Array, colour: Colour, width: float) -> None:
        """Draw a line through points, (K, 2), as far as they are known."""
        path = self._placed(points)
        thick = max(1, round(width * self._scale))
        for part in [path] if np.isfinite(path).all() else _known(path):
            self._draw.line(part.ravel().tolist(), colour, thick, "curve")

    def disc(self, at: Array, radius: float, colour: Colour, width: float | None = None) -> None:
        """Draw a disc, or a ring as wide as said within its edge."""
        place, size = self._placed(at).tolist(), radius * self._scale
        if width is None:
            self._draw.circle(place, size, colour)
        else:
            self._draw.circle(place, size, outline=colour, width=round(width * self._scale))

    def box(self, edges: Box, fill: Colour, rim: Colour, radius: float) -> None:
        """Draw a rectangle with round corners."""
        corners = self._placed(np.reshape(edges, (2, 2))).ravel().tolist()
        thick = max(1, round(self._scale))
        self._draw.rounded_rectangle(corners, radius * self._scale, fill, rim, thick)

    def write(
        self, at: Point, text: str, size: float, ink: Colour, anchor: str = "ls", room: float = 1e9
    ) -> float:
        """Write a text, large ones bold, shortened to its room; returns how wide it is."""
        font = _font(size * self._scale, bold=size > 12)
        while font.getlength(text) > room * self._scale and len(text) > 1:
            text = f"{text[:-2].rstrip()}…"
        x, y = (round(length * self._scale) for length in at)
        self._draw.text((x, y), text, ink, font, anchor)
        return font.getlength(text) / self._scale


def _known(path: Array) -> list[Array]:
    """The parts of a line, (K, 2), between points that are not known."""
    parts = np.split(path, np.flatnonzero(~np.isfinite(path).all(axis=1)))
    finite = [part[np.isfinite(part).all(axis=1)] for part in parts]
    return [part for part in finite if len(part) > 1]


@cache
def _font(size: float, *, bold: bool) -> ImageFont.FreeTypeFont:
    name = f"fonts/ttf/DejaVuSans{'-Bold' if bold else ''}.ttf"
    return ImageFont.truetype(
        str(Path(mpl.get_data_path()) / name), size, layout_engine=ImageFont.Layout.BASIC
    )
