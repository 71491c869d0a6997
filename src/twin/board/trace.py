"""The equations of a controller as C functions, from the code that runs in Python.

Law, observer and clamp are copied with symbols in place of their gains and of the model's
constants, and are run once on symbols for the measurement, the reference and their own states.
Whether the screen feels the ball is no symbol: both cases are run.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.classical import (
    AFL,
    LQR,
    AFLIntegral,
    Backstepping,
    Feedforward,
    Pid,
    PolePlacement,
    SlidingMode,
)
from controllers.controller import needed_columns
from controllers.interfaces import ControlLaw, Feedback, Law, Observer
from controllers.observers import (
    ExtendedKalman,
    FrictionKalman,
    FrictionMapKalman,
    Kalman,
    Luenberger,
    NonlinearLuenberger,
)
from controllers.smith import Smith
from controllers.stable_inversion import InverseMotion, StableInversion
from twin.base.errors import ScenarioError
from twin.board.c_code import Constant, c_function
from twin.board.friction_map import LocalFriction
from twin.board.state import ObserverState, changed_fields, copy, is_part, measure
from twin.board.symbols import (
    SYMBOL_ARITHMETIC,
    NoSymbolicFormError,
    Setting,
    SymbolArray,
    as_symbols,
    expressions,
    new_symbols,
)
from twin.hal.interface import Clamp, Limits
from twin.hal.supervisor import Supervisor, correct_angle
from twin.scenario.describe import meanings

LAWS: tuple[type[Law], ...] = (
    PolePlacement,
    LQR,
    Feedforward,
    Pid,
    AFL,
    AFLIntegral,
    Backstepping,
    SlidingMode,
    StableInversion,
)
"""Laws that can be exported."""
OBSERVERS: tuple[type[Observer], ...] = (
    Luenberger,
    Kalman,
    NonlinearLuenberger,
    ExtendedKalman,
    FrictionKalman,
    FrictionMapKalman,
)
"""Observers that can be exported."""


class Traced(NamedTuple):
    """The equations of a controller in C.

    Attributes:
        functions: The C functions.
        constants: Named tables that they use.
        states: Numbers of the observer's state; the first eight are the estimate.
        sees: Numbers that the observer gives the law, if they are not the estimate, else 0.
        memory: Numbers of the law's memory.
    """

    functions: list[str]
    constants: list[Constant]
    states: int
    sees: int
    memory: int


class Tables:
    """Copies of objects with symbols in place of their numbers, and the numbers as named tables.

    Zeros stay numbers, so that terms with them vanish. So do whole numbers and truth values, by
    which equations are chosen.

    Attributes:
        each: The tables.
    """

    def __init__(self) -> None:
        self.each = list[Constant]()
        self._models = dict[BallPlate, Any]()
        self._symbols = dict[Any, SymbolArray]()

    def copy_of(self, source: Any, prefix: str) -> Any:
        """A copy of a law, observer, model or clamp with symbols.

        Args:
            source: The object; it is not changed.
            prefix: How the names of its tables begin, in capitals.
        """
        cls: Any = type(source)
        texts = meanings(cls)
        return changed_fields(
            source, lambda name, value: self.symbols_of(name, value, prefix, texts.get(name, ""))
        )

    def symbols_of(self, name: str, value: Any, prefix: str, meaning: str) -> Any:
        """Symbols in place of numbers, also of those within objects; else the value itself."""
        title = f"{prefix}_{name.strip('_').upper()}"
        if isinstance(value, BallPlate):
            if value not in self._models:
                self._models[value] = self.copy_of(value, "MODEL")
            return self._models[value]
        if is_part(value):
            return self.copy_of(value, title)
        if isinstance(value, list) and any(map(is_part, value)):
            return [self.copy_of(each, f"{title}_{i}") for i, each in enumerate(value)]
        table = _finite_numbers(value)
        if table is None:
            return value
        if any(each.name == title for each in self.each):
            title += "_2"
        values = table.ravel().tolist()
        same = prefix.partition("_")[0], name.strip("_"), table.shape, tuple(values)
        if same not in self._symbols:
            column, symbols = new_symbols(title, *table.shape, kind=Setting)
            self.each.append(Constant(title, values, meaning, column, not table.ndim))
            symbols[table == 0] = 0.0
            self._symbols[same] = symbols
        found = self._symbols[same]
        return found.copy() if table.ndim else found.item()


def _finite_numbers(value: Any) -> Array | None:
    """A value that is finite numbers as an array, if it is not whole numbers or a truth value."""
    each = value if isinstance(value, list | tuple) else [value]
    if all(isinstance(one, bool | int | str) for one in each):
        return None
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        return None
    return numbers if numbers.size and np.isfinite(numbers).all() else None


def check_exportable(law: ControlLaw, observer: Observer) -> None:
    """Make sure that a law and an observer have a form in C.

    Raises:
        ScenarioError: If one has none: which, and which have.
    """
    inner = observer.observer if isinstance(observer, Smith) else observer
    for what, one, known in (("controller", law, LAWS), ("observer", inner, OBSERVERS)):
        if type(one) not in known:
            names = ", ".join(each.name for each in known)
            raise ScenarioError(f"{what}.kind: '{one.name}' has no form in C; exported are {names}")


def trace(law: Law, observer: Observer, limits: Limits, period: float, real: str) -> Traced:
    """The equations of a controller as C functions.

    Args:
        law: One of ``LAWS``.
        observer: One of ``OBSERVERS``, without a predictor.
        limits: Limits of the commands.
        period: Control period in s.
        real: ``double`` or ``float``.

    Raises:
        ScenarioError: If an equation has no symbolic form.
    """
    tables = Tables()
    try:
        needed = needed_columns(law, observer)
        observing = _observer_functions(observer, needed, tables)
        mine = tables.copy_of(law, "LAW")
        clamp = tables.copy_of(Clamp(limits, period), "CLAMP")
        share = tables.symbols_of(
            "share",
            period / Supervisor.DRIFT_TIME_S,
            "DRIFT",
            "Share of its drift by which the commanded plate angle is corrected in a period.",
        )
        traced = [*observing, *_law_functions(mine, len(needed)), *_command_functions(clamp, share)]
    except NoSymbolicFormError as error:
        raise ScenarioError(f"'{law.name}' with '{observer.name}': {error}") from error
    functions = [c_function(*each, tables.each, real) for each in traced]
    text = "\n".join(functions)
    used = [each for each in tables.each if re.search(rf"\b{each.name}\b", text)]
    states = len(observing[0].outputs["state"])
    sees = len(observing[-1].outputs["seen"]) if observing[-1].name == "see" else 0
    return Traced(functions, used, states, sees, law.memory)


class _Function(NamedTuple):
    """What a C function is made of, see ``c_function``."""

    name: str
    inputs: dict[str, Any]
    outputs: dict[str, list[Any]]


def _observer_functions(
    observer: Observer, needed: Sequence[int], tables: Tables
) -> list[_Function]:
    """The C functions start, observe_touched, observe_untouched, predict and, if needed, see."""
    if isinstance(observer, FrictionMapKalman):
        observer = LocalFriction.of(observer)
    state = ObserverState(observer)
    own = tables.copy_of(state.now, "OBSERVER")
    found = [_Function("start", {"y": state.y}, {"state": state.of(state.begun)})]
    given: dict[str, Any] = {}
    if isinstance(own, LocalFriction):
        found += _map_functions(own, state)
        given = {"camber": own.cuts.columns["camber"]} if own.camber_spread else {}
    else:
        for touched in (True, False):
            one = copy(own)
            inputs = measure(one, touched)
            name = "observe_touched" if touched else "observe_untouched"
            found.append(_Function(name, inputs, {"after": state.of(one)}))
    one = copy(own)
    u_column, u = new_symbols("u", 1, 2)
    one.predict(u)
    found.append(_Function("predict", {"u": u_column}, {"after": state.of(one)}))
    if own.equivalent is not own.x:
        seen = expressions(np.concatenate((own.equivalent[0], own.further[0, needed])))
        found.append(_Function("see", given, {"seen": seen}))
    # what no function reads is no state, but for the estimate
    results = [one for each in found for values in each.outputs.values() for one in values]
    read = set(map(str, ca.symvar(ca.vertcat(*results))))
    kept = [i for i, each in enumerate(state.symbols) if i < 8 or str(each) in read]
    column = {"state": ca.vertcat(*(state.symbols[i] for i in kept))}
    return [
        _Function(
            each.name,
            each.inputs if each.name == "start" else column | each.inputs,
            {
                name: [values[i] for i in kept] if name in {"state", "after"} else values
                for name, values in each.outputs.items()
            },
        )
        for each in found
    ]


def _map_functions(own: LocalFriction, state: ObserverState) -> list[_Function]:
    """The C functions that an observer with a map is cut into, in their order."""
    one, (touched_column, touched) = copy(own), new_symbols("touched", 1)
    inputs = measure(one, touched.item()) | {"touched": touched_column}
    columns, results = own.cuts.columns, own.cuts.found
    found = [_Function("advance", {"y": inputs["y"]}, {"A": results["advance"]})]
    inputs |= {"covariance": columns["covariance"]}
    found.append(_Function("weigh", dict(inputs), {"weights": results["weigh"]}))
    inputs |= {"change": columns["change"]}
    found.append(_Function("place_there", dict(inputs), {"place": results["place_there"]}))
    inputs |= {"there": columns["there"]}
    found.append(_Function("place_now", dict(inputs), {"place": results["place_now"]}))
    inputs |= {"now": columns["now"]}
    outputs = {"after": state.of(one), "struck": results["struck"]}
    return [*found, _Function("observe_there", inputs, outputs)]


class _Motion(NamedTuple):
    """A plan that is the desired motion, shape (2, 12)."""

    rows: SymbolArray

    def at(self, *_: Any) -> list[InverseMotion]:
        """The motion at any time."""
        return [InverseMotion.of(row) for row in self.rows.tolist()]


def _law_functions(mine: Law, needed: int) -> list[_Function]:
    """The C functions control and, of a law with memory, memory_rate."""
    x_column, x = new_symbols("x", 1, 8)
    r_column, r = new_symbols("r", 5, 1, 2)
    q_column, q = new_symbols("q", 1, mine.memory)
    rate = as_symbols(np.zeros((1, 2), object))

    def reference(_: Any) -> SymbolArray:
        return r

    now: Any = Feedback(0.0, x, x, x[..., :0], rate, rate, reference, q)  # type: ignore[arg-type]
    inputs = {"x": x_column, "r": r_column}
    inputs |= {"q": q_column} if mine.memory else {}
    if isinstance(mine, StableInversion):
        known_column, known = new_symbols("known", 1, needed)
        rate_column, rate = new_symbols("rate", 1, 2)
        motion_column, motion = new_symbols("motion", 2, 12)
        now = now._replace(needed=known, rate=rate, plan=_Motion(motion))
        inputs = {"x": x_column, "known": known_column, "rate": rate_column}
        inputs |= {"motion": motion_column}
    u = expressions(mine.command(now))
    found = [_Function("control", inputs, {"u": u})]
    if mine.memory:
        slope = mine.memory_rate(0.0, x, reference, q)  # type: ignore[arg-type]
        rates = {"q_rate": expressions(slope)}
        found.append(_Function("memory_rate", inputs, rates))
    return found


def _command_functions(clamp: Clamp, share: Any) -> list[_Function]:
    """The C functions correct_angle and clamp, for both axes."""
    requested_column, requested = new_symbols("requested", 2)
    rate_column, rate = new_symbols("rate", 2)
    angle_column, angle = new_symbols("angle", 2)
    seen_column, seen = new_symbols("measured", 2)
    corrected = expressions(correct_angle(angle, seen - angle, share))
    inputs = {"angle": angle_column, "measured": seen_column}
    found = [_Function("correct_angle", inputs, {"after": corrected})]
    each = [
        clamp.allowed(SYMBOL_ARITHMETIC, *of) for of in zip(requested, rate, angle, strict=True)
    ]
    inputs = {"requested": requested_column, "rate": rate_column, "angle": angle_column}
    found.append(_Function("clamp", inputs, {"allowed": expressions(each)}))
    return found
