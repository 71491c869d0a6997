"""Paths of the ball with four exact derivatives: figures, and curves through points.

Piecewise polynomials join them smoothly (Appendix D); harmonic motion starts from rest in the
middle.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import factorial
from typing import ClassVar, Literal

import numpy as np
import scipy

from controllers.arrays import Array, NotNegative, Pair, Positive
from controllers.interfaces import Reference
from controllers.piecewise import (
    ClosedForm,
    Harmonic,
    WithDerivatives,
    at_rest,
    in_turn,
    join,
    linear,
)
from controllers.setpoints import Setpoints

__all__ = ["Circle", "Hold", "Lissajous", "Path", "Sine", "Step", "Transition"]


@dataclass(frozen=True, kw_only=True)
class Transition(Reference):
    """On a straight line from rest at a start to rest at an end, in a given time.

    The polynomial of degree nine keeps the position smooth to the fourth derivative.

    Raises:
        ValueError: If a setting is not finite or the duration not positive.
    """

    name: ClassVar[str] = "transition"
    lengths: ClassVar[tuple[str, ...]] = ("start", "end")

    start: tuple[float, float] = (0.0, 0.0)
    """Position (x, y) up to ``time`` in m, plate axes."""
    end: tuple[float, float] = (0.15, 0.1)
    """Position (x, y) from ``time + duration`` on in m, plate axes."""
    time: float = 0.0
    """Time at which the ball sets off in s."""
    duration: Positive = 3.0
    """Time it takes in s."""

    _motion: WithDerivatives = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings and join the two points."""
        super().__post_init__()
        before, after = at_rest(self.start), at_rest(self.end)
        pieces = (linear(before), join(before, after, self.duration), linear(after))
        motion = in_turn((self.time, self.time, self.time + self.duration), pieces)
        object.__setattr__(self, "_motion", motion)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        return self._motion(t)


@dataclass(frozen=True, kw_only=True)
class Path(Reference):
    """A smooth curve through points, from rest to rest or round and round.

    The curve is the quintic spline over the length of the polygon through the points; the ball runs
    along it after a schedule that gathers speed, keeps it and, on an open path, sheds it again.
    Both, and so the path in time, are smooth to the fourth derivative.

    Raises:
        ValueError: If there are too few points, two in a row coincide, or a time does not fit.
    """

    name: ClassVar[str] = "path"
    lengths: ClassVar[tuple[str, ...]] = ("points",)

    points: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.15, 0.05), (0.1, -0.1), (-0.1, 0.0))
    """The points (x, y) in order in m, plate axes; two or more, three or more of a closed path."""
    duration: Positive = 8.0
    """Time in s from the first point to the last or, on a closed path, for a lap at full speed."""
    closed: bool = False
    """Whether the path returns to its first point and goes on for ever."""
    time: float = 0.0
    """Time at which the ball sets off in s; it waits at the first point until then."""
    ramp: Positive | None = None
    """Time in s to gather full speed, and to shed it; at most half the duration on an open path.
    Default: a quarter of the duration."""

    _curve: WithDerivatives = field(init=False, repr=False, compare=False)
    _schedule: WithDerivatives = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings, lay the curve and make the schedule."""
        super().__post_init__()
        object.__setattr__(self, "_curve", _curve(np.array(self.points, float), self.closed))
        duration, time = self.duration, self.time
        ramp = duration / 4 if self.ramp is None else self.ramp
        if not self.closed and ramp > duration / 2:
            raise ValueError(f"ramp must be at most half the duration, {duration / 2}, got {ramp}")
        schedule = _schedule(time, duration, ramp, self.closed)
        object.__setattr__(self, "_schedule", schedule)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        s, s1, s2, s3, s4 = self._schedule(t)
        p, p1, p2, p3, p4 = self._curve((s % 1.0 if self.closed else s)[..., 0])
        out = np.empty((5, *p.shape))
        out[0] = p
        # The chain rule, four times over.
        out[1] = p1 * s1
        out[2] = p2 * s1**2 + p1 * s2
        out[3] = p3 * s1**3 + 3 * p2 * s1 * s2 + p1 * s3
        out[4] = p4 * s1**4 + 6 * p3 * s1**2 * s2 + p2 * (3 * s2**2 + 4 * s1 * s3) + p1 * s4
        return out


def _curve(points: Array, closed: bool) -> WithDerivatives:
    """Quintic spline through the points over the share of the polygon's length, 0 to 1."""
    least = 3 if closed else 2
    if len(points) < least:
        kind = "a closed" if closed else "an open"
        raise ValueError(f"points must be {least} or more for {kind} path, got {len(points)}")
    if closed:
        points = np.vstack((points, points[:1]))
    sides = np.hypot(*np.diff(points, axis=0).T)
    if not sides.all():
        i = int(np.argmin(sides))
        raise ValueError(f"points must differ from one to the next, got {points[i].tolist()} twice")
    share = np.append(0.0, np.cumsum(sides)) / sides.sum()
    share[-1] = 1.0
    # An open curve ends straight: second and fourth derivative zero, so two points give a line.
    straight = [(2, np.zeros(2)), (4, np.zeros(2))]
    ends = "periodic" if closed else (straight, straight)
    interpolate = scipy.interpolate.make_interp_spline
    spline = interpolate(share, points, k=5, bc_type=ends)  # type: ignore[arg-type]
    # PPoly.from_spline would do for one axis alone.
    powers = [spline(share[:-1], nu=k) / factorial(k) for k in reversed(range(6))]
    return WithDerivatives(np.array(powers), share)


