"""Laws, observers and loops about the level plate as linear systems: poles and margins.

``state_feedback_loop`` is the design in continuous time with the full state, as the thesis does it;
``sampled_loop`` is what runs: law, observer and predictor once per period, the input held between,
the ball measured a dead time late. Laws and observers are taken as they are: their own methods are
asked for the answer to small deviations.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Iterable, Sequence
from copy import deepcopy
from functools import lru_cache
from typing import Any, NamedTuple, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.ballplate import BALL_ACCELERATIONS, BALL_POSITIONS
from controllers.controller import HeldLaw
from controllers.design import format_numbers, sample
from controllers.interfaces import ControlLaw, Law, Measurement, Observer, Reference
from controllers.observers.thesis import Ideal
from controllers.references import Hold
from controllers.smith import Smith


def slow_observer(law: ControlLaw, observer: Observer) -> str | None:
    """One line if the observer's chosen poles are slower than the controlled system's, else None.

    None as well for an observer without chosen poles, or a law without linearisation.

    Args:
        law: Any law.
        observer: Any observer, or a Smith predictor around one.
    """
    inner = observer.observer if isinstance(observer, Smith) else observer
    chosen = getattr(inner, "poles", None)
    if chosen is None:
        return None
    try:
        controlled = state_feedback_loop(law).poles().real.max()
    except ValueError:
        return None
    slowest = max(np.real(complex(pole)) for pole in chosen)
    if slowest <= controlled:
        return None
    return (
        f"observer is slower than the loop it serves: its slowest pole is {slowest:g} 1/s, the "
        f"controlled system's is {controlled:.3g} 1/s; (7.3) wants the observer faster"
    )


DIFFERENCE_STEP = 1e-4
ORIGIN_REFERENCE = Hold()


class System(NamedTuple):
    """x' = A x + B u, y = C x + D u; or, with a period, the same from one tick to the next."""

    A: Array
    B: Array
    C: Array
    D: Array
    period: float = 0.0
    """Seconds per tick; 0 for continuous time."""


def linear_law(law: ControlLaw) -> System:
    """A law as a system from the state x, shape (8,), to u; its own states are its memory.

    Raises:
        ValueError: If the law has no linearisation, as a sliding mode has none.
    """
    if type(law.law if isinstance(law, HeldLaw) else law).control is Law.control:
        raise ValueError(f"law '{law.name}' acts by command alone: it has no linearisation")
    J = _law_jacobian(law, DIFFERENCE_STEP)
    if np.abs(J - _law_jacobian(law, DIFFERENCE_STEP / 10)).max() > 1e-3 * np.abs(J).max():
        raise ValueError(f"law '{law.name}' has no linearisation about the level plate")
    return System(A=J[2:, 8:], B=J[2:, :8], C=J[:2, 8:], D=J[:2, :8])


def tracking_law(law: ControlLaw) -> System:
    """A law as a system from (state, desired position), shape (10,), to u.

    The desired position stands still as far as the law knows: its derivatives are zero.

    Raises:
        ValueError: If the law has no linearisation.
    """
    A, B, C, D, _ = linear_law(law)
    ahead = []
    for axis in ("x", "y"):
        there, back = (_answer_to(law, Hold(**{axis: way * DIFFERENCE_STEP})) for way in (1, -1))
        ahead.append((there - back) / (2 * DIFFERENCE_STEP))
    J = np.stack(ahead, axis=-1)
    return System(A, np.hstack([B, J[2:]]), C, np.hstack([D, J[:2]]))


def _answer_to(law: ControlLaw, reference: Reference) -> Array:
    """(u, memory rate) of a law at rest at the centre when the reference is ``reference``."""
    x, q = np.zeros((1, 8)), np.zeros((1, law.memory))
    u, slope = law.control(0.0, x, reference, q), law.memory_rate(0.0, x, reference, q)
    return np.concatenate([u, slope], axis=-1)[0]


def _law_jacobian(law: ControlLaw, step: float) -> Array:
    """Derivative of (u, memory rate) by (x, memory), by central differences."""
    ahead = step * np.eye(8 + law.memory)

    def both(s: Array) -> Array:
        x, q = s[:, :8], s[:, 8:]
        u = law.control(0.0, x, ORIGIN_REFERENCE, q)
        return np.concatenate([u, law.memory_rate(0.0, x, ORIGIN_REFERENCE, q)], axis=-1)

    return (both(ahead) - both(-ahead)).T / (2 * step)


