"""What the analysis found as plain numbers: lists and dictionaries that JSON can hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from controllers.analysis.designs import assess, designs
from controllers.analysis.loops import sampled_loop, unstable
from controllers.analysis.margins import Margins, margins
from controllers.ballplate import BallPlate
from controllers.held import HeldLaw
from controllers.interfaces import Law, Observer
from controllers.observers import Luenberger

PlainRow = dict[str, Any]
"""A row of a table as JSON can hold it."""

DEAD_TIME = 0.042
"""Dead time of the touch screen in s, Table A.2."""


def design_rows(
    model: BallPlate, advance: Callable[[float], None] = lambda _: None
) -> list[PlainRow]:
    """Poles and margins of every linear design of the thesis, with the observer of (8.1).

    Args:
        model: Model of design and plant.
        advance: Told the number of designs done.
    """
    observer = Luenberger(model=model)
    rows = []
    for done, design in enumerate(designs(model)):
        found = assess(design.law, observer, DEAD_TIME)
        rows.append(
            {
                "table": design.source,
                "controller": design.law.name,
                "settings": design.settings,
                "thesis_poles": None if design.poles is None else pairs(design.poles),
                "thesis_model": "flat" if design.flat else "linear",
                "poles_flat_model": pairs(found.flat_poles),
                "poles_linear_model": pairs(found.poles),
                "slowest_pole_with_observer_and_dead_time": pairs([found.late_pole])[0],
                "margins": {
                    "full_state_at_u1": margin_row(found.full_state),
                    "observer_at_u1": margin_row(found.at_input),
                    "observer_at_ball": margin_row(found.at_ball),
                },
            }
        )
        advance(done + 1)
    return rows


def loop_row(law: Law, observer: Observer, dead_time: float) -> PlainRow:
    """Poles and margins of one sampled loop, or under ``reason`` why there are none.

    ``hold_left_out`` is true for a law that is held for longer than the loop's period.

    Args:
        law: Any law.
        observer: Any observer, or a predictor around one.
        dead_time: Of the ball's measurement in s.
    """
    try:
        loop = sampled_loop(law, observer, dead_time=dead_time)
    except ValueError as error:
        return {"reason": str(error), "hold_left_out": isinstance(law, HeldLaw)}
    poles = loop.poles()
    cuts = [cut for cut in ("u1", "u2", "x", "y") if cut in loop.cuts]
    return {
        "reason": None,
        "hold_left_out": isinstance(law, HeldLaw),
        "stable": len(unstable(np.exp(poles * loop.period))) == 0,
        "poles": pairs(poles),
        "margins": {cut: margin_row(margins(loop, cut)) for cut in cuts},
    }


def margin_row(found: Margins | None) -> PlainRow | None:
    """Margins by name; None for an unstable loop."""
    return None if found is None else {k: number(v) for k, v in found._asdict().items()}


def pairs(poles: Iterable[complex]) -> list[list[float]]:
    """Poles as real and imaginary part, each once: both axes have most of them alike."""
    out: list[list[float]] = []
    for pole in map(complex, poles):
        near = 1e-4 * (1 + abs(pole))
        if not any(abs(pole - complex(*other)) < near for other in out):
            out.append([pole.real, pole.imag])
    return out


def number(value: float | None) -> float | None:
    """The value, or None for one that is not finite."""
    return float(value) if value is not None and math.isfinite(value) else None