def _schedule(time: float, duration: float, ramp: float, closed: bool) -> WithDerivatives:
    """Share of the curve left behind over time, one column."""
    pace = 1 / duration if closed else 1 / (duration - ramp)
    # A ramp covers half of what full pace would.
    covered = pace * ramp / 2
    first, last, full = at_rest((0.0,)), at_rest((1.0,)), at_rest((covered,))
    full[1] = pace
    pieces = [linear(first), join(first, full, ramp), linear(full)]
    origins = [time, time, time + ramp]
    if not closed:
        full[0] = 1 - covered
        pieces += [join(full, last, ramp), linear(last)]
        origins += [time + duration - ramp, time + duration]
    return in_turn(origins, pieces)


@dataclass(frozen=True, kw_only=True)
class Hold(Reference):
    """The ball shall stay at one point.

    Raises:
        ValueError: If a setting is not finite.
    """

    name: ClassVar[str] = "hold"
    lengths: ClassVar[tuple[str, ...]] = ("x", "y")

    x: float = 0.0
    """Position along x in m, plate axes."""
    y: float = 0.0
    """Position along y in m, plate axes."""

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        out = np.zeros((5, *np.shape(t), 2))
        out[0] = self.x, self.y
        return out


@dataclass(frozen=True, kw_only=True)
class Step(Reference):
    """The desired position jumps from a start to an end, as in Tables 8.1 and 8.2.

    The derivatives are zero everywhere, the jump itself included.

    Raises:
        ValueError: If a setting is not finite.
    """

    name: ClassVar[str] = "step"
    lengths: ClassVar[tuple[str, ...]] = ("start", "end")

    start: tuple[float, float] = (0.0, 0.0)
    """Position (x, y) before the step in m, plate axes."""
    end: tuple[float, float] = (0.15, 0.15)
    """Position (x, y) from the step on in m, plate axes."""
    time: float = 0.0
    """Time of the step in s."""

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        out = np.zeros((5, *np.shape(t), 2))
        after = np.asarray(t)[..., None] >= self.time
        out[0] = np.where(after, self.end, self.start)
        return out


Wave = Literal["sin", "cos"]


def both(value: Pair) -> tuple[float, float]:
    """A number for each axis."""
    return (value, value) if isinstance(value, int | float) else value