def linear_controller(law: ControlLaw, observer: Observer) -> System:
    """Law and observer at the control period, from the measurement y, shape (4,), to u.

    A Smith predictor around the observer is included. An observer with a varying gain, the EKF,
    has its initial gain.

    Raises:
        ValueError: If the law has no linearisation, or the observer keeps its memory elsewhere than
            in arrays of its own.
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

    def __init__(self, law: ControlLaw, observer: Observer) -> None:
        self._law = law
        self._observer = observer
        self._names = self._memory_names()
        self._sizes = [vars(self._started(1))[name].size for name in self._names]
        self.period = observer.period
        n = sum(self._sizes) + law.memory
        ahead = DIFFERENCE_STEP * np.eye(n + 4)
        J = (self._answer(ahead) - self._answer(-ahead)).T / (2 * DIFFERENCE_STEP)
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
        deviation = DIFFERENCE_STEP * np.random.default_rng(0).uniform(0.5, 1, (1, 8))
        after = []
        for x in (np.zeros((1, 8)), deviation):
            observer = deepcopy(self._observer)
            observer.start(x)
            observer.correct(_measurement(np.zeros((1, 4))))
            observer.predict(np.zeros((1, 2)))
            after.append(vars(observer))
        arrays = [name for name, value in after[0].items() if isinstance(value, np.ndarray)]
        moved = {name: np.abs(after[1][name] - after[0][name]).max() for name in arrays}
        return [name for name in arrays if moved[name] > 1e-3 * DIFFERENCE_STEP]

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
        before = observer.x[:, BALL_POSITIONS].copy()
        observer.correct(_measurement(y))
        x = observer.equivalent.copy()
        u = self._law.control(0.0, x, ORIGIN_REFERENCE, q)
        q = q + observer.period * self._law.memory_rate(0.0, x, ORIGIN_REFERENCE, q)
        x = observer.x.copy()
        observer.predict(u)
        kept = [getattr(observer, name).reshape(rigs, -1) for name in self._names]
        return np.concatenate([*kept, q, u, x[:, BALL_POSITIONS], before], axis=-1)

    def _verify(self) -> None:
        """Compare five ticks with the real observer: what hides elsewhere shows."""
        observer, q = self._started(1), np.zeros((1, self._law.memory))
        s = np.zeros(len(self.A))
        for y in DIFFERENCE_STEP * np.random.default_rng(1).normal(size=(5, 1, 4)):
            observer.correct(_measurement(y))
            x = observer.equivalent.copy()
            real = self._law.control(0.0, x, ORIGIN_REFERENCE, q)[0]
            q = q + self.period * self._law.memory_rate(0.0, x, ORIGIN_REFERENCE, q)
            observer.predict(real[np.newaxis])
            linear = self.C[:2] @ s + self.D[:2] @ y[0]
            s = self.A @ s + self.B @ y[0]
        if np.abs(linear - real).max() > 1e-2 * np.abs(real).max():
            raise ValueError(f"observer '{self._observer.name}' cannot be linearised")


def _measurement(y: Array) -> Measurement:
    rigs = y.shape[:-1]
    return Measurement(0.0, y, np.zeros(rigs), np.ones(rigs, bool))


def _with_predictor(tick: _Tick, delay: float) -> System:
    """Close the loop of (7.19) around a tick: the ball's innovation is as old as the dead time.

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


class Margins(NamedTuple):
    """How far a stable loop is from instability at one cut; None where nothing destabilises it.

    Attributes:
        gain_down: The loop gain may fall to this factor, below 1.
        gain_up: The loop gain may rise to this factor.
        phase: Phase in deg that may be lost or won.
        disk: alpha of the symmetric disk: gain and phase may change together by any factor
            (1 + d/2) / (1 - d/2) with |d| < alpha.
        delay: Additional dead time in s.
        crossover: Highest frequency of gain 1 in rad/s.
    """

    gain_down: float | None
    gain_up: float | None
    phase: float | None
    disk: float
    delay: float | None
    crossover: float | None


