"""Laws and observers about the level plate with the ball on the centre, as linear systems.

Both are taken as they are: their own methods are asked for the answer to small deviations.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BALL
from controllers.interfaces import Law, Measurement, Observer, Reference
from controllers.references.point import Hold
from controllers.smith import Smith

STEP = 1e-4
ORIGIN = Hold()


class System(NamedTuple):
    """x' = A x + B u, y = C x + D u; or, with a period, the same from one tick to the next."""

    A: Array
    B: Array
    C: Array
    D: Array
    period: float = 0.0
    """Seconds per tick; 0 for continuous time."""


def linear_law(law: Law) -> System:
    """A law as a system from the state x, shape (8,), to u; its own states are its memory.

    Raises:
        ValueError: If the law has no linearisation, as a sliding mode has none.
    """
    if type(law).control is Law.control:
        raise ValueError(f"law '{law.name}' acts by command alone: it has no linearisation")
    J = _law_jacobian(law, STEP)
    if np.abs(J - _law_jacobian(law, STEP / 10)).max() > 1e-3 * np.abs(J).max():
        raise ValueError(f"law '{law.name}' has no linearisation about the level plate")
    return System(A=J[2:, 8:], B=J[2:, :8], C=J[:2, 8:], D=J[:2, :8])


def tracking_law(law: Law) -> System:
    """A law as a system from (state, desired position), shape (10,), to u.

    The desired position stands still as far as the law knows: its derivatives are zero.

    Raises:
        ValueError: If the law has no linearisation.
    """
    A, B, C, D, _ = linear_law(law)
    ahead = []
    for axis in ("x", "y"):
        there, back = (_answer_to(law, Hold(**{axis: way * STEP})) for way in (1, -1))
        ahead.append((there - back) / (2 * STEP))
    J = np.stack(ahead, axis=-1)
    return System(A, np.hstack([B, J[2:]]), C, np.hstack([D, J[:2]]))


def _answer_to(law: Law, reference: Reference) -> Array:
    """(u, memory rate) of a law at rest on the centre that is asked for another path."""
    x, q = np.zeros((1, 8)), np.zeros((1, law.memory))
    u, slope = law.control(0.0, x, reference, q), law.memory_rate(0.0, x, reference, q)
    out: Array = np.concatenate([u, slope], axis=-1)[0]
    return out


def _law_jacobian(law: Law, step: float) -> Array:
    """Derivative of (u, memory rate) by (x, memory), by central differences."""
    ahead = step * np.eye(8 + law.memory)

    def both(s: Array) -> Array:
        x, q = s[:, :8], s[:, 8:]
        u = law.control(0.0, x, ORIGIN, q)
        return np.concatenate([u, law.memory_rate(0.0, x, ORIGIN, q)], axis=-1)

    return (both(ahead) - both(-ahead)).T / (2 * step)


def linear_controller(law: Law, observer: Observer) -> System:
    """Law and observer at the control period, from the measurement y, shape (4,), to u.

    A Smith predictor around the observer is taken in. An observer whose gain varies, the EKF, has
    the one it starts with.

    Raises:
        ValueError: If the law has no linearisation, or the observer keeps what it remembers
            elsewhere than in arrays of its own.
    """
    linear_law(law)
    if isinstance(observer, Smith):
        return _with_predictor(_Tick(law, observer.observer), observer.delay)
    return _Tick(law, observer).system()


