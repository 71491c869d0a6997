"""A controller as C source, with a test program.

1.  The law, the observer and the clamp are the Python code itself, run once on symbols
    (``trace``); numpy passes every function of an array of symbols to CasADi (``symbols``).
    Formulas of components calculate with the arithmetic of symbols, a third one. What a period
    changes in an observer is its state (``state``).
2.  The graph becomes C by ``c_code``, not by CasADi's generator; its docstring states why.
3.  Gains and constants of the model are symbols, too, hence named tables in C with the meaning of
    their field. The designs (poles to gains, Riccati equations) run in Python.
4.  The template around the functions holds the order of one period, as ``Controller.command``,
    ``Supervisor.watch`` and ``Supervisor.clamp`` have it, and the Smith predictor's ring buffer.
5.  A period that the observer corrects without a touch is a function of its own.
6.  Reactions of the supervisor (levelling, stop) are not exported: the board's program has them.
7.  The reference is an argument of each period; the scenario's own is exported where it has a form.
8.  The map of ``friction_map_kalman`` and the motion of ``stable_inversion`` are parts of their own
    in C (``friction_map``, ``plan``): loops over many points, and a plan that lies ahead.
9.  Whatever has no form is refused by ``check_exportable`` or ``sources`` in one line.
10. ``test_NAME.c`` replays a run of the twin, ``reference_run.csv``, through the C code.
11. ``cortex-m4/board.c`` makes it a program that answers measurements (``protocol``), for an
    emulated Cortex-M4 or this computer.
12. No board has been flashed with it.
"""

from __future__ import annotations

import math
import textwrap
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.arrays import Array
from controllers.controller import HeldLaw
from controllers.interfaces import Law
from controllers.observers import FrictionMapKalman
from controllers.observers.late_ball import LateBall
from controllers.references import closed_form
from controllers.smith import Smith
from controllers.stable_inversion import StableInversion
from twin.base.errors import ScenarioError
from twin.board.c_code import REALS, number
from twin.board.control import Control
from twin.board.footprint import measure_footprint
from twin.board.friction_map import map_of
from twin.board.plan import plan_of
from twin.board.program import INSTRUCTION_SHIFT, build_command
from twin.board.protocol import ANSWER_LENGTH, MEASUREMENT_LENGTH, PROTOCOL_VERSION
from twin.board.trace import check_exportable, trace
from twin.hal.supervisor import BALL_LOST_AFTER_S

if TYPE_CHECKING:
    from jinja2 import Template

BOARD_TARGET = "cortex-m4"
"""The folder with what makes the controller a program of an emulated board."""
TEMPLATE_FOLDER = Path(__file__).with_name("templates")
MAX_DIFFERENCE_RAD_S = {"double": 1e-9, "float": 1e-2}
"""Largest difference of a commanded rate from the Python code's, by the type of numbers."""
MAX_DIFFERENCE_OF_CHANGES_RAD_S = 2e-3
"""Largest difference of the change of a rate in a period, in ``float``, behind an observer that
takes a constant rate beyond the commanded one for one of the plate: in a replay, in which the plate
does not answer, differences of the rates add up. It is three times the largest that was measured.
"""
NUMBER_BYTES = {"double": 8, "float": 4}
"""Size of a number by its type."""
MAX_REFERENCE_DIFFERENCE = {"double": 1e-9, "float": 1e-3}
"""Largest difference of the reference and its derivatives, as a share of their largest sizes, or in
m to m/s^4 where these are below 1."""


def sources(name: str, control: Control, real: str) -> dict[str, str]:
    """A controller in C with its test and README, by the names of their files.

    Args:
        name: What the names of files and functions begin with.
        control: The controller.
        real: ``double`` or ``float``.

    Raises:
        ScenarioError: If the controller has no form in C.
    """
    given = controller_parts(name, control, real)
    found = controller_sources(given)
    found[f"test_{name}.c"] = _render("replay.c.j2", real, given)
    for each in ("board.c", "board.ld"):
        found[f"{BOARD_TARGET}/{each}"] = _render(f"{each}.j2", real, given)
    ring, states, memory = (given[each] for each in ("ring", "states", "memory"))
    parts = sum(each.numbers for each in (given["plan"], given["map"]) if each)
    given |= {
        "footprint": measure_footprint(name, found),
        "ram_bytes": NUMBER_BYTES[real] * (states + memory + 4 + 2 * ring + parts) + 8,
        "ball_lost": BALL_LOST_AFTER_S,
        "build": build_command(BOARD_TARGET, name),
    }
    return found | {"README.md": _render("README.md.j2", real, given)}