class Oscillation:
    """Harmonic motion S sin(omega t) + C cos(omega t) of both axes.

    Args:
        sine: S for x and y in m.
        cosine: C for x and y in m.
        omega: Angular frequency for x and y in rad/s.

    Raises:
        ValueError: If a frequency is zero.
    """

    def __init__(
        self, sine: Sequence[float], cosine: Sequence[float], omega: Sequence[float]
    ) -> None:
        if 0 in omega:
            raise ValueError("omega must not be zero")
        S, C, self.omega = np.array(sine), np.array(cosine), np.array(omega, float)
        speed = self.omega ** np.arange(5)[:, None]
        # Each derivative turns sin into cos and cos into -sin.
        self.sine = speed * (S, -C, -S, C, S)
        self.cosine = speed * (C, S, -C, -S, C)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        t = np.asarray(t, dtype=float)
        angle = self.omega * t[..., None]
        shape = (5, *(1,) * t.ndim, 2)
        sine, cosine = self.sine.reshape(shape), self.cosine.reshape(shape)
        return sine * np.sin(angle) + cosine * np.cos(angle)


@dataclass(frozen=True, kw_only=True)
class Sine(Reference):
    """A sine or a cosine on each axis, from t = 0 at full swing.

    The same sine on both axes gives the references of Tables 8.3 to 8.11, (6.53); the waves
    ("sin", "cos") give those of Tables 8.14 to 8.21.

    Raises:
        ValueError: If a setting is not finite, a frequency is zero or a wave has no such name.
    """

    name: ClassVar[str] = "sine"
    lengths: ClassVar[tuple[str, ...]] = ("amplitude",)

    amplitude: Pair = 0.15
    """Amplitude in m, one for both axes or (x, y)."""
    omega: Pair = 0.5
    """Angular frequency in rad/s, one for both axes or (x, y)."""
    wave: tuple[Wave, Wave] = ("sin", "sin")
    """Whether x and y start in the middle ("sin") or at the end of the swing ("cos")."""

    _motion: Oscillation = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        waves = list(zip(both(self.amplitude), self.wave, strict=True))
        sine = [a if w == "sin" else 0.0 for a, w in waves]
        cosine = [a if w == "cos" else 0.0 for a, w in waves]
        object.__setattr__(self, "wave", tuple(self.wave))
        object.__setattr__(self, "_motion", Oscillation(sine, cosine, both(self.omega)))

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        return self._motion(t)


SOFT_START_PERIODS = 0.75
"""Default length of the soft start in periods of the faster axis.

At three quarters the start passes the amplitude by at most 0.6 % and the acceleration of a circle
by at most 6 %; at a half it asks for 1.8 times that acceleration, beyond one it swings ever wider.
"""


@dataclass(frozen=True, kw_only=True)
class _SoftStarted(Reference):
    """Harmonic motion entered by a polynomial of degree nine from rest at the centre (D.1).

    Position and four derivatives are zero up to t = 0 and agree with the motion at t = start.
    """

    start: NotNegative | None = None
    """Length of the polynomial start in s; 0 begins in full motion. Default: three quarters of a
    period of the faster axis."""

    _start: float = field(init=False, repr=False, compare=False)
    _motion: Oscillation = field(init=False, repr=False, compare=False)
    _opening: WithDerivatives = field(init=False, repr=False, compare=False)

    @abstractmethod
    def _settings(self) -> tuple[Oscillation, float]:
        """The motion and its fastest angular frequency in rad/s."""

    def __post_init__(self) -> None:
        """Join rest and motion."""
        super().__post_init__()
        motion, fastest = self._settings()
        start = SOFT_START_PERIODS * 2 * math.pi / fastest if self.start is None else self.start
        rest = at_rest((0.0, 0.0))
        still = linear(rest)
        pieces = (still, join(rest, motion(start), start) if start > 0 else still)
        object.__setattr__(self, "_start", start)
        object.__setattr__(self, "_motion", motion)
        object.__setattr__(self, "_opening", in_turn((0.0, 0.0), pieces))

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        if isinstance(t, np.ndarray) and t.ndim:
            early = t < self._start
            if early.all():
                return self._opening(t)
            if not early.any():
                return self._motion(t)
            opening = self._opening(np.minimum(t, self._start))
            return np.where(early[..., None], opening, self._motion(t))
        return self._opening(t) if t < self._start else self._motion(t)


