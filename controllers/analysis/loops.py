"""Closed loops about the level plate: their poles, and how sensitive they are where one cuts them.

``state_feedback_loop`` is the design in continuous time with the full state, as the thesis does it;
``sampled_loop`` is what runs: law, observer and predictor once per period, the input held between,
the ball measured a dead time late.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from controllers.analysis.linearise import System, linear_controller, linear_law, whole_periods
from controllers.arrays import Array
from controllers.ballplate import ACCELERATION, BallPlate
from controllers.interfaces import Law, Observer
from controllers.observers.ideal import Ideal
from controllers.observers.sampling import sample
from controllers.poles import listed

Complex = NDArray[np.complexfloating]

INPUTS = ("u1", "u2")
STATES = ("x", "x'", "phi", "phi'", "y", "y'", "theta", "theta'")
MEASUREMENTS = ("x", "phi", "y", "theta")


class Loop(NamedTuple):
    """A closed loop with a place to cut it at every plant input and at every output.

    Attributes:
        A: Of the closed loop, shape (n, n).
        B: From disturbances added at the cuts, shape (n, cuts).
        C: To the signals arriving at the cuts, shape (cuts, n).
        cuts: Their names: "u1", "u2", then the plant's outputs.
        period: Seconds per tick; 0 for continuous time.
    """

    A: Array
    B: Array
    C: Array
    cuts: tuple[str, ...]
    period: float

    def eigenvalues(self) -> Complex:
        """Eigenvalues of A, largest first; a sampled loop is stable with all in the unit circle."""
        found: Complex = np.linalg.eigvals(self.A).astype(complex)
        return found[np.argsort(-np.abs(found))]

    def poles(self) -> Complex:
        """Closed-loop poles in 1/s, slowest first: in a sampled loop log(z) / period of each z.

        Poles of a sampled loop at z = 0, empty places of a shift register, are left out.
        """
        poles: Complex = np.linalg.eigvals(self.A).astype(complex)
        if self.period:
            poles = cast(Complex, np.log(poles[np.abs(poles) > 1e-6]) / self.period)
        ordered: Complex = poles[np.lexsort((poles.imag, -poles.real.round(9)))]
        return ordered

    def sensitivity(self, cut: str, omega: Array) -> Complex:
        """S(j omega) = 1 / (1 + L), the loop cut at one place and closed elsewhere.

        Args:
            cut: One of ``cuts``.
            omega: Frequencies in rad/s, shape (K,).
        """
        i = self.cuts.index(cut)
        s = np.exp(1j * omega * self.period) if self.period else 1j * omega
        # (s - A)^-1 b by back substitution: A = Z T Z' with T upper triangular, for all s at once.
        T, Z = _triangular(self.A.tobytes(), len(self.A))
        b = Z.conj().T @ self.B[:, i]
        v = np.zeros((len(omega), len(b)), complex)
        for k in reversed(range(len(b))):
            v[:, k] = (b[k] + (v[:, k + 1 :] * T[k, k + 1 :]).sum(axis=1)) / (s - T[k, k])
        out: Complex = 1 + v @ (self.C[i] @ Z)
        return out


@lru_cache(maxsize=1)
def _triangular(A: bytes, n: int) -> tuple[Complex, Complex]:
    """Complex Schur form of a matrix of n rows, the same for all cuts of a loop."""
    T, Z = scipy.linalg.schur(np.frombuffer(A).reshape(n, n), output="complex")
    return T, Z


def close(plant: System, controller: System, outputs: Sequence[str]) -> Loop:
    """The loop of a plant without direct term and a controller that feeds back with its own sign.

    Args:
        plant: From u to y.
        controller: From y to u.
        outputs: Names of y.
    """
    Ap, Bp, Cp, _, period = plant
    Ac, Bc, Cc, Dc, _ = controller
    return Loop(
        A=np.block([[Ap + Bp @ Dc @ Cp, Bp @ Cc], [Bc @ Cp, Ac]]),
        B=np.block([[Bp, Bp @ Dc], [np.zeros((len(Ac), Bp.shape[1])), Bc]]),
        C=np.block([[Dc @ Cp, Cc], [Cp, np.zeros((len(Cp), len(Ac)))]]),
        cuts=(*INPUTS, *outputs),
        period=period,
    )


def state_feedback_loop(law: Law, model: BallPlate | None = None, *, flat: bool = False) -> Loop:
    """The law with the true state on the linear plant (5.35), in continuous time.

    Args:
        law: Any law; linearised about the level plate.
        model: The plant; by default the one the law was designed on.
        flat: Whether the plant is the flat model (6.44), on which the ball does not feel the
            plate's acceleration.

    Raises:
        ValueError: If the law has no linearisation.
    """
    A, B, _ = (model or law.model).linear()
    if flat:
        B[ACCELERATION] = 0
    return close(System(A, B, np.eye(8), np.zeros((8, 2))), linear_law(law), STATES)


def sampled_loop(
    law: Law,
    observer: Observer,
    period: float | None = None,
    model: BallPlate | None = None,
    *,
    dead_time: float = 0.0,
) -> Loop:
    """Law and observer at their period on the linear plant (5.35) with its input held.

    With the observer "ideal" the law gets the true state: on the exact plant the plate rates
    commanded are the true ones. A law with a control period of its own (``HeldLaw``) is taken at
    every tick of the observer: its hold, about half its period more of delay, is not in the loop.

    Args:
        law: Any law; linearised about the level plate.
        observer: Any observer, or a Smith predictor around one.
        period: Control period in s; by default the observer's.
        model: The plant; by default the one the law was designed on.
        dead_time: Of the ball's measurement in s.

    Raises:
        ValueError: If the law or the observer has no linearisation, or the observer was made for
            another period.
    """
    T = observer.period if period is None else period
    if observer.period != T:
        raise ValueError(f"observer has the period {observer.period} s, the loop {T} s")
    A, B, C = (model or law.model).linear()
    Ad, Bd = sample(A, B, T)
    if isinstance(observer, Ideal):
        law_only = linear_law(law)
        memory = np.eye(law.memory) + T * law_only.A
        controller = System(memory, T * law_only.B, law_only.C, law_only.D, T)
        return close(System(Ad, Bd, np.eye(8), np.zeros((8, 2)), T), controller, STATES)
    plant = measured_late(System(Ad, Bd, C, np.zeros((4, 2)), T), dead_time)
    return close(plant, linear_controller(law, observer), MEASUREMENTS)


def measured_late(plant: System, dead_time: float) -> System:
    """The plant with the ball's position measured late: a shift register of its outputs x, y.

    Its states, after the plant's, are (x, y) of one period ago, of two, and so on to one more than
    there are whole periods in the dead time. What is left of a period is a straight line between
    the last two.

    Args:
        plant: With the outputs (x, phi, y, theta), without direct term, sampled.
        dead_time: Of x and y in s.
    """
    A, B, C, D, T = plant
    w, share = whole_periods(dead_time, T)
    n, kept = len(A), 2 * (w + 1)
    shift = np.zeros((kept, n + kept))
    shift[:2, :n] = C[0::2]
    shift[2:, n:-2] = np.eye(kept - 2)
    late = np.concatenate([C, np.zeros((4, kept))], axis=1)
    taps = [late[0::2], *np.split(np.eye(kept, n + kept, n), w + 1)]
    late[0::2] = (1 - share) * taps[w] + share * taps[w + 1]
    return System(
        np.concatenate([np.pad(A, ((0, 0), (0, kept))), shift]),
        np.concatenate([B, np.zeros((kept, 2))]),
        late,
        D,
        T,
    )


STATE = 8
"""States of the plant, the first of a loop's."""
IDLE = 1e-6
"""Share of an eigenvector in the plant's states, and distance of z from 1, that count as none."""


