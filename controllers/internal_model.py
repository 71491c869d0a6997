"""Output regulation: an internal model of what disturbs the ball takes its effect away."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import scipy

from controllers.about_motion import flat_axis
from controllers.arrays import Array
from controllers.ballplate import SIGN
from controllers.interfaces import Law, Reference
from controllers.ranges import NotNegative, Positive


@dataclass(frozen=True, kw_only=True)
class InternalModel(Law):
    """Regulator with an integrator and oscillators at the reference's frequencies in each axis.

    Whatever disturbs an axis at these frequencies, and a reference at them, leaves no error in the
    steady state, if only the loop is stable: the regulator equations of Byrnes and Isidori (1990,
    "Output regulation of nonlinear systems") have a solution for them, and a copy of what makes
    them, driven by the error, finds it without knowing the plant exactly; for linear plants Francis
    and Wonham (1976, "The internal model principle of control theory"). With e = x - r, either axis
    (slopes a = (phi, -theta)) has the memory

        q0' = e,    q1' = w q2,    q2' = -w q1 + e    for each frequency w,

    and the law a'' = r''''/k1 - K (e, e', a - r''/k1, a' - r'''/k1) - Kq q, with (K, Kq) of the
    linear-quadratic regulator of x'' = k1 a - c2 a'' (5.35) with this memory, all of it made to die
    out with ``decay`` at least (Anderson and Moore 1990, "Optimal control", 3.5).

    What the flat model of the first terms leaves out is among what disturbs.

    Good at a circle of known frequency without a model of friction; bad at jumps, which it
    remembers, at rest, where it pushes a ball that sticks until it leaps, and on rigs whose dead
    time or drives differ.

    The memory is integrated by Euler's rule once a control period T, as every law's: an oscillator
    then grows by w^2 T / 2 in a second, which the loop holds.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign, or a frequency is given twice.
    """

    name: ClassVar[str] = "internal_model"

    frequencies: tuple[Positive, ...] = (0.75,)
    """Frequencies w in rad/s: the reference's, and what of its multiples is to be taken away."""
    Q: tuple[NotNegative, NotNegative, NotNegative, NotNegative] = (2000.0, 200.0, 100.0, 10.0)
    """Weights of error (m), its rate, slope (rad) and its rate; the slope's acceleration has 1."""
    memory_weight: Positive = 100.0
    """Weight of every state of the memory, 1/(m s)^2."""
    decay: NotNegative = 0.2
    """Rate in 1/s by which all that is wrong dies out at least."""

    K: Array = field(init=False, repr=False, compare=False)
    """Gain from error, its rate, slope, its rate and memory, shape (5 + 2 frequencies,)."""

    def __post_init__(self) -> None:
        """Check the settings and compute the gain once."""
        super().__post_init__()
        if len(set(self.frequencies)) != len(self.frequencies):
            raise ValueError(f"frequencies must differ, got {list(self.frequencies)}")
        S, count = self.oscillators(), 1 + 2 * len(self.frequencies)
        A, B = np.zeros((4 + count, 4 + count)), np.zeros((4 + count, 1))
        A[:4, :4], B[:4] = flat_axis(self.model)
        B[1] = -self.model.c2
        A[4:, 4:] = S
        A[4:, 0] = self._driven()
        Q = np.diag([*self.Q, *[self.memory_weight] * count])
        P = scipy.linalg.solve_continuous_are(A + self.decay * np.eye(len(A)), B, Q, np.eye(1))
        object.__setattr__(self, "K", P[3])
        object.__setattr__(self, "memory", 2 * count)

    def oscillators(self) -> Array:
        """Of the memory of an axis, q' = S q + b e: S, shape (1 + 2 n, 1 + 2 n)."""
        turning = [np.array([[0.0, w], [-w, 0.0]]) for w in self.frequencies]
        S: Array = scipy.linalg.block_diag(np.zeros((1, 1)), *turning)
        return S

    def _driven(self) -> Array:
        """The vector b of it, shape (1 + 2 n,)."""
        return np.array([1.0, *[0.0, 1.0] * len(self.frequencies)])

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        r, k1, K = reference(t), self.model.k1, self.K
        slope, rate = SIGN * x[..., 2::4] - r[2] / k1, SIGN * x[..., 3::4] - r[3] / k1
        e, e_rate = x[..., 0::4] - r[0], x[..., 1::4] - r[1]
        u = r[4] / k1 - K[0] * e - K[1] * e_rate - K[2] * slope - K[3] * rate
        out: Array = SIGN * (u - K[4:] @ self._by_axis(q))
        return out

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """S q + b e of either axis, shape (..., memory)."""
        e = x[..., 0::4] - reference(t)[0]
        slope = self.oscillators() @ self._by_axis(q) + self._driven()[:, None] * e[..., None, :]
        out: Array = slope.reshape(q.shape)
        return out

    def _by_axis(self, q: Array) -> Array:
        """The memory of both axes side by side, shape (..., 1 + 2 n, 2)."""
        return q.reshape(*q.shape[:-1], -1, 2)
