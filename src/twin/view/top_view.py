"""The plate from above in 2D: outline, operating area, reference path, friction map."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr

from controllers.arrays import Array
from twin.hal.interface import SCREEN
from twin.sim.plant.friction import SurfaceMap
from twin.view.signals import Colour


def in_view(points: Array) -> Array:
    """Points in m, (..., 2), as the view draws them: mm, y upwards (its own y goes down)."""
    drawn: Array = points * np.array([1000.0, -1000.0])
    return drawn


def fixed(
    root: str,
    path: Array,
    area: tuple[float, float],
    surface: SurfaceMap | None,
    *,
    colour: Colour,
) -> Iterator[tuple[str, rr.AsComponents]]:
    """What does not move in the top view.

    Args:
        root: Entity of the top view.
        path: Reference path in m, shape (K, 2).
        area: Operating area |x|, |y| in m.
        surface: How friction varies over the screen; None for a plain one.
        colour: Of the ball and its trail.
    """
    width, height = 1000 * np.array(SCREEN)
    yield (
        f"{root}/screen",
        rr.Boxes2D(
            centers=[[0, 0]],
            half_sizes=[[width / 2, height / 2]],
            colors=[[120, 130, 140]],
            radii=1.2,
            draw_order=1.0,
        ),
    )
    yield (
        f"{root}/operating_area",
        rr.Boxes2D(
            centers=[[0, 0]],
            half_sizes=[[1000 * area[0], 1000 * area[1]]],
            colors=[[120, 170, 200]],
            radii=0.7,
            draw_order=2.0,
        ),
    )
    corner = np.array([-0.32, -0.17])
    tips = in_view(np.array([[0.06, 0.0], [0.0, 0.06]]))
    yield (
        f"{root}/axes",
        rr.Arrows2D(
            origins=[in_view(corner)] * 2,
            vectors=tips,
            colors=[[230, 80, 80], [80, 200, 90]],
            labels=["x", "y"],
            radii=1.5,
        ),
    )
    if surface is not None and surface.relative is not None:
        shift = [-width / 2, -height / 2, 0.0]
        yield f"{root}/friction_map", rr.Transform3D(translation=shift)
        yield f"{root}/friction_map", _map(surface)
    yield (
        f"{root}/reference_path",
        rr.LineStrips2D([in_view(path)], colors=[[235, 235, 235]], radii=0.6, draw_order=10.0),
    )
    for name, dot, radius, order in (
        ("ball", colour, 20.0, 15.0),
        ("measured", (160, 160, 160), 5.0, 20.0),
        ("estimate", (230, 159, 0), 5.0, 21.0),
        ("reference", (255, 255, 255), 5.0, 22.0),
    ):
        look = rr.Points2D.from_fields(colors=[dot], radii=[radius], draw_order=order)
        yield f"{root}/{name}", look
    trail = rr.LineStrips2D.from_fields(colors=[colour], radii=[1.6], draw_order=12.0)
    yield f"{root}/trail", trail


def _map(surface: SurfaceMap) -> rr.AsComponents:
    """Friction as a picture of one dot per mm: dark where it is least, red where most."""
    width, height = (round(1000 * side) for side in SCREEN)
    x = (np.arange(width) + 0.5) / width - 0.5
    y = 0.5 - (np.arange(height) + 0.5) / height
    places = np.stack(np.meshgrid(SCREEN[0] * x, SCREEN[1] * y), axis=-1)
    friction = surface(places)[0]
    share = (friction - friction.min()) / (np.ptp(friction) or 1.0)
    low, high = np.array([25, 35, 55]), np.array([165, 60, 40])
    return rr.Image((low + share[..., None] * (high - low)).astype(np.uint8), draw_order=0.5)
