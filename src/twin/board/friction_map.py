"""``friction_map_kalman`` in C: its equations, cut where the covariance and the map are needed.

Loops over the points of the map cannot be one graph of symbols. They are written in C, together
with the covariance. Everything else is the Python code, run on symbols. It is cut at the four
places where it needs the loops: the values that it passes there are the result of one C function,
and the values that it receives are inputs of the next one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Measurement
from controllers.observers import FrictionKalman, FrictionMapKalman
from controllers.observers.friction import FRICTION_INDEX, PENDING_SAMPLES, diagonal
from controllers.observers.friction_map import gaussian_field
from controllers.observers.late_ball import LocalState
from twin.board.symbols import SymbolArray, as_symbols, expressions, new_symbols


class Cuts:
    """What the equations get from the C code around them, and what they give it.

    Attributes:
        columns: The symbols that they get, by name, for CasADi: the covariance of eta and eta'
            (4, 4) and the variances of the other states (5); the change of the nine states by a
            sample; friction and disturbance (x, y) of the map at the ball's place then and now; the
            camber (2).
        given: The same as arrays.
        found: What they give, by the name of the C function.
    """

    def __init__(self) -> None:
        sizes = {"covariance": 21, "change": 9, "there": 3, "now": 3, "camber": 2}
        both = {name: new_symbols(name, 1, size) for name, size in sizes.items()}
        self.columns = {name: column for name, (column, _) in both.items()}
        self.given = {name: symbols for name, (_, symbols) in both.items()}
        self.found = dict[str, list[Any]]()


@dataclass(kw_only=True)
class LocalFriction(FrictionKalman):
    """``friction_map_kalman`` at the ball's place, without map and covariance."""

    cuts: Cuts = field(default_factory=Cuts)
    camber_spread: float = 0.0

    @classmethod
    def of(cls, observer: FrictionMapKalman) -> LocalFriction:
        """The equations of an observer."""
        found = object.__new__(cls)
        found.__dict__.update(vars(observer), cuts=Cuts())
        return found

    def start(self, x: Array) -> None:
        """Begin at the state x, shape (1, 8)."""
        super().start(x)
        self._P = _none()

    def correct(self, measurement: Measurement) -> Array:
        """The estimate; its covariance is kept elsewhere."""
        x = super().correct(measurement)
        self.cuts.found["struck"] = expressions(self._P[0, :4, :4])
        self._P = _none()
        return x

    @property
    def camber(self) -> Array:
        """The camber of the map, shape (1, 2)."""
        return self.cuts.given["camber"] if self.camber_spread else super().camber

    def _propagate(self, A: Array) -> None:
        """Give A of (K4); get the covariance, with a unit matrix in the columns of d."""
        rows, columns = zip(*DERIVATIVES, strict=True)
        self.cuts.found["advance"] = expressions(A[0, rows, columns])
        self._P, given = _none(), self.cuts.given["covariance"][0]
        self._P[0, :4, :4] = given[:16].reshape(4, 4)
        diagonal(self._P)[0, 4:] = given[16:]
        self._P[0, (0, 1), (4, 5)] = 1.0

    def _reduce(self, W: Array, moving: Any) -> None:
        """Give the variances and L^-1 of (K6), which W has in the columns of the unit matrix."""
        weights = [*diagonal(self._P)[0], W[0, 0, 4], W[0, 1, 4], W[0, 1, 5], moving]
        self.cuts.found["weigh"] = expressions(weights)
        self._P = _none()

    def _correct_by(self, change: Array) -> None:
        """Give the innovation times L'^-1, which is in the same columns; get the change."""
        self.cuts.found["weigh"] += expressions(change[0, 4:6])
        change[...] = self.cuts.given["change"]
        super()._correct_by(change)

    def _at(self, place: Any, which: int) -> LocalState:
        """Give the ball's place; get the friction and the disturbance of the map there."""
        name = ("there", "now")[which]
        self.cuts.found[f"place_{name}"] = expressions(list(place))
        (friction, *disturbance), s = self.cuts.given[name][0], list(self._s)
        s[FRICTION_INDEX] = self._by.most(s[FRICTION_INDEX] + friction, 0.0)
        if self.camber_spread:
            s[4:6] = [a + b for a, b in zip(s[4:6], disturbance, strict=True)]
        return LocalState(s)


DERIVATIVES = ((2, 2), (2, 3), (3, 2), (3, 3), (2, 6), (3, 7), (2, 8), (3, 8))
"""Places of the entries of A of (K4) that are neither 0, 1 nor the period."""


def _none() -> SymbolArray:
    return as_symbols(np.zeros((1, 9, 9), object))


class FrictionMap(NamedTuple):
    """Numbers of the map's C code.

    Attributes:
        lines: Lines of the map's grid along x and y.
        size: Points of the map, and the camber along x and y if it is estimated.
        sides: Extent of the map along x and y, m.
        spread: Prior standard deviation of the friction from place to place, m/s^2.
        length: Distance over which it varies, m.
        camber: Prior standard deviation of the camber, 1/s^2; 0 if it is not estimated.
        most_camber: Largest camber, 1/s^2.
        pending: Samples by which the covariance of the map is updated at once.
        variances: Of the nine states at the start.
    """

    lines: tuple[int, ...]
    size: int
    sides: tuple[float, float]
    spread: float
    length: float
    camber: float
    most_camber: float
    pending: int
    variances: Array

    @property
    def numbers(self) -> int:
        """Numbers that it keeps."""
        rows = 1 + 9 + 4 * self.pending + (6 if self.camber else 4)
        return self.size * (self.size + 1) // 2 + rows * self.size + 9 * 9 + 6


def map_of(observer: FrictionMapKalman) -> FrictionMap:
    """The numbers of an observer's map."""
    field = observer.map_sides, observer.map_pitch, observer.map_spread, observer.map_length
    lines, prior = gaussian_field(*field)
    return FrictionMap(
        lines,
        len(prior) + 2 * bool(observer.camber_spread),
        observer.map_sides,
        observer.map_spread,
        observer.map_length,
        observer.camber_spread,
        observer.bounds.camber_per_s2,
        PENDING_SAMPLES,
        np.diag(observer._begin),
    )
