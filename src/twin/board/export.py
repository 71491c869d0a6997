"""The controller of a scenario as a folder of C source, with a test and a reference run.

1.  The law, the observer and the clamp are the Python code itself, run once on symbols
    (``trace``); numpy passes every function of an array of symbols to CasADi (``symbols``).
    ``controllers.arrays.Arithmetic`` serves the clamp only, as laws and observers are written with
    numpy: rewriting them for it would change every law and gain nothing.
2.  The graph becomes C by ``c_code``, not by CasADi's generator; its docstring says why.
3.  Gains and constants of the model are symbols, too, hence named tables in C with the meaning of
    their field. The designs (poles to gains, Riccati equations) run in Python.
4.  The template around the functions holds the order of one period, as ``Controller.command``,
    ``Supervisor.watch`` and ``Supervisor.clamp`` have it, and the Smith predictor's ring buffer.
5.  A period that the observer corrects without a touch is a function of its own.
6.  Reactions of the supervisor (levelling, stop) are not exported: the board's program has them.
7.  The reference is an argument of each period; the scenario's own is exported where it has a form.
8.  Whatever has no form is refused by ``check_exportable`` or ``sources`` in one line.
9.  ``test_NAME.c`` replays a run of the twin, ``reference_run.csv``, through the C code.
10. No board has been flashed with it: the comparison is made on a PC.
"""

from __future__ import annotations

import math
import re
import textwrap
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from controllers.arrays import Array
from controllers.controller import HeldLaw, Smith
from controllers.interfaces import Law
from controllers.references import closed_form
from twin.base.errors import RecordError, ScenarioError
from twin.base.writing import write_whole
from twin.board.c_code import REALS, number
from twin.board.footprint import measure_footprint
from twin.board.trace import check_exportable, trace
from twin.hal.supervisor import BALL_LOST_AFTER_S
from twin.run.assemble import (
    assemble,
    build_controller,
    build_limits,
    build_reference,
    own_errors,
)
from twin.scenario.schema import Scenario

if TYPE_CHECKING:
    from jinja2 import Template

TEMPLATE_FOLDER = Path(__file__).with_name("templates")
NAME_PATTERN = re.compile(r"[a-z][a-z0-9_]{0,40}")
"""Names of the C file without its ending, which begin the names in C."""
RESERVED_NAMES = frozenset({
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else",
    "enum", "extern", "float", "for", "goto", "if", "inline", "int", "long", "register",
    "restrict", "return", "short", "signed", "sizeof", "static", "struct", "switch", "typedef",
    "union", "unsigned", "void", "volatile", "while", "math", "stdio", "stdlib",
})  # fmt: skip
"""Keywords of C99, and headers that the sources include."""
MAX_DIFFERENCE_RAD_S = {"double": 1e-9, "float": 1e-2}
"""Largest difference of a commanded rate from that of the Python code, by the type of numbers."""
NUMBER_BYTES = {"double": 8, "float": 4}
"""Size of a number by its type."""
MAX_REFERENCE_DIFFERENCE = {"double": 1e-9, "float": 1e-3}
"""Largest difference of the reference and its derivatives, as a share of their largest sizes, or in
m to m/s^4 where these are below 1."""


def export(file: Path, scenario: Scenario, *, real: str = "double") -> Path:
    """Write the controller of a scenario as C99 source into a folder.

    Args:
        file: Name of the C file, ``FOLDER/NAME.c``; the folder ``FOLDER/NAME`` is written.
        scenario: The scenario; its run is the reference run.
        real: Type of numbers, ``double`` or ``float``.

    Returns:
        The folder.

    Raises:
        TwinError: If the name is no name in C, the controller has no form in C, or the folder
            cannot be written.
    """
    name = file.stem
    if not NAME_PATTERN.fullmatch(name) or name in RESERVED_NAMES:
        raise RecordError(f"{file}: names in C begin with the name: a-z, 0-9 and _, no keyword")
    texts = sources(name, scenario, real)
    run = reference_run(scenario, scenario.duration)
    texts["reference_run.csv"] = run.to_csv(index=False, lineterminator="\n")
    folder = file.with_suffix("")
    for each, text in texts.items():
        write_whole(folder / each, text)
    return folder


def sources(name: str, scenario: Scenario, real: str) -> dict[str, str]:
    """A scenario's controller in C with its test and README, by the names of their files.

    Args:
        name: What the names of files and functions begin with.
        scenario: The scenario.
        real: ``double`` or ``float``.

    Raises:
        ScenarioError: If the controller has no form in C.
    """
    given = controller_parts(name, scenario, real)
    found = controller_sources(given)
    found[f"test_{name}.c"] = _render("test.c.j2", real, given)
    ring, states, memory = (given[each] for each in ("ring", "states", "memory"))
    given |= {
        "footprint": measure_footprint(name, found),
        "ram_bytes": NUMBER_BYTES[real] * (states + memory + 4 + 2 * ring) + 8,
        "ball_lost": BALL_LOST_AFTER_S,
    }
    return found | {"README.md": _render("README.md.j2", real, given)}


