"""Linear model predictive control, which keeps to what plate and drives can do."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy
from annotated_types import Ge

from controllers.arrays import Array, NotNegative
from controllers.ballplate import TILT_SIGN
from controllers.interfaces import Feedback, Reference
from controllers.stable_inversion import AboutMotion, MotionPlan, flat_axis

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
