"""The parts of the page that draw: what they show, they are sent as rows of numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from nicegui.element import Element

from twin.hal.interface import SCREEN
from twin.play.sight import COLUMNS

RIG, CLEAN, PHI, THETA, EFFORT = "#0072b2", "#009e73", "#7a4fa3", "#b5651d", "#555555"
STRIPS = [
    dict(zip(("title", "curves", "factor", "least", "signed"), each, strict=True))
    for each in (
        (
            "Tracking error, mm",
            [("error", "rig", RIG), ("ghost_error", "clean model", CLEAN)],
            *(1000, 5, False),
        ),
        (
            "Plate angle, deg",
            [("phi", "phi (moves x)", PHI), ("theta", "theta (moves y)", THETA)],
            *(180 / math.pi, 1, True),
        ),
        ("Plate acceleration (RMS), rad/s²", [("effort", "", EFFORT)], 1, 1, False),
    )
]
"""Title, columns with name and colour, scale, least height of the axis, whether it is about 0."""
SIDES = [
    dict(zip(("title", "axis", "angle", "lowers", "half", "colour"), each, strict=True))
    for each in (
        ("seen from the lower edge", "x", "phi", 1, 500 * SCREEN[0], PHI),
        ("seen from the right edge", "y", "theta", -1, 500 * SCREEN[1], THETA),
    )
]
"""The plate's side along an axis: positive phi lowers its end at +x, positive theta lifts that at
+y; half its length in mm."""

Moved = Callable[[float, float], None]


class Drawn(Element):
    """A part of the page that is sent rows of numbers, oldest first."""

    def __init__(self, **props: Any) -> None:
        super().__init__()
        self.props.update({"columns": list(COLUMNS), **props})

    def show(self, rows: Sequence[Sequence[float]]) -> None:
        """Show them."""
        self.run_method("show", rows)


class Plate(Drawn, component="plate.js"):
    """The plate from above.

    Args:
        area: Operating area |x|, |y| in m.
        goal: Called with the goal's x and y in m while a person drags it.
        push: Called with the push along x and y in m/s.
    """

    def __init__(self, area: tuple[float, float], goal: Moved, push: Moved) -> None:
        sizes = {"size": SCREEN, "area": area}
        millimetres = {name: [1000 * each for each in sides] for name, sides in sizes.items()}
        super().__init__(**millimetres, drives=False)
        self.on("goal", lambda event: _called(goal, event.args))
        self.on("push", lambda event: _called(push, event.args))

    def let_drive(self, drives: bool) -> None:
        """Whether who looks may drag."""
        self.props["drives"] = drives
        self.update()


class Sides(Drawn, component="tilt.js"):
    """The plate from two sides, so that its tilt is seen: the last row."""

    def __init__(self) -> None:
        super().__init__(sides=SIDES)


class Strips(Drawn, component="strips.js"):
    """Error, plate angle and effort over the last seconds."""

    def __init__(self) -> None:
        super().__init__(strips=STRIPS)


def _called(done: Moved, given: Any) -> None:
    """Hand over what a browser has sent, if it is two numbers."""
    try:
        x, y = float(given["x"]), float(given["y"])
    except (TypeError, ValueError, KeyError):
        return
    if math.isfinite(x) and math.isfinite(y):
        done(x, y)
