"""What the analysis found as plain numbers: lists and dictionaries that JSON can hold.

The controllers of the thesis with its gains, and the poles it designs them for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.analysis.loops import Margins, margins, sampled_loop, state_feedback_loop, unstable
from controllers.ballplate import BallPlate
from controllers.controller import HeldLaw
from controllers.design import Pole
from controllers.interfaces import Law, Observer
from controllers.linear import LQR, PolePlacement
from controllers.nonlinear import AFL, AFLIntegral, Backstepping
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
    for done, design in enumerate(linear_designs(model)):
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


class LinearDesign(NamedTuple):
    """A controller with the gains of the thesis.

    Attributes:
        source: Table or chapter.
        settings: What was chosen, in words.
        law: The controller.
        poles: Poles of an axis in 1/s as designed, or None where the thesis gives weights or gains.
        flat: Whether they are poles of the flat model (6.44) rather than of (5.35).
    """

    source: str
    settings: str
    law: Law
    poles: tuple[Pole, ...] | None = None
    flat: bool = False


PLACED = ((-1, -1.5, -2, -2.5), (-2, -2.5, -3.5, -4), (-1, -2, -5, -6))
WEIGHTS = (("8.2, 9.1", 100, 0.1), ("8.2", 300, 0.1), ("8.2", 1000, 0.1), ("8.3", 300, 0.3))
TRACKING = ((-1, -1.5, -2, -2.5), (-2, -2.5, -3.5, -4), (-3, -4, -5, -6))
INTEGRAL = ((-0.5, -1, -1.5, -2, -2.5), (-1, -1.5, -2, -2.5, -3), (-2, -2.5, -3.5, -4, -5))
STEPS = ((0.1, 1, 1.5, 2), (1, 2, 2.5, 3), (1, 4, 5, 6))


def linear_designs(model: BallPlate | None = None) -> list[LinearDesign]:
    """Every design of chapters 8 and 9 that has a linearisation: all but the sliding mode.

    Chapter 9 gives gains without poles; those beside them follow from its gains and the flat model.
    Feed-forward with LQR has the loop of the LQR.

    Args:
        model: The model the laws are designed on.
    """
    m = model or BallPlate()
    return [
        *(LinearDesign("8.1", f"{p}", PolePlacement(model=m, poles=p), p) for p in PLACED),
        *(LinearDesign(n, f"ρ={r}, κ={k}", LQR(model=m, rho=r, kappa=k)) for n, r, k in WEIGHTS),
        *(LinearDesign("8.4", f"{p}", AFL(model=m, poles=p), p, flat=True) for p in TRACKING),
        LinearDesign(
            "9.2", "p=(180, 162, 66, 13)", AFL(model=m, gains=(180, 162, 66, 13)), flat=True
        ),
        *(
            LinearDesign("8.6", f"{p}", AFLIntegral(model=m, poles=p), p, flat=True)
            for p in INTEGRAL
        ),
        LinearDesign(
            "9.4",
            "p=(200, 132, 51, 12), p_I=4",
            AFLIntegral(model=m, gains=(200, 132, 51, 12, 4)),
            flat=True,
        ),
        *(LinearDesign("8.8", f"c={c}", Backstepping(model=m, c=c), flat=True) for c in STEPS),
        LinearDesign("9.6", "c=(2, 3, 4, 5.5)", Backstepping(model=m, c=(2, 3, 4, 5.5)), flat=True),
    ]


class Assessment(NamedTuple):
    """A design's loop about the level plate; axis x, axis y being alike.

    Attributes:
        poles: With the full state, continuous, on (5.35), in 1/s; both axes.
        flat_poles: The same on the flat model (6.44).
        full_state: Margins of that loop cut at u1.
        at_input: Margins of the sampled loop with the observer, cut at u1.
        at_ball: The same cut where the ball is measured.
        late_pole: Slowest pole of the sampled loop with the ball measured a dead time late.
    """

    poles: NDArray[np.complexfloating]
    flat_poles: NDArray[np.complexfloating]
    full_state: Margins | None
    at_input: Margins | None
    at_ball: Margins | None
    late_pole: complex


def assess(law: Law, observer: Observer, dead_time: float) -> Assessment:
    """Poles and margins of a law with an observer.

    Args:
        law: A law with a linearisation.
        observer: The observer it is to work with.
        dead_time: Of the ball's measurement in s, which nothing compensates.
    """
    full = state_feedback_loop(law)
    sampled = sampled_loop(law, observer)
    late = sampled_loop(law, observer, dead_time=dead_time)
    return Assessment(
        poles=full.poles(),
        flat_poles=state_feedback_loop(law, flat=True).poles(),
        full_state=margins(full, "u1"),
        at_input=margins(sampled, "u1"),
        at_ball=margins(sampled, "x"),
        late_pole=complex(late.poles()[0]),
    )
