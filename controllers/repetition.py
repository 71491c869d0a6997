"""Laws against what repeats: an internal model of disturbances, and learning from lap to lap."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
import scipy
from annotated_types import Ge, Gt, Lt

from controllers.arrays import Array, NotNegative, Positive
from controllers.ballplate import TILT_SIGN, BallPlate
from controllers.interfaces import Feedback, Law, Reference
from controllers.stable_inversion import AboutMotion, DesiredMotion, MotionPlan, flat_axis
from controllers.two_sided import Tilts


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
    remembers, at rest, where it pushes a ball that sticks until it leaps, and on rigs with a
    different dead time or different drives.

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
        """S of the memory of an axis, q' = S q + b e, shape (1 + 2 n, 1 + 2 n)."""
        turning = [np.array([[0.0, w], [-w, 0.0]]) for w in self.frequencies]
        return scipy.linalg.block_diag(np.zeros((1, 1)), *turning)

    def _driven(self) -> Array:
        """The vector b of it, shape (1 + 2 n,)."""
        return np.array([1.0, *[0.0, 1.0] * len(self.frequencies)])

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        r, k1, K = reference(t), self.model.k1, self.K
        slope, rate = TILT_SIGN * x[..., 2::4] - r[2] / k1, TILT_SIGN * x[..., 3::4] - r[3] / k1
        e, e_rate = x[..., 0::4] - r[0], x[..., 1::4] - r[1]
        u = r[4] / k1 - K[0] * e - K[1] * e_rate - K[2] * slope - K[3] * rate
        return TILT_SIGN * (u - K[4:] @ self._by_axis(q))

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """S q + b e of either axis, shape (..., memory)."""
        e = x[..., 0::4] - reference(t)[0]
        slope = self.oscillators() @ self._by_axis(q) + self._driven()[:, None] * e[..., None, :]
        return slope.reshape(q.shape)

    def _by_axis(self, q: Array) -> Array:
        """The memory of both axes side by side, shape (..., 1 + 2 n, 2)."""
        return q.reshape(*q.shape[:-1], -1, 2)


MAX_LAP_DIFFERENCE_M = 1e-3
"""Distance in m by which a lap of the reference that is learnt from may differ from the last."""
LAP_CHECK_INSTANTS = 64
"""Instants of a lap at which that is looked at."""


