"""The equations of a controller as C functions, from the code that runs in Python.

Law, observer and clamp are copied with symbols in place of their gains and of the model's
constants, and are run once on symbols for the measurement, the reference and their own states.
Whether the screen feels the ball is no symbol: both cases are run.
"""

from __future__ import annotations

import re
from functools import cached_property
from typing import Any, NamedTuple

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
from controllers.controller import Smith
from controllers.interfaces import ControlLaw, Feedback, Law, Measurement, Observer
from controllers.observers import ExtendedKalman, Kalman, Luenberger, NonlinearLuenberger
from twin.base.errors import ScenarioError
from twin.board.c_code import Constant, c_function
from twin.board.symbols import (
    SYMBOL_ARITHMETIC,
    NoSymbolicFormError,
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
)
"""Laws that can be exported."""
OBSERVERS: tuple[type[Observer], ...] = (
    Luenberger,
    Kalman,
    NonlinearLuenberger,
    ExtendedKalman,
)
"""Observers that can be exported."""


class Traced(NamedTuple):
    """The equations of a controller in C.

    Attributes:
        functions: The C functions.
        constants: Named tables that they use.
        states: Numbers of the observer's state; the first eight are the estimate.
        memory: Numbers of the law's memory.
    """

    functions: list[str]
    constants: list[Constant]
    states: int
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

    def copy_of(self, source: Any, prefix: str) -> Any:
        """A copy of a law, observer, model or clamp with symbols.

        Args:
            source: The object; it is not changed.
            prefix: How the names of its tables begin, in capitals.
        """
        cls: Any = type(source)
        found = object.__new__(cls)
        texts = meanings(cls)
        cached = {
            name for name in vars(source) if isinstance(getattr(cls, name, None), cached_property)
        }
        for name, value in vars(source).items():
            if name not in cached:
                text = texts.get(name, "")
                found.__dict__[name] = self.symbols_of(name, value, prefix, text)
        return found

    def symbols_of(self, name: str, value: Any, prefix: str, meaning: str) -> Any:
        """Symbols in place of a number or an array of them; else the value itself."""
        if isinstance(value, BallPlate):
            if value not in self._models:
                self._models[value] = self.copy_of(value, "MODEL")
            return self._models[value]
        if isinstance(value, bool | int | str) or value is None:
            return value
        try:
            numbers = np.asarray(value, float)
        except (TypeError, ValueError):
            return value
        if not numbers.size or not np.isfinite(numbers).all():
            return value
        title = f"{prefix}_{name.strip('_').upper()}"
        if any(each.name == title for each in self.each):
            title += "_2"
        column, symbols = new_symbols(title, *numbers.shape)
        table = numbers.ravel().tolist()
        self.each.append(Constant(title, table, meaning, column, not numbers.ndim))
        result = np.asarray(symbols).copy()
        result[numbers == 0] = 0.0
        return as_symbols(result) if numbers.ndim else result.item()


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
        mine, own = tables.copy_of(law, "LAW"), tables.copy_of(observer, "OBSERVER")
        clamp = tables.copy_of(Clamp(limits, period), "CLAMP")
        share = tables.symbols_of(
            "share",
            period / Supervisor.DRIFT_TIME_S,
            "DRIFT",
            "Share of its drift by which the commanded plate angle is corrected in a period.",
        )
        constants = tables.each
        functions = [
            *_observer_functions(own, observer, constants, real),
            *_law_functions(mine, constants, real),
            *_command_functions(clamp, share, constants, real),
        ]
    except NoSymbolicFormError as error:
        raise ScenarioError(f"'{law.name}' with '{observer.name}': {error}") from error
    states = sum(each.size for each in _states(observer).values())
    text = "\n".join(functions)
    used = [each for each in tables.each if re.search(rf"\b{each.name}\b", text)]
    return Traced(functions, used, states, law.memory)


def _states(observer: Observer) -> dict[str, Array]:
    """The attributes that an observer changes in a run, as they begin at rest, one rig."""
    before = {name: id(value) for name, value in vars(observer).items()}
    observer.start(np.zeros((1, 8)))
    changed = {n: v for n, v in vars(observer).items() if before.get(n) != id(v)}
    return {"x": changed.pop("x"), **changed}


def _observer_functions(
    own: Observer, observer: Observer, constants: list[Constant], real: str
) -> list[str]:
    """The C functions start, observe_touched, observe_untouched and predict."""
    shapes = {name: value.shape for name, value in _states(observer).items()}

    def state_of() -> list[Any]:
        return [each for name in shapes for each in expressions(getattr(own, name))]

    def begin() -> Any:
        """Symbols for the state."""
        sizes = [int(np.prod(shape)) for shape in shapes.values()]
        column, symbols = new_symbols("state", sum(sizes))
        parts = np.split(symbols.view(np.ndarray), np.cumsum(sizes)[:-1])
        for (name, shape), part in zip(shapes.items(), parts, strict=True):
            setattr(own, name, as_symbols(part.reshape(shape)))
        return column

    y_column, y = new_symbols("y", 1, 4)
    x = as_symbols(np.zeros((1, 8), object))
    x[..., 0::2] = y
    own.start(x)
    found = [c_function("start", {"y": y_column}, {"state": state_of()}, constants, real)]
    for touched in (True, False):
        column = begin()
        own.correct(Measurement(0.0, y.copy(), np.zeros(1), np.full(1, touched)))
        name = "observe_touched" if touched else "observe_untouched"
        inputs = {"state": column, "y": y_column}
        found.append(c_function(name, inputs, {"after": state_of()}, constants, real))
    column = begin()
    u_column, u = new_symbols("u", 1, 2)
    own.predict(u)
    inputs = {"state": column, "u": u_column}
    found.append(c_function("predict", inputs, {"after": state_of()}, constants, real))
    return found


def _law_functions(mine: Law, constants: list[Constant], real: str) -> list[str]:
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
    u = expressions(mine.command(now))
    found = [c_function("control", inputs, {"u": u}, constants, real)]
    if mine.memory:
        slope = mine.memory_rate(0.0, x, reference, q)  # type: ignore[arg-type]
        rates = {"q_rate": expressions(slope)}
        found.append(c_function("memory_rate", inputs, rates, constants, real))
    return found


def _command_functions(clamp: Clamp, share: Any, constants: list[Constant], real: str) -> list[str]:
    """The C functions correct_angle and clamp, for both axes."""
    requested_column, requested = new_symbols("requested", 2)
    rate_column, rate = new_symbols("rate", 2)
    angle_column, angle = new_symbols("angle", 2)
    seen_column, seen = new_symbols("measured", 2)
    corrected = expressions(correct_angle(angle, seen - angle, share))
    inputs = {"angle": angle_column, "measured": seen_column}
    found = [c_function("correct_angle", inputs, {"after": corrected}, constants, real)]
    each = [
        clamp.allowed(SYMBOL_ARITHMETIC, *of) for of in zip(requested, rate, angle, strict=True)
    ]
    inputs = {"requested": requested_column, "rate": rate_column, "angle": angle_column}
    found.append(c_function("clamp", inputs, {"allowed": expressions(each)}, constants, real))
    return found
