"""Laws beyond the thesis that know the motion to come, or what repeats of its errors.

Time-varying LQR about the reference; linear model predictive control, which keeps to what plate and
drives can do; output regulation by an internal model of what disturbs; learning from lap to lap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy
from annotated_types import Ge, Gt, Lt

from controllers.arrays import Array, NotNegative, Positive
from controllers.ballplate import TILT_SIGN, BallPlate
from controllers.interfaces import Feedback, Law, Reference
from controllers.stable_inversion import AboutMotion, DesiredMotion, MotionPlan, flat_axis
from controllers.two_sided import Tilts

__all__ = ["InternalModel", "IterativeLearning", "Predictive", "TimeVaryingLQR"]

GAIN_KNOT_S = 0.02
"""Time in s from one gain to the next."""
GAINS_PER_SWEEP = 25
"""Gains that are laid in one sweep."""


@dataclass(frozen=True, kw_only=True)
class TimeVaryingLQR(AboutMotion):
    """u = u*(t) + K(t) (x*(t) - x) about the motion x* that makes the ball follow the reference.

    With A(t), B(t) of the model (5.9) along the reference, K = R^-1 B'P, R = 1, and P of the
    differential Riccati equation, integrated backward in time (Kalman 1960, "Contributions to the
    theory of optimal control"; Anderson and Moore 1990, "Optimal control", chapter 2),

        -P' = A'P + P A - P B B'P + Q,

    from ``horizon`` after the end of each half second of gains, where it begins with the solution
    about the level plate. The sweep is done tick by tick, half a second before its gains are used.

    Good at fast motion far from the level plate; at the speeds of this rig the plant is so nearly
    linear that it gains nothing over a constant K, and it knows of no friction.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "tvlqr"

    horizon: Annotated[float, Ge(GAIN_KNOT_S)] = 1.5
    """Time in s over which P forgets where it began; the reference is asked a second further."""

    def start(self, x: Array, reference: Reference, period: float) -> VaryingGain:
        """The motion and the gains of the first half second."""
        motion = MotionPlan(self, x, reference, period)
        return VaryingGain(self, motion, reference, period)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        K, wanted = now.plan.gain(now.time), now.plan.motion.at(now.time)
        x = now.equivalent.copy()
        x[..., 0::4] -= wanted.position
        x[..., 1::4] -= wanted.velocity
        x[..., 2::4] -= TILT_SIGN * wanted.slope.angle
        x[..., 3::4] -= TILT_SIGN * wanted.slope.rate
        return TILT_SIGN * wanted.slope.acceleration - np.einsum("...ij,...j->...i", K, x)

    def weight(self) -> Array:
        """Q as a weight of the state (5.5), shape (8, 8)."""
        flat = np.zeros((8, 8))
        for axis, sign in enumerate(TILT_SIGN):
            own = slice(4 * axis, 4 * axis + 4)
            flat[own, own] = np.diag((1.0, 1.0, sign, sign))
            flat[own, own] += self.model.c2 * sign * np.eye(4, k=2)
        return flat.T @ np.diag((*self.Q, *self.Q)) @ flat


def along(model: BallPlate, reference: Reference, times: Array) -> tuple[Array, Array]:
    """The model (5.9) linearised along a reference, the plate as the flat model takes it.

    Returns:
        A and B of x' = A x + B u at K times, shapes (K, ..., 8, 8) and (K, ..., 8, 2).
    """
    r = reference(times)
    x = np.zeros((*r.shape[1:-1], 8))
    x[..., 0::4], x[..., 1::4] = r[0], r[1]
    x[..., 2::4], x[..., 3::4] = TILT_SIGN * r[2] / model.k1, TILT_SIGN * r[3] / model.k1
    return model.jacobian(x, TILT_SIGN * r[4] / model.k1), model.g(x)


def slope(P: Array, A: Array, B: Array, Q: Array) -> Array:
    """-P' = A'P + P A - P B B'P + Q, shape (..., 8, 8)."""
    PA, PB = P @ A, P @ B
    return PA + PA.swapaxes(-1, -2) - PB @ PB.swapaxes(-1, -2) + Q


class VaryingGain:
    """K(t) for one run, laid sweep by sweep.

    Args:
        law: The law with the weights of the gains.
        motion: The motion about which the plant is linearised.
        reference: The path along which the plant is linearised.
        period: Control period in s.
    """

    def __init__(
        self, law: TimeVaryingLQR, motion: MotionPlan, reference: Reference, period: float
    ) -> None:
        self.motion = motion
        self._law, self._reference, self._period = law, reference, period
        self._Q = law.weight()
        A, B, _ = law.model.linear()
        self._level = scipy.linalg.solve_continuous_are(A, B, self._Q, np.eye(2))
        self._knots = GAINS_PER_SWEEP + round(law.horizon / GAIN_KNOT_S)
        self._begin = -2 * GAINS_PER_SWEEP
        self._next = self._laid = np.zeros((GAINS_PER_SWEEP, 2, 8))
        self._sweep()
        self._turn()
        self._turn()

    def gain(self, t: float) -> Array:
        """K at a time in s that does not lie before the one asked for last, shape (..., 2, 8)."""
        knot = int(round(t / self._period) * self._period / GAIN_KNOT_S + 1e-9)
        while knot >= self._begin + GAINS_PER_SWEEP:
            self._turn()
        if self._left:
            self._step()
        return self._laid[knot - self._begin]

    def _turn(self) -> None:
        """Take the gains of the finished sweep, and begin the next one."""
        while self._left:
            self._step()
        self._laid = self._next
        self._begin += GAINS_PER_SWEEP
        self._sweep()

    def _sweep(self) -> None:
        """Begin the sweep for the gains after the next ones."""
        first = self._begin + GAINS_PER_SWEEP
        times = (first + np.arange(self._knots + 1)) * GAIN_KNOT_S
        self._A, self._B = along(self._law.model, self._reference, times)
        self._P = np.broadcast_to(self._level, self._A.shape[1:])
        self._left = self._knots
        self._next = np.empty((GAINS_PER_SWEEP, *self._B.shape[1:-2], 2, 8))

    def _step(self) -> None:
        """One step of the sweep backward in time, by the rule of Runge and Kutta."""
        A, B, Q, P, h = self._A, self._B, self._Q, self._P, GAIN_KNOT_S
        late, early = self._left, self._left - 1
        Am, Bm = (A[late] + A[early]) / 2, (B[late] + B[early]) / 2
        k1 = slope(P, A[late], B[late], Q)
        k2 = slope(P + h / 2 * k1, Am, Bm, Q)
        k3 = slope(P + h / 2 * k2, Am, Bm, Q)
        k4 = slope(P + h * k3, A[early], B[early], Q)
        self._P = P + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self._left = early
        if early < GAINS_PER_SWEEP:
            self._next[early] = B[early].swapaxes(-1, -2) @ self._P


MAX_SOLVER_ITERATIONS = 100
"""Iterations of the solver, to bound its time; three times what references far beyond the limits
were seen to take."""
SOFT_CONSTRAINT = 8
"""Flag of the solver for a soft constraint, which may be broken if the others leave no choice."""


@dataclass(frozen=True, kw_only=True)
class Predictive(AboutMotion):
    """Least cost over the horizon ahead, of all inputs that break no limit; the first is applied.

    About the motion x* that makes the ball follow the reference, either axis has the deviation
    z = (eta - eta*, eta' - eta*', a - a*, a' - a*') and, with the input held for ``step``,

        z(k+1) = A z(k) + B v(k),    a''(k) = a*''(k) + v(k)
        least  sum z'Q z + v^2 over k < N,  plus z(N)'P z(N)
        with |a''| <= acceleration, and |a'| <= rate, |a| <= angle as soft limits,

    P of the discrete Riccati equation, so that without limits the answer is the linear-quadratic
    regulator's, v = -K z, whatever N (Rawlings and Mayne 2009, "Model predictive control", chapters
    1 and 2). That answer is worked out first: where it breaks no limit it is the best, and no
    quadratic program is solved. The others are solved by the dual active set of DAQP (Arnstrom,
    Bemporad and Axehill 2022), axis by axis, in ``MOST`` iterations: where they do not suffice, or
    there is no solution, the previous solution's inputs for the coming steps are used, within the
    limit of acceleration. The period of the program is ``step``; between, v is held.

    Good at jumps and references beyond the limits, of which it asks no more than the drives can do;
    away from limits it is LQR with preview, and its slow period costs margin.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign, or the library is missing.
    """

    name: ClassVar[str] = "mpc"

    Q: tuple[NotNegative, NotNegative, NotNegative, NotNegative] = (5000.0, 1500.0, 100.0, 10.0)
    """Weights of eta (m), its rate, slope (rad) and its rate; the slope's acceleration has 1.
    Softer than those of other laws: an input that is held leaves less margin."""
    spread: NotNegative = 0.0
    """Time in s over which a jump of 0.15 m is spread; by default it is left to the limits."""
    step: Annotated[float, Ge(1e-3)] = 0.02
    """Period of the law in s, a multiple of the control period or rounded to it."""
    horizon: Annotated[float, Ge(1e-3)] = 0.8
    """How far it looks ahead, s."""
    angle_deg: Annotated[float, Ge(1e-3)] = 9.0
    """Limit of the plate's angle, deg."""
    rate_deg: Annotated[float, Ge(1e-3)] = 30.0
    """Limit of its rate, deg/s."""
    acceleration: Annotated[float, Ge(1e-3)] = 6.0
    """Limit of its acceleration, rad/s^2."""

    A: Array = field(init=False, repr=False, compare=False)
    """State matrix of a step of an axis, shape (4, 4)."""
    B: Array = field(init=False, repr=False, compare=False)
    """Of a held input, shape (4,)."""
    P: Array = field(init=False, repr=False, compare=False)
    """Weight at the end of the horizon, shape (4, 4)."""

    def _gain(self) -> Array:
        """K of the deviation, shape (4,)."""
        try:
            import daqp  # noqa: F401, PLC0415  an extra
        except ImportError:
            needs = "law 'mpc' needs the library daqp: pip install 'ballplate[mpc]'"
            raise ValueError(needs) from None
        A, B = flat_axis(self.model)
        both = scipy.linalg.expm(self.step * np.block([[A, B], [np.zeros((1, 5))]]))
        A, B = both[:4, :4], both[:4, 4:]
        P = scipy.linalg.solve_discrete_are(A, B, np.diag(self.Q), np.eye(1))
        for name, value in (("A", A), ("B", B[:, 0]), ("P", P)):
            object.__setattr__(self, name, value)
        return (B.T @ P @ A)[0] / (1 + B[:, 0] @ P @ B[:, 0])

    @property
    def steps(self) -> int:
        """N, the steps of the horizon."""
        return max(1, round(self.horizon / self.step))

    @property
    def limits(self) -> Array:
        """Of acceleration, rate and angle of the plate, in rad and s, shape (3,)."""
        return np.array(
            [self.acceleration, math.radians(self.rate_deg), math.radians(self.angle_deg)]
        )

    def start(self, x: Array, reference: Reference, period: float) -> Horizon:
        """The motion over the first horizon."""
        motion = MotionPlan(self, x, reference, period)
        return Horizon(self, motion, period)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        return TILT_SIGN * now.plan.input(now.time, now.equivalent)


class Program:
    """The quadratic program of one axis over the horizon.

    Args:
        law: The law with the weights and limits.
    """

    def __init__(self, law: Predictive) -> None:
        self.law, N = law, law.steps
        A, B = law.A, law.B
        powers = [np.eye(4)]
        for _ in range(N):
            powers.append(A @ powers[-1])
        # z(1) to z(N) from z(0) and the inputs
        self._free = np.array(powers[1:])
        self._forced = np.zeros((N, 4, N))
        for k in range(N):
            for i in range(k + 1):
                self._forced[k, :, i] = powers[k - i] @ B
        W = np.array([np.diag(law.Q)] * (N - 1) + [law.P])
        weighted = np.einsum("kai,kab->ikb", self._forced, W)
        self.H = np.tensordot(weighted, self._forced, axes=2) + np.eye(N)
        self.H = (self.H + self.H.T) / 2
        self._linear = np.tensordot(weighted, self._free, axes=2)
        closed = A - np.outer(B, law.K)
        z = [np.eye(4)]
        for _ in range(N):
            z.append(closed @ z[-1])
        regulated = np.array(z)
        # acceleration, rate, angle that the regulator without limits would make of z(0)
        self.regulator = np.stack((-law.K @ regulated[:N], regulated[1:, 3], regulated[1:, 2]))
        self._states = np.concatenate((self._forced[:, 3], self._forced[:, 2]))
        self._sense = np.repeat((0, SOFT_CONSTRAINT), (N, 2 * N)).astype(np.int32)

    def solve(self, z: Array, motion: Array) -> Array | None:
        """The inputs of least cost, shape (N,); None if they were not found in time.

        Args:
            z: Deviation, shape (4,).
            motion: a*'' over the horizon, a*' and a* a step later, shape (3, N).
        """
        import daqp  # noqa: PLC0415  an extra

        free = np.concatenate((0 * motion[0], *(self._free[:, i] @ z for i in (3, 2))))
        shift = motion.ravel() + free
        most = np.repeat(self.law.limits, motion.shape[1])
        found, _, flag, _ = daqp.solve(
            self.H,
            self._linear @ z,
            self._states,
            most - shift,
            -most - shift,
            self._sense,
            iter_limit=MAX_SOLVER_ITERATIONS,
        )
        return np.array(found) if flag > 0 else None


class Horizon:
    """The motion over the horizon ahead, and the input held since the last step, of one run.

    Args:
        law: The predictive law, with its horizon and limits.
        motion: The motion of ball and plate.
        period: Control period in s.
    """

    def __init__(self, law: Predictive, motion: MotionPlan, period: float) -> None:
        self._law, self._motion, self._period = law, motion, period
        self._program = Program(law)
        self._ticks = max(1, round(law.step / period))
        self._known, self._step = 0, -1
        self._ahead = np.stack([self._knot() for _ in range(law.steps + 1)])
        self._v: Any = 0.0
        self._inputs: Array = np.zeros(law.steps)
        """Inputs v of the steps from the present one on as last planned, shape (..., 2, N)."""

    def _knot(self) -> Array:
        """Ball's position and velocity, slope, rate, acceleration of the next step, (5, ..., 2)."""
        wanted = self._motion.at(self._known * self._ticks * self._period)
        self._known += 1
        return np.stack((wanted.position, wanted.velocity, *wanted.slope))

    def input(self, t: float, x: Array) -> Array:
        """Acceleration a'' in rad/s^2 at a time in s for a state, shape (..., 2)."""
        tick = round(t / self._period)
        step = tick // self._ticks
        if step != self._step:  # at its begin, or within it where a run goes on from there
            self._step = step
            while self._known <= step + self._law.steps:
                self._ahead = np.concatenate((self._ahead[1:], self._knot()[None]))
            self._v = self._best(x)
        share = (tick % self._ticks) / self._ticks
        acceleration = self._ahead[0, 4] + share * (self._ahead[1, 4] - self._ahead[0, 4])
        return acceleration + self._v

    def _best(self, x: Array) -> Array:
        """The first input v of every rig and axis, rad/s^2, shape (..., 2)."""
        law, program, now = self._law, self._program, self._ahead[0]
        slope, rate = TILT_SIGN * x[..., 2::4] - now[2], TILT_SIGN * x[..., 3::4] - now[3]
        c2 = law.model.c2
        eta, eta_rate = x[..., 0::4] - now[0] + c2 * slope, x[..., 1::4] - now[1] + c2 * rate
        z = np.stack((eta, eta_rate, slope, rate), axis=-1)
        ahead = self._ahead
        # a*'' of each step, a*' and a* at its end: (..., 2, 3, N)
        motion = np.moveaxis(
            np.stack((ahead[:-1, 4], ahead[1:, 3], ahead[1:, 2])), (0, 1), (-2, -1)
        )
        found = np.einsum("lki,...i->...lk", program.regulator, z) + motion
        broken = (np.abs(found) > law.limits[:, None]).any(axis=(-2, -1))
        wanted = np.broadcast_to(motion, found.shape)
        inputs = found[..., 0, :] - wanted[..., 0, :]
        inputs[..., 0] = -z @ law.K  # to the last bit
        left = np.broadcast_to(self._inputs, inputs.shape)
        for place in zip(*np.nonzero(broken), strict=True):
            solved = program.solve(z[place], wanted[place])
            if solved is None:
                given = wanted[place][0]
                most, gone_on = law.acceleration, np.append(left[place][1:], 0.0)
                solved = np.clip(given + gone_on, -most, most) - given
            inputs[place] = solved
        self._inputs = inputs
        return inputs[..., 0].copy()


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