def instability(law: Law, observer: Observer, *, dead_time: float = 0.0) -> str | None:
    """One line with the poles outside the stable region, or None.

    None as well for a law or observer without linearisation, about which nothing can be said. A
    memory that moves neither plate nor ball, as an integrator with gain 0, is no part of the loop.

    Args:
        law: Any law.
        observer: Any observer, or a Smith predictor around one.
        dead_time: Of the ball's measurement in s.
    """
    try:
        loop = sampled_loop(law, observer, dead_time=dead_time)
    except ValueError:
        return None
    z, v = np.linalg.eig(loop.A)
    moving = np.linalg.norm(v[:STATE], axis=0) > IDLE
    outside = unstable(z[moving].astype(complex))
    if len(outside) == 0:
        return None
    if (np.abs(outside - 1) < IDLE).all():
        return (
            "the sampled loop only integrates about the level plate: "
            f"{len(outside)} poles at 0 1/s, so nothing brings the ball back"
        )
    poles = np.unique((np.log(outside) / observer.period).round(3))
    return f"the sampled loop is unstable about the level plate: poles {listed(poles.tolist())} 1/s"


def unstable(z: Complex, tolerance: float = 1e-7) -> Complex:
    """Those of the eigenvalues z on or outside the unit circle, to rounding."""
    return z[np.abs(z) >= 1 - tolerance]