def controller_sources(given: dict[str, Any]) -> dict[str, str]:
    """C source and header of a controller, by name, from its ``controller_parts``."""
    return {
        f"{given['name']}.{end}": _render(f"controller.{end}.j2", given["real"], given)
        for end in "ch"
    }


def controller_parts(name: str, control: Control, real: str) -> dict[str, Any]:
    """What the templates need of a controller.

    Args:
        name: What the names of files and functions begin with.
        control: The controller.
        real: ``double`` or ``float``.

    Raises:
        ScenarioError: If the controller has no form in C.
    """
    law, observer = control.law, control.observer
    if isinstance(law, HeldLaw):
        raise ScenarioError(
            "controller: a law with a period or computing time of its own has no form in C; "
            "leave controller.period and controller.computing_time out"
        )
    check_exportable(law, observer)
    assert isinstance(law, Law)
    period = control.period
    drifts = real == "float" and isinstance(observer, LateBall)
    smith = observer if isinstance(observer, Smith) else None
    inner = observer if smith is None else smith.observer
    plan = plan_of(law, control) if isinstance(law, StableInversion) else None
    traced = trace(law, inner, control.limits, period, real)
    return {
        **traced._asdict(),
        "name": name,
        "guard": name.upper(),
        "title": control.title,
        "law": law.name,
        "observer": inner.name,
        "period": period,
        "real": real,
        "ending": REALS[real],
        "modelled": isinstance(inner, LateBall) and inner.plate == "modelled",
        "drifts": drifts,
        "delay": 0.0 if smith is None else smith.delay,
        "ring": 0 if smith is None else smith.length,
        "longest_wait": Smith.longest_wait,
        "limit": f"{MAX_DIFFERENCE_OF_CHANGES_RAD_S if drifts else MAX_DIFFERENCE_RAD_S[real]:g}",
        "reference_limit": f"{MAX_REFERENCE_DIFFERENCE[real]:g}",
        "plan": plan,
        "map": map_of(inner) if isinstance(inner, FrictionMapKalman) else None,
        "version": PROTOCOL_VERSION,
        "measured": MEASUREMENT_LENGTH,
        "answered": ANSWER_LENGTH,
        "shift": INSTRUCTION_SHIFT,
        **reference_parts(control, plan.length if plan else 0),
    }


def reference_parts(control: Control, ahead: int) -> dict[str, Any]:
    """What the templates need of the reference: its closed form, or else a table.

    Args:
        control: The controller.
        ahead: Control periods by which the law asks for it in advance.
    """
    reference = control.reference
    form = closed_form(reference)
    times = control.period * np.arange(1 + ahead + round(control.duration / control.period))
    rows = reference(times)
    return {
        "reference": reference.name,
        "form": form,
        "table": rows.swapaxes(0, 1).reshape(len(times), 10),
        "scales": np.maximum(np.abs(rows).max(axis=(1, 2)), 1.0).tolist(),
        "pieces": form is not None
        and (form.harmonic is None or math.isfinite(form.harmonic.since)),
    }


def _render(template: str, real: str, given: dict[str, Any]) -> str:
    return _compile_template(template, real).render(given)


@cache
def _compile_template(template: str, real: str) -> Template:
    """A template for numbers of a C type, compiled once."""
    import jinja2  # noqa: PLC0415  heavy: loaded when needed

    how = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATE_FOLDER),
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    how.filters["number"] = lambda value: number(value, real)
    how.filters["double"] = lambda value: number(value, "double")
    how.filters["rows"] = lambda values: _rows(values, real)
    how.filters["table"] = lambda values: _table(values, real)
    how.globals["number"] = lambda value: number(value, real)
    return how.get_template(template)


def _table(values: Array, real: str) -> str:
    """Numbers of an array of any shape in C, in the order of their indices, in lines."""
    text = ", ".join(number(value, real) for value in np.ravel(values).tolist())
    return "    " + "\n    ".join(textwrap.wrap(text, 92, break_long_words=False))


def _rows(values: Array, real: str) -> str:
    """Pairs of numbers of an array of shape (..., 2) in C, one a line."""
    pairs = values.reshape(-1, 2).tolist()
    return "\n".join(f"    {{{number(x, real)}, {number(y, real)}}}," for x, y in pairs)
