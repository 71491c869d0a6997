"""The state of an observer: which of its numbers a period changes, wherever it keeps them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import cached_property
from itertools import count
from typing import Any

import casadi as ca
import numpy as np

from controllers.ballplate import BallPlate
from controllers.interfaces import Measurement, Observer
from twin.board.symbols import Symbol, as_symbols, expressions, new_symbols


def is_part(value: Any) -> bool:
    """Whether a value is an object of a law or observer that has numbers of its own."""
    own = type(value).__module__.partition(".")[0] == "controllers" or isinstance(value, Observer)
    return own and not isinstance(value, tuple | BallPlate)


def changed_fields(source: Any, change: Callable[[str, Any], Any]) -> Any:
    """A copy of an object with its fields changed.

    Args:
        source: The object; it is not changed.
        change: Gives the new value from the name and the value of a field, ``x`` first.
    """
    cls: Any = type(source)
    found = object.__new__(cls)
    for name, value in sorted(vars(source).items(), key=lambda item: item[0] != "x"):
        if not isinstance(getattr(cls, name, None), cached_property):
            found.__dict__[name] = change(name, value)
    return found


def changed_numbers(value: Any, change: Callable[[Any, Any], Any], queue: Any = None) -> Any:
    """A copy of an observer, or of something within it, with its numbers changed, in an order.

    Args:
        value: The observer; it is not changed.
        change: Gives the new number from the old one and the queue that has it, None for none.
        queue: The queue that has the value.
    """
    if isinstance(value, Symbol | float | int | np.generic):
        return change(value, queue)
    if isinstance(value, np.ndarray):
        found = np.empty(value.size, object)
        found[:] = [change(each, queue) for each in value.ravel().tolist()]
        return as_symbols(found.reshape(value.shape))
    if isinstance(value, deque):
        return deque((changed_numbers(each, change, value) for each in value), value.maxlen)
    if isinstance(value, list | tuple):
        parts = [changed_numbers(each, change, queue) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if is_part(value):
        return changed_fields(value, lambda _, field: changed_numbers(field, change, queue))
    return value


def copy(observer: Any) -> Any:
    """A copy of an observer that can be run without changing it."""
    return changed_numbers(observer, lambda number, _: number)


class ObserverState:
    """The numbers that a period changes in an observer of one rig, the estimate first.

    They are found by running periods on symbols, with symbols for those found so far, until there
    are no more.

    Args:
        observer: The observer; it is not changed.

    Attributes:
        y: Symbols of the first measurement.
        begun: The observer at rest at that measurement.
        now: The same with symbols for its state.
        symbols: These, a list of CasADi's.
    """

    def __init__(self, observer: Observer) -> None:
        self.y, y = new_symbols("y", 1, 4)
        x = as_symbols(np.zeros((1, 8), object))
        x[..., 0::2] = y
        self.begun = copy(observer)
        self.begun.start(x)
        self._places, found = set[int](), set(range(8))
        while found - self._places:
            self._places |= found
            column, symbols = new_symbols("state", len(self._places))
            self.symbols, each, index = ca.vertsplit(column), iter(symbols), count()
            self.now = changed_numbers(
                self.begun,
                lambda number, _, each=each, index=index: (  # type: ignore[misc]
                    next(each) if next(index) in self._places else number
                ),
            )
            found = self._changed()

    def of(self, observer: Any) -> list[Any]:
        """The state of a copy of the observer, CasADi's expressions."""
        numbers = _numbers(observer)
        return expressions([numbers[place][0] for place in sorted(self._places)])

    def _changed(self) -> set[int]:
        """The places of the numbers that a period changes; of a queue all of them."""
        after = copy(self.now)
        measure(after, True)
        after.predict(new_symbols("u", 1, 2)[1])
        old, new = _numbers(self.now), _numbers(after)
        changed = [not _is_same(*each) for each in zip(old, new, strict=True)]
        queues = {queue for (_, queue), moved in zip(old, changed, strict=True) if moved} - {None}
        return {i for i, (_, queue) in enumerate(old) if changed[i] or queue in queues}


def measure(observer: Any, touched: Any) -> dict[str, Any]:
    """Have an observer take in a measurement of symbols, which are returned by name."""
    y_column, y = new_symbols("y", 1, 4)
    age_column, age = new_symbols("age", 1)
    observer.correct(Measurement(0.0, y, age, np.full(1, touched)))
    return {"y": y_column, "age": age_column}


def _numbers(observer: Any) -> list[tuple[Any, int | None]]:
    """The numbers of an observer, each with what names the queue that has it."""
    found = list[tuple[Any, int | None]]()
    changed_numbers(observer, lambda number, queue: found.append((number, queue and id(queue))))
    return found


def _is_same(old: tuple[Any, Any], new: tuple[Any, Any]) -> bool:
    before, after = expressions([old[0], new[0]])
    return bool(ca.is_equal(before, after, 1))