def margins(loop: Loop, cut: str, *, points: int = 300) -> Margins | None:
    """Margins of a loop at one of its cuts, the other ones closed.

    Args:
        loop: The closed loop.
        cut: One of its cuts.
        points: Frequencies to evaluate, from 0.01 rad/s to the sampling limit or 1000 rad/s.

    Returns:
        The margins, or None if the closed loop is not stable.
    """
    import control  # noqa: PLC0415  heavy: loaded when needed

    if loop.poles()[0].real >= 0:
        return None
    highest = 0.999 * math.pi / loop.period if loop.period else 1e3
    omega = np.geomspace(0.01, highest, points)
    S = loop.sensitivity(cut, omega)
    crossed, phases, _, _, crossovers, _ = control.stability_margins(
        control.FRD(1 / S - 1, omega), returnall=True
    )
    gains = [*crossed, *_gains_at_ends(loop, cut)]
    return Margins(
        gain_down=max((float(g) for g in gains if g < 1), default=None),
        gain_up=min((float(g) for g in gains if g > 1), default=None),
        phase=min((abs(float(p)) for p in phases), default=None),
        disk=float(1 / np.abs(S - 0.5).max()),
        # A dead time only turns the loop clockwise: a margin of -30 deg is one of 330 deg to it.
        delay=min(
            (float(math.radians(p % 360) / w) for p, w in zip(phases, crossovers, strict=True)),
            default=None,
        ),
        crossover=max((float(w) for w in crossovers), default=None),
    )


def _gains_at_ends(loop: Loop, cut: str) -> Array:
    """Factors of the loop gain that put a pole at frequency 0 or at half the sampling rate.

    There L is real, and the factor is -1 / L = S / (S - 1).

    Args:
        loop: The closed loop, stable.
        cut: One of its cuts.

    Returns:
        Those that are positive, shape (N,); none where L is 0 or, as of an integrator, infinite.
    """
    ends = np.array([0.0, math.pi / loop.period] if loop.period else [0.0])
    S = loop.sensitivity(cut, ends).real
    gains: Array = S[S != 1] / (S[S != 1] - 1)
    return gains[(gains > MIN_GAIN_FACTOR) & (gains < 1 / MIN_GAIN_FACTOR)]


MIN_GAIN_FACTOR = 1e-6
"""Factor of a loop gain that counts as 0, and its inverse as infinite: what rounding leaves."""

Complex = NDArray[np.complexfloating]

INPUT_NAMES = ("u1", "u2")
STATE_SYMBOLS = ("x", "x'", "phi", "phi'", "y", "y'", "theta", "theta'")
MEASUREMENT_NAMES = ("x", "phi", "y", "theta")


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

    def poles(self) -> Complex:
        """Closed-loop poles in 1/s, slowest first: in a sampled loop log(z) / period of each z.

        Poles of a sampled loop at z = 0, empty places of a shift register, are left out.
        """
        poles: Complex = np.linalg.eigvals(self.A).astype(complex)
        if self.period:
            poles = cast(Complex, np.log(poles[np.abs(poles) > 1e-6]) / self.period)
        return poles[np.lexsort((poles.imag, -poles.real.round(9)))]

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
        return 1 + v @ (self.C[i] @ Z)


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
        cuts=(*INPUT_NAMES, *outputs),
        period=period,
    )


def state_feedback_loop(law: ControlLaw, *, flat: bool = False) -> Loop:
    """The law with the true state on the linear plant (5.35), in continuous time.

    Args:
        law: Any law; linearised about the level plate.
        flat: Whether the plant is the flat model (6.44), on which the ball does not feel the
            plate's acceleration.

    Raises:
        ValueError: If the law has no linearisation.
    """
    A, B, _ = law.model.linear()
    if flat:
        B[BALL_ACCELERATIONS] = 0
    return close(System(A, B, np.eye(8), np.zeros((8, 2))), linear_law(law), STATE_SYMBOLS)


def sampled_loop(
    law: ControlLaw, observer: Observer, *, dead_time: float = 0.0, lag: float = 0.0
) -> Loop:
    """Law and observer at their period on the linear plant (5.35) of the law, its input held.

    With the observer "ideal" the law gets the true state: on the exact plant the plate rates
    commanded are the true ones. A law with a control period of its own (``HeldLaw``) is taken at
    every tick of the observer: its hold, about half its period more of delay, is not in the loop.

    Args:
        law: Any law; linearised about the level plate.
        observer: Any observer, or a Smith predictor around one.
        dead_time: Of the ball's measurement in s.
        lag: Time constant in s with which the plate's rates follow those commanded.

    Raises:
        ValueError: If the law or the observer has no linearisation.
    """
    T = observer.period
    A, B, C = law.model.linear()
    if lag:  # two states more, the commanded rates r: u = (r - plate rate) / lag acts, r' = u
        A[:, 3::4] -= B / lag
        A = np.block([[A, B / lag], [np.zeros((2, PLANT_STATE_COUNT + 2))]])
        B, C = np.eye(PLANT_STATE_COUNT + 2, 2, -PLANT_STATE_COUNT), np.pad(C, ((0, 0), (0, 2)))
    Ad, Bd = sample(A, B, T)
    if isinstance(observer, Ideal):
        law_only = linear_law(law)
        memory = np.eye(law.memory) + T * law_only.A
        controller = System(memory, T * law_only.B, law_only.C, law_only.D, T)
        return close(
            System(Ad, Bd, np.eye(8, len(Ad)), np.zeros((8, 2)), T), controller, STATE_SYMBOLS
        )
    plant = measured_late(System(Ad, Bd, C, np.zeros((4, 2)), T), dead_time)
    return close(plant, linear_controller(law, observer), MEASUREMENT_NAMES)


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


