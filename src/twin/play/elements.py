"""The parts of the page that draw: what they show, they are sent as rows of numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from nicegui.element import Element

from twin.hal.interface import SCREEN
from twin.play.sight import COLUMNS

RIG, CLEAN, PHI, THETA, EFFORT = "#0072b2", "#009e73", "#7a4fa3", "#b5651d", "#555555"
STRIPS = (
    {
        "title": "Tracking error, mm",
        "columns": ["error", "ghost_error"],
        "names": ["rig", "clean model"],
        "colours": [RIG, CLEAN],
        "factor": 1000,
        "least": 5,
        "signed": False,
    },
    {
        "title": "Plate angle, deg",
        "columns": ["phi", "theta"],
        "names": ["phi (moves x)", "theta (moves y)"],
        "colours": [PHI, THETA],
        "factor": 180 / math.pi,
        "least": 1,
        "signed": True,
    },
    {
        "title": "Control effort: plate acceleration (RMS), rad/s²",
        "columns": ["effort"],
        "names": [],
        "colours": [EFFORT],
        "factor": 1,
        "least": 1,
        "signed": False,
    },
)
SIDES = (
    {
        "title": "seen from the lower edge",
        "axis": "x",
        "angle": "phi",
        "lowers": 1,
        "half": 500 * SCREEN[0],
        "colour": PHI,
    },
    {
        "title": "seen from the right edge",
        "axis": "y",
        "angle": "theta",
        "lowers": -1,
        "half": 500 * SCREEN[1],
        "colour": THETA,
    },
)
"""The plate's side along an axis: positive phi lowers its end at +x, positive theta lifts that at
+y; half its length in mm."""

Moved = Callable[[float, float], None]


class Plate(Element, component="plate.js"):
    """The plate from above.

    Args:
        area: Operating area |x|, |y| in m.
        goal: Called with the goal's x and y in m while a person drags it.
        push: Called with the push along x and y in m/s.
    """

    def __init__(self, area: tuple[float, float], goal: Moved, push: Moved) -> None:
        super().__init__()
        self.props["size"] = [1000 * each for each in SCREEN]
        self.props["area"] = [1000 * each for each in area]
        self.props["columns"] = list(COLUMNS)
        self.props["drives"] = False
        self.on("goal", lambda event: _called(goal, event.args))
        self.on("push", lambda event: _called(push, event.args))

    def show(self, rows: Sequence[Sequence[float]]) -> None:
        """Show rows of numbers, oldest first."""
        self.run_method("show", rows)

    def let_drive(self, drives: bool) -> None:
        """Whether who looks may drag."""
        self.props["drives"] = drives
        self.update()


class Sides(Element, component="tilt.js"):
    """The plate from two sides, so that its tilt is seen."""

    def __init__(self) -> None:
        super().__init__()
        self.props["columns"] = list(COLUMNS)
        self.props["sides"] = list(SIDES)

    def show(self, rows: Sequence[Sequence[float]]) -> None:
        """Show the last of rows of numbers."""
        self.run_method("show", rows[-1:])


class Strips(Element, component="strips.js"):
    """Error, plate angle and effort over the last seconds."""

    def __init__(self) -> None:
        super().__init__()
        self.props["columns"] = list(COLUMNS)
        self.props["strips"] = list(STRIPS)

    def show(self, rows: Sequence[Sequence[float]]) -> None:
        """Show rows of numbers, oldest first."""
        self.run_method("show", rows)


def _called(done: Moved, given: Any) -> None:
    """Hand over what a browser has sent, if it is two numbers."""
    try:
        x, y = float(given["x"]), float(given["y"])
    except (TypeError, ValueError, KeyError):
        return
    if math.isfinite(x) and math.isfinite(y):
        done(x, y)