@dataclass(frozen=True, kw_only=True)
class Circle(_SoftStarted):
    """x = A sin(omega t), y = A cos(omega t) after a soft start (D.1).

    Raises:
        ValueError: If a setting is not finite, or the amplitude not positive, omega zero or the
            start negative.
    """

    name: ClassVar[str] = "circle"
    lengths: ClassVar[tuple[str, ...]] = ("amplitude",)

    amplitude: Positive = 0.15
    """Radius A in m."""
    omega: float = 0.5
    """Angular frequency in rad/s; negative goes round the other way."""

    def _settings(self) -> tuple[Oscillation, float]:
        A, omega = self.amplitude, self.omega
        return Oscillation((A, 0.0), (0.0, A), (omega, omega)), abs(omega)


@dataclass(frozen=True, kw_only=True)
class Lissajous(_SoftStarted):
    """x = A_x sin(omega_x t + phase), y = A_y sin(omega_y t) after a soft start as in (D.1).

    Raises:
        ValueError: If a setting is not finite, a frequency is zero or the start negative.
    """

    name: ClassVar[str] = "lissajous"
    lengths: ClassVar[tuple[str, ...]] = ("amplitude",)

    amplitude: Pair = (0.2, 0.12)
    """Amplitude in m, one for both axes or (x, y)."""
    omega: tuple[float, float] = (0.4, 0.6)
    """Angular frequencies (x, y) in rad/s."""
    phase: float = math.pi / 2
    """Phase of x in rad."""

    def _settings(self) -> tuple[Oscillation, float]:
        (A_x, A_y), omega, phase = both(self.amplitude), self.omega, self.phase
        sine, cosine = (A_x * math.cos(phase), A_y), (A_x * math.sin(phase), 0.0)
        return Oscillation(sine, cosine, omega), max(abs(omega[0]), abs(omega[1]))


ALONG_X = np.array([1.0, 0.0])
"""Factors of x and y that leave x alone."""


@dataclass(frozen=True)
class AlongX(Reference):
    """What a reference does along x, with y at rest on 0: for a rig of one axis.

    Attributes:
        whole: The reference.
    """

    whole: Reference

    def __post_init__(self) -> None:
        """Have the name of the whole."""
        object.__setattr__(self, "name", self.whole.name)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        return self.whole(t) * ALONG_X


def closed_form(reference: Reference) -> ClosedForm | None:
    """The closed form of a reference, for other languages; None if it has none."""
    kind = type(reference)
    if kind is Hold or kind is Step:
        times = np.array([reference.time]) if isinstance(reference, Step) else np.zeros(1)
        pieces = np.stack([reference(times[0] - 1)[0], reference(times[0])[0]])
        return ClosedForm(np.append(times - 1, times), pieces, np.zeros((2, 1, 5, 2)))
    if isinstance(reference, Sine) and kind is Sine:
        return _harmonic_form(reference._motion, -math.inf)
    if isinstance(reference, Circle | Lissajous) and kind in {Circle, Lissajous}:
        after = _harmonic_form(reference._motion, reference._start)
        return reference._opening.form()._replace(harmonic=after.harmonic)
    if isinstance(reference, Transition) and kind is Transition:
        return reference._motion.form()
    if isinstance(reference, Setpoints) and kind is Setpoints:
        return reference.closed_form()
    return _form_along_x(reference)


def _form_along_x(reference: Reference) -> ClosedForm | None:
    """The closed form of an ``AlongX``: of its whole path without y; None of any other."""
    form = closed_form(reference.whole) if isinstance(reference, AlongX) else None
    if form is None:
        return None
    wave = form.harmonic
    if wave is not None:
        wave = wave._replace(sine=wave.sine * ALONG_X, cosine=wave.cosine * ALONG_X)
    offsets, terms = form.offsets * ALONG_X, form.terms * ALONG_X
    return form._replace(offsets=offsets, terms=terms, harmonic=wave)


def _harmonic_form(motion: Oscillation, since: float) -> ClosedForm:
    harmonic = Harmonic(since, motion.omega, motion.sine, motion.cosine)
    return ClosedForm(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 1, 5, 2)), harmonic=harmonic)