def controller_sources(given: dict[str, Any]) -> dict[str, str]:
    """C source and header of a controller, by name, from its ``controller_parts``."""
    return {
        f"{given['name']}.{end}": _render(f"controller.{end}.j2", given["real"], given)
        for end in "ch"
    }


def controller_parts(name: str, scenario: Scenario, real: str) -> dict[str, Any]:
    """What the templates need of a scenario's controller.

    Args:
        name: What the names of files and functions begin with.
        scenario: The scenario.
        real: ``double`` or ``float``.

    Raises:
        ScenarioError: If the controller has no form in C.
    """
    controller = build_controller(scenario)
    law, observer = controller.law, controller.observer
    if isinstance(law, HeldLaw):
        raise ScenarioError(
            "controller: a law with a period or computing time of its own has no form in C; "
            "leave controller.period and controller.computing_time out"
        )
    check_exportable(law, observer)
    assert isinstance(law, Law)
    period = scenario.rig.period
    smith = observer if isinstance(observer, Smith) else None
    inner = observer if smith is None else smith.observer
    traced = trace(law, inner, build_limits(scenario), period, real)
    return {
        **traced._asdict(),
        "name": name,
        "guard": name.upper(),
        "title": scenario.title,
        "law": law.name,
        "observer": inner.name,
        "period": period,
        "real": real,
        "ending": REALS[real],
        "delay": 0.0 if smith is None else smith.delay,
        "ring": 0 if smith is None else smith.length,
        "longest_wait": Smith.longest_wait,
        "limit": f"{MAX_DIFFERENCE_RAD_S[real]:g}",
        "reference_limit": f"{MAX_REFERENCE_DIFFERENCE[real]:g}",
        **reference_parts(scenario),
    }


def reference_parts(scenario: Scenario) -> dict[str, Any]:
    """What the templates need of the scenario's reference: its closed form, or else a table."""
    reference = build_reference(scenario)
    form = closed_form(reference)
    times = scenario.rig.period * np.arange(1 + round(scenario.duration / scenario.rig.period))
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
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415  heavy: loaded when needed

    how = Environment(trim_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined)
    how.filters["number"] = lambda value: number(value, real)
    how.filters["double"] = lambda value: number(value, "double")
    how.filters["rows"] = lambda values: _rows(values, real)
    how.filters["table"] = lambda values: _table(values, real)
    how.globals["number"] = lambda value: number(value, real)
    return how.from_string((TEMPLATE_FOLDER / template).read_text(encoding="utf-8"))


def _table(values: Array, real: str) -> str:
    """Numbers of an array of any shape in C, in the order of their indices, in lines."""
    text = ", ".join(number(value, real) for value in np.ravel(values).tolist())
    return "    " + "\n    ".join(textwrap.wrap(text, 92, break_long_words=False))


def _rows(values: Array, real: str) -> str:
    """Pairs of numbers of an array of shape (..., 2) in C, one a line."""
    pairs = values.reshape(-1, 2).tolist()
    return "\n".join(f"    {{{number(x, real)}, {number(y, real)}}}," for x, y in pairs)


RUN_COLUMNS = (
    *("x", "phi", "y", "theta", "age", "touched"),
    *(f"desired_{axis}_{order}" for order in range(5) for axis in "xy"),
    *("rate_phi", "rate_theta"),
)
"""Columns of a reference run: measurement, reference and its derivatives, commanded plate rates."""


def reference_run(scenario: Scenario, duration: float) -> pd.DataFrame:
    """A run of the twin under the scenario's own controller: ``RUN_COLUMNS``, SI, a row a period.

    Args:
        scenario: The scenario.
        duration: Longest time in s.
    """
    rig, controller = assemble(scenario, unseen=True)
    rows = list[Array]()
    with own_errors(), rig:
        measured = rig.read()
        # the board knows no plate angle before its first measurement
        rig.supervisor.angle = measured.y[:, 1::2].copy()
        controller.start(measured)
        rig.start()
        for _ in range(round(duration / rig.period)):
            step = controller.command(measured)
            applied = rig.write(step.rate)
            controller.applied(applied)
            desired = controller.reference(measured.time)
            rows.append(
                np.concatenate(
                    [measured.y[0], measured.age, measured.touched, desired.ravel(), applied[0]]
                )
            )
            rig.wait()
            measured = rig.read()
            if not rig.supervisor.all_running:
                break
    return pd.DataFrame(rows, columns=RUN_COLUMNS)