@dataclass(frozen=True, kw_only=True)
class IterativeLearning(AboutMotion):
    """Follows r + c, with a correction c over the phase of the lap that is learnt lap by lap.

    Arimoto, Kawamura and Miyazaki (1984, "Bettering operation of robots by learning"); as a table
    of harmonics, which is their filter of learning made a low-pass of zero phase (Bristow, Tharayil
    and Alleyne 2006, "A survey of iterative learning control"):

        c(t) = C0 + sum over h of  Re(Ch exp(j h w t)),    Ch <- Ch + gain Eh,

    where Eh are the harmonics of the error r - x over the lap that has ended. The plate's motion
    for c is the stable inverse of each harmonic, a = (c'' / k1) / (1 + (h w / Z)^2), and the
    feedback is about both. A loop that follows r + c with the transfer T leaves |1 - gain T| of a
    lap's repeating error. What has been learnt comes in over ``fade`` on a lap from which nothing
    is learnt. Nothing is learnt either from a lap with a reference unlike the lap before: the
    start, a jump and a path without laps.

    Good at whatever repeats, friction and uneven surface too, without a model of it; bad at what
    does not: it needs minutes of laps, knows one path, and learns the noise of the last laps.

    Raises:
        ValueError: If a setting is not finite or out of range.
    """

    name: ClassVar[str] = "iterative_learning"

    omega: Annotated[float, Ge(1e-3)] = 0.75
    """Frequency w of the lap in rad/s: a lap takes 2 pi / w."""
    harmonics: Annotated[int, Ge(1)] = 8
    """Highest harmonic of the lap that is learnt."""
    gain: Annotated[float, Gt(0), Lt(2)] = 0.7
    """Part of the error of a lap that is taken away on the next, above 0 and below 2."""

    fade: Annotated[float, Ge(1e-3)] = 1.0
    """Time in s over which what a lap taught comes in."""

    def start(self, x: Array, reference: Reference, period: float) -> Laps:
        """The motion, and a table with nothing learnt."""
        motion = MotionPlan(self, x, reference, period)
        return Laps(self, motion, x, reference)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2), and what there is to learn."""
        return self.about(now.equivalent, *now.plan.at(now.time, now.x))


class Laps:
    """What has been learnt in one run, and the sums of the lap that is under way.

    Args:
        law: Who learns.
        motion: Of ball and plate without what is learnt.
        x: State at the start, shape (..., 8).
        reference: Path of the ball.
    """

    def __init__(
        self, law: IterativeLearning, motion: MotionPlan, x: Array, reference: Reference
    ) -> None:
        self._law, self._motion, self._reference = law, motion, reference
        order = np.arange(law.harmonics + 1)
        self._pulse = order * law.omega
        self._inverse = inverse_of(law.model, self._pulse)
        self.table = np.zeros((len(order), *x.shape[:-1], 2), complex)
        """C0 to CH of x and y, m, shape (harmonics + 1, ..., 2)."""
        self._before = self._sum = np.zeros_like(self.table)
        self._since = 0.0
        self._count = self._lap = 0

    def at(self, t: float, x: Array) -> DesiredMotion:
        """What is wanted at a time in s, and take in the error of then."""
        wanted = self._motion.at(t)
        lap = math.floor(t * self._law.omega / (2 * math.pi) + 1e-9)
        if lap > self._lap:
            self._learn(lap, t)
        turn = np.exp(1j * self._pulse * t)
        share = np.tensordot(self._inverse * turn, self._present(t), axes=1).real
        error = self._reference(t)[0] - x[..., 0::4]
        self._sum = self._sum + np.multiply.outer(turn.conj(), error)
        self._count += 1
        slope = wanted.slope
        return DesiredMotion(
            wanted.position + share[0],
            wanted.velocity + share[1],
            Tilts(slope.angle + share[2], slope.rate + share[3], slope.acceleration + share[4]),
        )

    def _present(self, t: float) -> Array:
        """The table as far as it has come in."""
        part = min((t - self._since) / self._law.fade, 1.0)
        share = part**3 * (10 - 15 * part + 6 * part * part)
        return self._before + share * (self.table - self._before)

    def _learn(self, lap: int, t: float) -> None:
        """Take the lap that has ended into the table, every second one, and begin the next."""
        if self._lap % 2:
            found = self._sum / max(self._count, 1)
            found[1:] *= 2  # of a real signal the harmonics but the mean come twice
            self._before, self._since = self._present(t), t
            self.table = self.table + self._law.gain * self._repeated() * found
        self._sum, self._count, self._lap = np.zeros_like(self._sum), 0, lap

    def _repeated(self) -> Array:
        """1 for rigs with a reference that repeated the lap before, else 0, shape (..., 1)."""
        length = 2 * math.pi / self._law.omega
        times = np.linspace(0, length, LAP_CHECK_INSTANTS, endpoint=False) + self._lap * length
        change = np.abs(self._reference(times)[0] - self._reference(times - length)[0]).max(axis=0)
        return (change.max(axis=-1, keepdims=True) < MAX_LAP_DIFFERENCE_M).astype(float)


def inverse_of(model: BallPlate, pulse: Array) -> Array:
    """Position and velocity of a harmonic of the ball, and the plate's slope that gives it.

    Args:
        model: Ball and plate.
        pulse: Frequencies of the harmonics in rad/s, shape (H + 1,).

    Returns:
        What exp(j h w t) is taken times: for position, velocity, slope, its rate and acceleration,
        shape (5, H + 1).
    """
    s = 1j * pulse
    a = s * s / (model.k1 - model.c2 * s * s)
    return np.array([np.ones_like(s), s, a, s * a, s * s * a])
