"""Simulation of the plain model of an axis from many starts, for many candidates at once.

The model is stated in ``plain_model``. Heun's method, friction apart: a ball that friction turns or
holds does so within a step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.axis_logs import EndStops
from twin.identify.command_model import PROFILED_EFFECTS, TiltHistory
from twin.identify.least_squares import FitProblem, Linearisation, SampleWindows
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.windows import SAMPLE_BIN_S

SIMULATION_STEP_S = 0.016
"""Step of the simulation in s: it moves positions by 0.03 mm RMS, less than 0.1 mm."""
CROSSING_STEP_S = 0.008
"""The same where friction acts along both axes: it turns with the direction of the ball."""
BLOCK_LANES = 3000
"""Largest number of balls that are simulated together: their arrays stay in the cache."""
MAX_KNOWN_TILTS = 1_000_000
"""Integrals of tilts over steps that are kept for further simulations of the same windows."""
MIN_CROSS_SPEED_RATIO = 0.3
"""Speed along the other axis, over the largest change of speed in a step, above which friction acts
on both axes together."""
BALL_SHARE = 0.66
"""Share of gravity that accelerates a ball: 3/5 of a hollow, 5/7 of a solid one."""
MIN_CENTRIFUGAL_PER_S2 = 0.002
"""Mean centrifugal acceleration by the place, 1/s^2, from which on it is simulated."""
START_PRECISION = np.diag(np.array([0.02, 0.3]) ** -2.0)
"""Weak knowledge of a start: m and m/s."""
START_STEPS = np.array([1e-4, 1e-3, 1e-3])
"""Steps of finite differences of a start: m, m/s, and m/s^2 of a level of its own."""


@dataclass(frozen=True)
class AxisProblem(FitProblem[SampleWindows]):
    """Simulations of one axis.

    Attributes:
        tilt: The commands or angles that tilt the plate.
        longest: Length of the simulation in s.
        delays: Smallest and largest dead time in s.
        drift: Standard deviation in m/s^2 of a level of each window's own, which is then the
            third number of its start; 0 for none.
        stops: The end stops at which a ball bounces; None where no window touches one.
        sticking: Additional friction at rest, m/s^2, and the speed in m/s at which half of it
            remains, by the Stribeck curve of Hess and Soom (1990).
        filter_s: Time constant of a filter of the positions, s; its start is that of the samples.
        known_tilts: Integrals of tilts in the windows that were needed so far, by their drives.
    """

    tilt: TiltHistory
    longest: float
    delays: tuple[float, float]
    drift: float = 0.0
    stops: EndStops | None = None
    sticking: tuple[float, float] = (0.0, 1.0)
    filter_s: float = 0.0
    known_tilts: dict[tuple[float, ...], Array] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    about = PLAIN_PARAMETERS
    start_steps = START_STEPS
    prior = START_PRECISION
    grows = True

    @property
    def step(self) -> float:
        """Step of the simulation in s."""
        return CROSSING_STEP_S if self.tilt.log.across[1].any() else SIMULATION_STEP_S

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest values of the parameters, shapes (P,)."""
        least, most = super().bounds
        at = self.names.index("dead_time")
        least[at], most[at] = self.delays
        return least, most

    @property
    def rigid_starts(self) -> int:
        """How many of the first numbers of a start merely shift all positions of a simulation."""
        return int("camber" not in self.names and self.stops is None and not self.turns_fast)

    def take(self, which: Mask) -> Self:
        """The problem of some of the windows."""
        if which.all():
            return self
        found = super().take(which)
        for drive, tilted in self.known_tilts.items():
            found.known_tilts[drive] = tilted[:, which]
        return found

    def first_part(self, seconds: float) -> Self:
        """The problem of the samples in the first seconds of each window, simulated no longer."""
        found, bins = super().first_part(seconds), int(seconds / SAMPLE_BIN_S) + 2
        windows = replace(
            found.windows,
            **{name: getattr(found.windows, name)[:, :bins] for name in ("time", "ball", "weight")},
        )
        longest = min(self.longest, seconds + SAMPLE_BIN_S)
        return replace(found, windows=windows, longest=longest)

    def initial_starts(self) -> Array:
        """A straight line through the first samples of each window, shape (2 or 3, 1, W)."""
        out = np.zeros((3 if self.drift else 2, 1, len(self.windows)))
        time, there = self.windows.time, self.windows.weight[..., 0] > 0
        third = np.max(time, axis=1, where=there & (there.cumsum(axis=1) == 3), initial=0.3)
        first = there & (time < third[:, None] + 1e-6)
        count = np.maximum(first.sum(axis=1), 1)
        middle, place = (
            (each * first).sum(axis=1) / count for each in (time, self.windows.ball[..., 0])
        )
        since = np.where(first, time - middle[:, None], 0.0)
        square = (since**2).sum(axis=1)
        speed = (since * self.windows.ball[..., 0]).sum(axis=1) / np.maximum(square, 1e-12)
        out[0, 0], out[1, 0] = place - speed * middle, speed
        return out

    def simulate(self, theta: Array, starts: Array) -> Array:
        """Positions in m at every step, shape (N, C, W).

        Args:
            theta: Parameters, shape (C, P) or (C, W, P), in which case dead time and lag of a
                candidate are those of its first window.
            starts: Position, velocity and, where the level is followed, its deviation.
        """
        each = theta if theta.ndim > 2 else theta[:, None]
        values = {name: each[..., k] for k, name in enumerate(self.names)}
        zero = np.zeros((len(theta), 1))
        gain, level, camber, viscous, friction = (
            values.get(name, zero) for name in ("gain", "level", "camber", "viscous", "friction")
        )
        h = self.step
        steps = int(np.ceil(self.longest / h)) + 1
        grid = self.windows.begin + h * np.arange(steps)[:, None]
        names = ("dead_time", "lag", *PROFILED_EFFECTS)
        drives = np.stack([values.get(name, zero)[:, 0] for name in names], axis=-1)
        kinds, which = np.unique(drives, axis=0, return_inverse=True)
        tilted = np.stack([self._tilted(grid, *each) for each in kinds.tolist()], axis=1)
        across = None
        if self.tilt.log.across[1].any():
            across = np.interp(grid, *self.tilt.log.across)
        off_level = starts[2] if len(starts) > 2 else np.zeros_like(starts[0])
        if self.filter_s:  # the start of the ball, not that of its filtered positions
            places, speeds = starts[:2]
            starts = np.concatenate(([places + self.filter_s * speeds], starts[1:]))
        square_rates = self._square_rates(grid, kinds[:, 0]) if self.turns_fast else None
        out = np.empty((steps, *starts.shape[1:]))
        # blocks of candidates so small that their arrays stay in the processor's cache
        size = max(1, BLOCK_LANES // len(self.windows))
        for first in range(0, len(theta), size):
            part = slice(first, first + size)
            rows = slice(None) if len(gain) == 1 else part
            push = gain[rows] * tilted.take(which[part], axis=1)
            push += h * (level[rows] + off_level[part])
            outwards = None
            if square_rates is not None:  # the gain turns the unit of the angle into rad
                share = gain[rows] ** 2 / (BALL_SHARE * BallPlate.gravity**2)
                outwards = share * square_rates.take(which[part], axis=1)
            out[:, part] = _integrate(
                h,
                starts[:2, part],
                push,
                camber[rows],
                viscous[rows],
                friction[rows],
                across,
                self.stops,
                self.sticking,
                outwards,
            )
        if self.filter_s:
            _filter(out, places, h / self.filter_s)
        return out

    @property
    def turns_fast(self) -> bool:
        """Whether a measured angle turns so fast that it pushes the ball outwards."""
        rate = self.tilt.scale**2 * self.tilt.mean_square_rate
        return BALL_SHARE * rate > MIN_CENTRIFUGAL_PER_S2

    def _square_rates(self, grid: Array, delays: Array) -> Array:
        """Square of the plate's rate, by the measured angle, in swings^2/s^2, shape (N - 1, K, W).

        Args:
            grid: Times of the steps in s, shape (N, W).
            delays: Dead times in s, shape (K,).
        """
        middle = grid[:-1] + self.step / 2
        return np.square([self.tilt.rate_at(middle - delay) for delay in delays]).swapaxes(0, 1)

    def _tilted(self, grid: Array, delay: float, *drive: float) -> Array:
        """Integral of the tilt over each step of the simulation, shape (N - 1, W).

        Args:
            grid: Times of the steps in s, shape (N, W).
            delay: Dead time in s.
            drive: Lag, dead band, play, slew and lever, as ``TiltHistory.integrate`` takes them.
        """
        key, known = (delay, *drive), self.known_tilts
        if key not in known:
            if len(known) * grid.size > MAX_KNOWN_TILTS:
                known.clear()
            known[key] = np.diff(self.tilt.integrate(grid - delay, *drive), axis=0)
        return known[key]

    def simulate_samples(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """A simulation at the samples in m, and its rate in m/s, shape (C, W, B, 1)."""
        places = self.simulate(theta, starts)
        at = self.windows.time / self.step
        low = np.minimum(at.astype(int), len(places) - 2)
        rows = np.arange(len(self.windows))[:, None]
        first, second = (np.moveaxis(places[low + k, :, rows], -1, 0) for k in (0, 1))
        found = np.asarray(first + (at - low) * (second - first))
        return found[..., None], ((second - first) / self.step)[..., None]

    def linearise(self, theta: Array, starts: Array, *, slopes: bool = True) -> Linearisation:
        """Residuals and slopes of C candidates, and how far a window's own level is off."""
        found = super().linearise(theta, starts, slopes=slopes)
        if not self.drift:
            return found
        # one value more: the difference of the window's own level from the common level
        r = np.concatenate((found.r, starts[2][..., None] / self.drift), axis=-1)
        room = [*[(0, 0)] * 2, (0, 1), (0, 0)]
        by_start = np.pad(found.by_start, room)
        by_start[..., -1, 2] = 1 / self.drift
        prior = np.diag([*np.diag(START_PRECISION), 1e-6])
        return Linearisation(r, by_start, np.pad(found.by_parameter, room), prior)


def _integrate(
    h: float,
    starts: Array,
    push: Array,
    camber: Array,
    viscous: Array,
    friction: Array,
    across: Array | None,
    stops: EndStops | None = None,
    sticking: tuple[float, float] = (0.0, 1.0),
    outwards: Array | None = None,
) -> Array:
    """Positions in m at every step by Heun's method, friction apart, shape (N, C, W).

    Args:
        h: Step in s.
        starts: Positions in m and velocities in m/s at the first step, shape (2, C, W).
        push: Change of velocity by tilt and level in each step in m/s, shape (N - 1, C, W); it is
            overwritten.
        camber: 1/s^2, shape (C, 1) or (C, W).
        viscous: 1/s, same shape.
        friction: m/s^2, same shape.
        across: Speed along the other axis in m/s, shape (N, W); None if friction acts on this axis
            alone.
        stops: End stops at which the ball bounces; None without any.
        sticking: Additional friction at rest, m/s^2, and the speed in m/s at which half of it is
            left.
        outwards: Centrifugal acceleration by the place, 1/s^2, shape (N - 1, C, W); None for none.
    """
    shape, count = starts.shape[1:], len(push)
    # velocities by half a step, so that a step moves a ball by the sum of both; it is linear in
    # push, p and v, but for friction
    half = h / 2
    push *= half * (1 - half * viscous)
    kept = 1 + h * (half * (camber + viscous**2) - viscous)
    by_place, most, kept = (
        np.broadcast_to(each, shape).ravel()
        for each in (half * h * camber * (1 - half * viscous), half * h * friction, kept)
    )
    surplus, slow = half * h * sticking[0], half * sticking[1]
    rolling = most
    bends, damps, rubs = by_place.any(), (kept != 1).any(), bool(most.any() or surplus)
    outward_by_place = None if outwards is None else (half * h * outwards).reshape(count, -1)
    places = np.empty((count + 1, *shape))
    places[0] = starts[0]
    p, v = places[0].ravel(), half * starts[1].ravel()
    spare, against = np.empty((2, *p.shape))
    turns = np.empty(p.shape, bool)
    steps, rows = push.reshape(count, -1), places[1:].reshape(count, -1)
    for n in range(count):
        stays = np.multiply(kept, v, out=spare) if damps else v
        free = np.add(steps[n], stays, out=steps[n])
        if bends:
            free += np.multiply(by_place, p, out=spare)
        if outward_by_place is not None:  # at the place in the middle of the step
            free += np.multiply(outward_by_place[n], np.add(p, v, out=spare), out=spare)
        after = free
        if surplus:
            most = rolling + surplus / (1 + np.square(v / slow))
        if rubs:
            np.copysign(most, v, out=against)
            after = np.subtract(free, against, out=spare)
            against *= after
            turned = np.less(against, 0.0, out=turns).nonzero()[0]
            if turned.size:
                _turn(turned, v, free, most, after)
            if across is not None:
                lanes = (each.reshape(shape) for each in (v, free, most, after))
                _rub_aslant(half * across[n], *lanes)
            spare = v
        v += after
        p, v = np.add(p, v, out=rows[n]), after
        if stops is not None:
            _bounce(p, v, stops)
    return places


def _filter(out: Array, first: Array, step: float) -> None:
    """Positions at every step, shape (N, C, W), behind a filter of first order, in place.

    Exact for positions on straight lines between the steps.

    Args:
        out: Before the filter.
        first: Behind it at the first step, shape (C, W).
        step: Length of a step over the time constant.
    """
    keep = np.exp(-step)
    mean = (1 - keep) / step
    state = (mean - keep) * out[0] + keep * first
    out[1:] = lfilter([1 - mean, mean - keep], [1.0, -keep], out[1:], axis=0, zi=state[None])[0]
    out[0] = first


def _bounce(p: Array, v: Array, stops: EndStops) -> None:
    """Put balls that went through an end stop back to it, and turn their velocities, in place."""
    beyond = p > stops.high
    beyond |= p < stops.low
    at = beyond.nonzero()[0]
    if at.size:
        at = at[np.where(p[at] > stops.high, v[at], -v[at]) > 0]
        v[at] *= -stops.restitution
        p[at] = np.clip(p[at], stops.low, stops.high)


def _turn(at: NDArray[np.intp], v: Array, free: Array, most: Array, after: Array) -> None:
    """Correct velocities after a step in which a ball turns or rests: ``after``, at flat indices.

    Friction acts against the old direction, then against the new one.

    Args:
        at: The balls that friction against their old direction would turn.
        v: Velocities before, shape (L,).
        free: After the step without friction, same shape.
        most: Largest change by friction, same shape.
        after: After the step with friction against the old direction.
    """
    pushed, taken = free.take(at), most.take(at)
    pushed -= v.take(at)
    np.abs(pushed, out=pushed)
    share = pushed - taken
    np.maximum(share, 0.0, out=share)
    pushed += taken
    share /= pushed
    share *= after.take(at)
    after.put(at, share)


def _rub_aslant(across: Array, v: Array, free: Array, most: Array, after: Array) -> None:
    """Correct velocities of balls that roll along the other axis as well: ``after``.

    Friction acts against the mean direction of the step.
    """
    before = np.maximum(np.hypot(v, across), 1e-300)
    end = free - most * v / before
    mean = (v + end) / (before + np.hypot(end, across))
    aslant = across >= MIN_CROSS_SPEED_RATIO * (np.abs(free - v) + most)
    np.copyto(after, free - most * mean, where=aslant)