class _Tick:
    """One tick of law and observer as a map of small deviations.

    The inputs are y (4), the outputs u (2), the corrected ball position (2) and the predicted one
    (2), the states the observer's memory and the law's.
    """

    def __init__(self, law: Law, observer: Observer) -> None:
        self._law = law
        self._observer = observer
        self._names = self._memory_names()
        self._sizes = [vars(self._started(1))[name].size for name in self._names]
        self.period = observer.period
        n = sum(self._sizes) + law.memory
        ahead = STEP * np.eye(n + 4)
        J = (self._answer(ahead) - self._answer(-ahead)).T / (2 * STEP)
        self.A, self.B = J[:n, :n], J[:n, n:]
        self.C, self.D = J[n:, :n], J[n:, n:]
        self._verify()

    def system(self) -> System:
        """The tick without its second and third output."""
        return System(self.A, self.B, self.C[:2], self.D[:2], self.period)

    def _started(self, rigs: int) -> Observer:
        observer = deepcopy(self._observer)
        observer.start(np.zeros((rigs, 8)))
        return observer

    def _memory_names(self) -> list[str]:
        """Arrays of the observer that a small deviation of its state changes to first order."""
        deviation = STEP * np.random.default_rng(0).uniform(0.5, 1, (1, 8))
        after = []
        for x in (np.zeros((1, 8)), deviation):
            observer = deepcopy(self._observer)
            observer.start(x)
            observer.correct(_measurement(np.zeros((1, 4))))
            observer.predict(np.zeros((1, 2)))
            after.append(vars(observer))
        arrays = [name for name, value in after[0].items() if isinstance(value, np.ndarray)]
        moved = {name: np.abs(after[1][name] - after[0][name]).max() for name in arrays}
        return [name for name in arrays if moved[name] > 1e-3 * STEP]

    def _answer(self, s: Array) -> Array:
        """States and outputs after a tick, for a row of states and inputs each."""
        rigs, n = len(s), s.shape[1] - 4
        observer: Any = self._started(rigs)
        begin = 0
        for name, size in zip(self._names, self._sizes, strict=True):
            shape = getattr(observer, name).shape
            setattr(observer, name, s[:, begin : begin + size].reshape(shape).copy())
            begin += size
        q, y = s[:, begin:n], s[:, n:]
        before = observer.x[:, BALL].copy()
        observer.correct(_measurement(y))
        x = observer.equivalent.copy()
        u = self._law.control(0.0, x, ORIGIN, q)
        q = q + observer.period * self._law.memory_rate(0.0, x, ORIGIN, q)
        x = observer.x.copy()
        observer.predict(u)
        kept = [getattr(observer, name).reshape(rigs, -1) for name in self._names]
        return np.concatenate([*kept, q, u, x[:, BALL], before], axis=-1)

    def _verify(self) -> None:
        """Compare five ticks with the real observer: what hides elsewhere shows."""
        observer, q = self._started(1), np.zeros((1, self._law.memory))
        s = np.zeros(len(self.A))
        for y in STEP * np.random.default_rng(1).normal(size=(5, 1, 4)):
            observer.correct(_measurement(y))
            x = observer.equivalent.copy()
            real = self._law.control(0.0, x, ORIGIN, q)[0]
            q = q + self.period * self._law.memory_rate(0.0, x, ORIGIN, q)
            observer.predict(real[np.newaxis])
            linear = self.C[:2] @ s + self.D[:2] @ y[0]
            s = self.A @ s + self.B @ y[0]
        if np.abs(linear - real).max() > 1e-2 * np.abs(real).max():
            raise ValueError(f"observer '{self._observer.name}' cannot be linearised")


def _measurement(y: Array) -> Measurement:
    rigs = y.shape[:-1]
    return Measurement(0.0, y, np.zeros(rigs), np.ones(rigs, bool))


def _with_predictor(tick: _Tick, delay: float) -> System:
    """Close the loop of (7.19) around a tick: the ball's innovation is that of a dead time ago.

    The observer sees y + xbar - xhat[k - w], with the corrected estimates of the last w ticks kept
    and a straight line between two of them for a dead time that is no multiple of the period.
    """
    w, share = whole_periods(delay, tick.period)
    n, kept = len(tick.A), 2 * (w + 1)
    Y = np.zeros((4, n + kept))
    Y[0::2, :n] = tick.C[4:] * (1.0 if w else share)
    for back, weight in ((w, 1 - share), (w + 1, share)):
        if back:
            Y[0::2, n + 2 * back - 2 : n + 2 * back] -= weight * np.eye(2)
    shift = np.zeros((kept, n + kept))
    shift[:2, :n] = tick.C[2:4]
    shift[2:, n:-2] = np.eye(kept - 2)
    into = np.concatenate([tick.B, tick.D[2:4], np.zeros((kept - 2, 4))])
    A = np.concatenate([np.eye(n, n + kept), shift])
    A[:n, :n] = tick.A
    C = np.concatenate([tick.C[:2], np.zeros((2, kept))], axis=1)
    return System(A + into @ Y, into, C + tick.D[:2] @ Y, tick.D[:2], tick.period)


def whole_periods(delay: float, period: float) -> tuple[int, float]:
    """Periods in a delay: the whole ones, and the rest as a share of a period."""
    periods = delay / period
    whole = int(periods + 1e-9)
    return whole, max(periods - whole, 0.0)