PLANT_STATE_COUNT = 8
"""States of the plant, the first of a loop's."""
MIN_EIGENVECTOR_SHARE = 1e-6
"""Share of an eigenvector in the plant's states, and distance of z from 1, that count as none."""


def instability(
    law: ControlLaw, observer: Observer, *, dead_time: float = 0.0, lag: float = 0.0
) -> str | None:
    """One line with the poles outside the stable region, or None.

    For a ball that is seen late, the line also has the longest stable dead time, to a period.

    None as well for a law or observer without linearisation, where stability is unknown. A memory
    that moves neither plate nor ball, as an integrator with gain 0, is no part of the loop.

    Args:
        law: Any law.
        observer: Any observer, or a Smith predictor around one.
        dead_time: Of the ball's measurement in s.
        lag: Time constant in s with which the plate's rates follow those commanded.
    """

    def poles_outside(late: float) -> Complex:
        z, v = np.linalg.eig(sampled_loop(law, observer, dead_time=late, lag=lag).A)
        moving = np.linalg.norm(v[:PLANT_STATE_COUNT], axis=0) > MIN_EIGENVECTOR_SHARE
        return unstable(z[moving].astype(complex))

    try:
        outside = poles_outside(dead_time)
    except ValueError:
        return None
    if len(outside) == 0:
        return None
    if (np.abs(outside - 1) < MIN_EIGENVECTOR_SHARE).all():
        return (
            "the sampled loop only integrates about the level plate: "
            f"{len(outside)} poles at 0 1/s, so nothing brings the ball back"
        )
    poles = np.unique((np.log(outside) / observer.period).round(3))
    shown = format_numbers(poles.tolist())
    line = f"the sampled loop is unstable about the level plate: poles {shown} 1/s"
    T = observer.period
    held = bisect(range(round(dead_time / T)), 0, key=lambda n: len(poles_outside(n * T))) - 1
    late = f"{1e3 * held * T:.0f} ms late, not {1e3 * dead_time:.0f} ms"
    return f"{line}; it holds a ball that is seen {late}" if held > 0 else line


def unstable(z: Complex) -> Complex:
    """Those of the eigenvalues z on or outside the unit circle, to rounding."""
    return z[np.abs(z) >= 1 - 1e-7]


PlainRow = dict[str, Any]
"""A row of a table as JSON can hold it."""


def loop_row(law: ControlLaw, observer: Observer, dead_time: float, lag: float = 0.0) -> PlainRow:
    """Poles and margins of one sampled loop, or under ``reason`` why there are none.

    ``hold_left_out`` is true for a law that is held for longer than the loop's period.

    Args:
        law: Any law.
        observer: Any observer, or a predictor around one.
        dead_time: Of the ball's measurement in s.
        lag: Time constant in s with which the plate's rates follow those commanded.
    """
    try:
        loop = sampled_loop(law, observer, dead_time=dead_time, lag=lag)
    except ValueError as error:
        return {"reason": str(error), "hold_left_out": isinstance(law, HeldLaw)}
    poles = loop.poles()
    cuts = [cut for cut in ("u1", "u2", "x", "y") if cut in loop.cuts]
    found = {cut: margins(loop, cut) for cut in cuts}
    return {
        "reason": None,
        "hold_left_out": isinstance(law, HeldLaw),
        "stable": len(unstable(np.exp(poles * loop.period))) == 0,
        "poles": pairs(poles),
        "margins": {
            cut: each and {name: number(value) for name, value in each._asdict().items()}
            for cut, each in found.items()
        },
    }


def pairs(poles: Iterable[complex]) -> list[list[float]]:
    """Poles as real and imaginary part, each once: both axes have most of them alike."""
    out: list[list[float]] = []
    for pole in map(complex, poles):
        near = 1e-4 * (1 + abs(pole))
        if not any(abs(pole - complex(*other)) < near for other in out):
            out.append([pole.real, pole.imag])
    return out


def number(value: float | None) -> float | None:
    """The value, or None for one that is not finite."""
    return float(value) if value is not None and math.isfinite(value) else None
