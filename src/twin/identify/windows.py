"""Windows of a log that are fitted side by side: where they are, their samples, their replay."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.axis_logs import MAX_COMMAND_GAP_S, AxisLog
from twin.identify.least_squares import SampleWindows
from twin.identify.plate_motion import plate_motion
from twin.identify.prepare import (
    ROLL_SPEED_M_S,
    SPEED_INTERVAL_S,
    SPEED_SPAN_S,
    PreparedLog,
    Segment,
    interpolate,
    paces,
    rests,
    speed,
)
from twin.sim.plant.friction import Friction

REPLAY_STEP_S = 0.004
"""Step of the replay in s."""


class AccelerationField(NamedTuple):
    """Acceleration of the ball in W windows at N steps, affine in its position p and velocity v.

    v' = push + own p + cross s(p) + turn s(v) + tilt level, where s() swaps the axes.

    Attributes:
        push: m/s^2, shape (N, 2, 1, W).
        own: 1/s^2, same shape.
        cross: 1/s^2, same shape.
        turn: 1/s, same shape.
        tilt: What a tilt of the base adds along its own axis, m/s^2 per rad, same shape.
        normal: Normal force per mass, m/s^2, shape (N, 1, W).
    """

    push: Array
    own: Array
    cross: Array
    turn: Array
    tilt: Array
    normal: Array

    @classmethod
    def of(cls, model: BallPlate, angle: Array, rate: Array) -> AccelerationField:
        """The field over plate angles and rates (phi, theta), shape (W, N, 2), in rad and rad/s.

        The exact model is affine in the ball's state, so five evaluations determine it.
        """
        x = np.zeros((*angle.shape[:-1], 8))
        x[..., 2::4], x[..., 3::4] = angle, rate
        u = np.gradient(rate, REPLAY_STEP_S, axis=-2)

        def acceleration(index: int | None = None, shift: float = 0.0) -> Array:
            there = x.copy()
            there[..., 2::4] += shift
            if index is not None:
                there[..., index] += 1.0
            return np.asarray(model.derivative(there, u)[..., 1::4])

        push = acceleration()
        by = {index: acceleration(index) - push for index in (0, 1, 4, 5)}
        pairs = {"own": (by[0], by[4]), "cross": (by[4], by[0]), "turn": (by[5], by[1])}
        parts: dict[str, Array] = {
            name: np.stack((first[..., 0], second[..., 1]), axis=-1)
            for name, (first, second) in pairs.items()
        }
        shift = 1e-4
        parts["tilt"] = (acceleration(shift=shift) - acceleration(shift=-shift)) / (2 * shift)
        parts["push"] = push
        normal = model.gravity * np.cos(angle[..., 0]) * np.cos(angle[..., 1])
        return cls(
            **{name: _steps_first(values) for name, values in parts.items()},
            normal=np.ascontiguousarray(normal.T)[:, None],
        )


def replay(
    field: AccelerationField,
    model: BallPlate,
    friction: Friction,
    level: Array,
    start: Array,
    grip: float = 0.0,
    gain: Array | float = 1.0,
    paces: Array | None = None,
) -> tuple[Array, Array]:
    """Positions and velocities of the ball, both shape (N, 2, C, W), in m and m/s.

    Heun's rule for the smooth forces; then rolling resistance takes as much as it can of what would
    bring the ball to rest within the time ``grip``: a ball it can hold rests exactly.

    Args:
        field: The windows.
        model: Ball parameters.
        friction: Rolling resistance of C candidates: numbers, or arrays of shape (C, 1).
        level: Tilt of the base (phi, theta) in rad, shape (2, C, 1).
        start: Position and velocity at the first step, shape (4, C, W): x, y, x', y'.
        grip: Time in s within which resistance would stop the ball if it were strong enough; 0
            for at once, as Coulomb's law has it.
        gain: Factor on what the plate's tilt and acceleration do to the ball: a number, or one per
            candidate, shape (C, 1).
        paces: Speeds of the ball before the first step, ``SPEED_INTERVAL_S`` apart, m/s, shape
            (W, K), for the time at rest; None for a ball that has rolled at its first speed for
            long.
    """
    h, steps = REPLAY_STEP_S, len(field.push)
    p, v = start[:2], start[2:]
    places, speeds = np.empty((2, steps, *p.shape))
    places[0], speeds[0] = p, v
    speed = np.hypot(v[0], v[1])
    age = _age_at_start(friction, speed, paces) if friction.ageing else None
    per_arm = (model.c1 / model.radius) * field.normal
    grip = max(grip, h)
    # arrays that are written again in every step: making them anew would cost as much as the sums
    a, later, pull, spare = np.empty((4, *p.shape))

    def forced(n: int) -> tuple[Array, Array]:
        return gain * field.push[n], gain * (field.tilt[n] * level)

    def free(n: int, p: Array, v: Array, by: tuple[Array, Array], out: Array) -> Array:
        np.multiply(field.own[n], p, out=out)
        out += by[0]
        out += np.multiply(field.cross[n], p[::-1], out=spare)
        out += np.multiply(field.turn[n], v[::-1], out=spare)
        out += by[1]
        return out

    def slowed(v: Array, most: Array) -> Array:
        taken = np.minimum(1.0, most / strength)
        np.subtract(a, np.multiply(pull, taken, out=spare), out=spare)
        return np.asarray(v + np.multiply(h, spare, out=spare))

    constant = friction.constant
    here = forced(0)
    for n in range(steps - 1):
        free(n, p, v, here, a)
        here = forced(n + 1)
        a += free(n + 1, p + h * v, v + h * a, here, later)
        a /= 2
        np.divide(v, grip, out=pull)
        pull += a
        strength = np.maximum(np.hypot(pull[0], pull[1]), 1e-300)
        place = p if friction.map is None else np.moveaxis(p, 0, -1)
        most = per_arm[n] * friction.arm(speed, place, age)
        after = slowed(v, most)
        left = np.hypot(after[0], after[1])
        if not constant:
            halfway = (speed + left) / 2
            if age is not None:
                age = friction.aged(age, halfway, h / 2, speed)
            most = np.where(left > 0, per_arm[n] * friction.arm(halfway, place, age), most)
            after = slowed(v, most)
            left = np.hypot(after[0], after[1])
            if age is not None:
                age = friction.aged(age, left, h / 2, halfway)
        p = p + (h / 2) * (v + after)
        v, speed = after, left
        places[n + 1], speeds[n + 1] = p, v
    return places, speeds


def _age_at_start(friction: Friction, speed: Array, paces: Array | None) -> Array:
    """Age of contacts at speeds in m/s, shape (C, W), after the earlier speeds ``paces``."""
    if paces is None:
        return friction.settled(speed)
    any_lane = np.zeros_like(speed)
    age = friction.settled(any_lane + paces[:, 0])
    for pace in paces.T:
        age = friction.aged(age, any_lane + pace, SPEED_INTERVAL_S)
    # without dwell the age is that of the speed at the start
    return friction.aged(age, speed, REPLAY_STEP_S)


def _steps_first(values: Array) -> Array:
    """From (W, N, 2) to (N, 2, 1, W)."""
    return np.ascontiguousarray(np.moveaxis(values, (1, 2), (0, 1))[:, :, None])


LOOKBACK_S = 0.15
"""Each replay begins this long before its samples, in s: no fit finds a longer delay."""
SAMPLE_BIN_S = 0.016
"""Ball samples within this time in s are averaged."""


class Spans(NamedTuple):
    """Windows: when their samples begin, how long they last, and whether the ball rests first."""

    begin: Array
    length: Array
    resting: Mask


def samples_in_bins(
    time: Array, spans: Spans
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The samples in windows: of which window, which sample, in which bin of it, shape (K,) each.

    Args:
        time: Of the samples in s, ascending, shape (N,).
        spans: The windows.
    """
    end = spans.begin + spans.length + SAMPLE_BIN_S
    first, stop = (np.searchsorted(time, at) for at in (spans.begin - SAMPLE_BIN_S, end))
    row = np.repeat(np.arange(len(first)), stop - first)
    sample = np.arange(len(row)) + (first - np.cumsum(stop - first) + stop - first)[row]
    place = np.floor((time[sample] - spans.begin[row]) / SAMPLE_BIN_S + 1e-6).astype(int)
    inside = (place >= 0) & (place < np.round(spans.length / SAMPLE_BIN_S)[row])
    return row[inside], sample[inside], place[inside]


def average_bins(
    row: NDArray[np.intp], place: NDArray[np.intp], windows: int, bins: int, *values: Array
) -> Iterator[Array]:
    """Means of values, shape (K,) each, over the bins of windows, and how many: all (W, bins)."""
    slot = row * bins + place
    count = np.bincount(slot, minlength=windows * bins).astype(float)
    for each in values:
        yield (np.bincount(slot, each, count.size) / np.maximum(count, 1)).reshape(-1, bins)
    yield count.reshape(-1, bins)


@dataclass(frozen=True)
class Windows(SampleWindows):
    """W parts of a log, along x and y.

    Attributes:
        resting: Whether the ball rests at the beginning, shape (W,).
        paces: Speeds of the ball over the last seconds before, ``SPEED_INTERVAL_S`` apart, m/s,
            shape (W, K).
        field: What accelerates the ball.
        axes: Number of axes of the rig; of 1 the second counts nowhere and its level has no effect.
        white: What makes residuals white that hold unknown motion, shape (W, M, M); None where
            there is none.
    """

    resting: Mask
    paces: Array
    field: AccelerationField
    white: Array | None = None
    _: KW_ONLY
    axes: int = 2
    by_window = (*SampleWindows.by_window, "resting", "paces")

    @classmethod
    def of(
        cls, log: PreparedLog, segment: Segment, spans: Spans, lag: float, longest: float
    ) -> Windows:
        """The windows of a segment, replays beginning ``LOOKBACK`` before the spans.

        Args:
            log: Of which it is a part.
            segment: The ball samples.
            spans: Where the windows are.
            lag: Time constant of the drives in s.
            longest: Room for windows of up to this time in s.
        """
        begin = spans.begin - LOOKBACK_S
        grid = begin[:, None] + REPLAY_STEP_S * np.arange(
            round((LOOKBACK_S + longest) / REPLAY_STEP_S) + 1
        )
        motion = plate_motion(segment, lag, log.own_lag)
        angle, rate = (interpolate(grid, segment.time, values) for values in motion)
        bins = round(longest / SAMPLE_BIN_S)
        row, sample, place = samples_in_bins(segment.sampled, spans)
        values = (segment.sampled[sample] - begin[row], *segment.ball[sample].T)
        time, x, y, count = average_bins(row, place, len(begin), bins, *values)
        moved = AccelerationField.of(log.model, angle, rate)
        there = np.arange(2)[:, None, None] < log.axes
        return cls(
            begin,
            time,
            np.stack((x, y), axis=-1),
            np.sqrt(count)[..., None] / log.sigma,
            spans.resting,
            paces(segment, begin),
            moved._replace(tilt=moved.tilt * there),
            axes=log.axes,
        )

    @property
    def size(self) -> Array:
        """Number of values of the rig's axes in each window, at least 1, shape (W,)."""
        there = self.weight[..., : self.axes] > 0
        return np.asarray(np.maximum(there.sum(axis=(1, 2)), 1))

    def take(self, which: Mask) -> Windows:
        """Some of the windows."""
        field = AccelerationField(*(values[..., which] for values in self.field))
        white = None if self.white is None else self.white[which]
        return replace(super().take(which), field=field, white=white)

    @classmethod
    def join(cls, parts: Sequence[Windows]) -> Windows:
        """All windows of several segments."""
        every = zip(*(part.field for part in parts), strict=True)
        field = AccelerationField(*(np.concatenate(values, axis=-1) for values in every))
        names = cls.by_window
        rest = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(field=field, axes=parts[0].axes, **rest)

    def at_samples(self, places: Array, speeds: Array, delay: Array) -> tuple[Array, Array]:
        """Predicted reports of the screen with their rates, both shape (C, W, B, 2).

        Cubic Hermite interpolation of a replay.

        Args:
            places: Positions in m, shape (N, 2, C, W).
            speeds: Velocities in m/s, same shape.
            delay: Seconds, shape (C, 1) or (C, W).
        """
        steps, _, candidates, windows = places.shape
        # each sample lies a share s into the step of its replay that begins at index low
        at = np.maximum(self.time - delay[..., None], 0.0) / REPLAY_STEP_S
        low = np.minimum(at.astype(int), steps - 2)
        s = (at - low)[..., None]
        lanes = candidates * windows
        # places in the flattened arrays, which are found faster than by four numbers each
        own = np.arange(lanes).reshape(candidates, windows, 1, 1) + lanes * np.arange(2)
        index = (2 * lanes * low)[..., None] + own
        after = index + 2 * lanes
        p0, v0 = places.take(index), REPLAY_STEP_S * speeds.take(index)
        rise, v1 = places.take(after) - p0, REPLAY_STEP_S * speeds.take(after)
        # the cubic with these values and slopes at both ends of the step
        square, cube = 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise
        place = p0 + s * (v0 + s * (square + s * cube))
        return place, (v0 + s * (2 * square + 3 * s * cube)) / REPLAY_STEP_S


FORCE_STRETCH_S = 0.3
"""Seconds in which an unknown force stays the same: a ball crosses a patch of a screen in some."""


def edges_of(windows: Windows) -> Array:
    """When each acceleration begins, and the last ends, s from the begin of the windows."""
    steps, each = len(windows.field.push) - 1, round(FORCE_STRETCH_S / REPLAY_STEP_S)
    return REPLAY_STEP_S * np.arange(0, steps + each, each)


def unknown_motion(windows: Windows, delay: float) -> Array:
    """Shift of the samples by each unknown acceleration, in their standard deviations, per m/s^2.

    Small forces on the ball that nobody knows (patches of the screen, its waves, the plate's
    errors) are taken as white along its way: one acceleration for every ``STRETCH`` of time, each
    axis of the rig its own, drawn at random. What they may have moved the ball by is left out of a
    window's likelihood (generalised least squares), so that a window may be long enough to show a
    dead time without showing a rough screen as one.

    Args:
        windows: W windows of B samples.
        delay: Dead time of the screen in s.

    Returns:
        Shape (W, 2 B, 2 S), samples as a ``Linearisation`` has them.
    """
    count, samples = windows.time.shape
    edges = edges_of(windows)
    since = np.maximum((windows.time - delay)[..., None] - edges, 0.0)
    twice = since**2 / 2
    moved = twice[..., :-1] - twice[..., 1:]
    there = np.diag(np.arange(2) < windows.axes).astype(float)
    both = np.einsum("wbs,wba,ac->wbasc", moved, windows.weight, there)
    return np.asarray(both.reshape(count, 2 * samples, 2 * moved.shape[-1]))


MAP_SPACING_M = 0.05
"""Distance in m of the points of a map of the friction."""


@dataclass(frozen=True)
class Patches:
    """K surfaces with more friction about a point each, straight between the points of a map.

    Attributes:
        points: Shape (K, 2), m.
        more: Share of the friction by which it is more there.
    """

    points: Array
    more: float

    @classmethod
    def near(cls, places: Array, more: float) -> Patches:
        """About the points of the map near which a ball comes, places of shape (..., 2) in m."""
        corners = np.floor(places.reshape(-1, 2) / MAP_SPACING_M)
        every = (corners[:, None] + np.array([(0, 0), (0, 1), (1, 0), (1, 1)])).reshape(-1, 2)
        return cls(MAP_SPACING_M * np.unique(every, axis=0), more)

    def __call__(self, position: Array) -> tuple[Array, Array]:
        """Relative friction, shape (K, W), and no slope, as a ``SurfaceMap`` has them."""
        near = np.maximum(0.0, 1 - np.abs(position - self.points[:, None]) / MAP_SPACING_M)
        return 1 + self.more * near.prod(axis=-1), np.zeros_like(position)


def cut(
    log: PreparedLog,
    lag: float,
    longest: float,
    choose: Callable[[Segment, float, float, float], Spans],
) -> Windows | None:
    """All windows of a log; None if there are none.

    Args:
        log: What was recorded.
        lag: Time constant of the drives in s.
        longest: Longest window in s.
        choose: Called with a segment, first and last time of its windows in s, and ``longest``.
    """
    parts = []
    for segment in log.segments:
        begin, end = segment.time[0] + LOOKBACK_S, min(segment.time[-1], segment.sampled[-1])
        spans = choose(segment, begin, end, longest)
        if len(spans.begin):
            parts.append(Windows.of(log, segment, spans, lag, longest))
    return Windows.join(parts) if parts else None


def moving_spans(segment: Segment, begin: float, end: float, longest: float) -> Spans:
    """Windows in sequence between two times, each begun at rest or in full roll.

    A window goes on until the ball has come to rest again or the longest time is up. Of a rest
    only the end is in a window: the earlier part determines no parameter.

    Args:
        segment: The part of the log.
        begin: Seconds.
        end: Seconds.
        longest: Longest window in s.
    """
    time = segment.time
    moving = speed(time, segment.even_ball)
    still = rests(time, segment.even_ball, moving)
    found: list[tuple[float, float, bool]] = []
    at = begin
    while at < end - SPEED_SPAN_S:
        rest = next(((a, b) for a, b in still if a - 1e-9 <= at < b), None)
        if rest is None and moving[int(np.searchsorted(time, at))] <= ROLL_SPEED_M_S:
            at += 0.02
            continue
        if rest is not None and rest[1] > end - SPEED_SPAN_S:
            break
        first = at if rest is None else max(at, rest[1] - SPEED_SPAN_S)
        after = first if rest is None else rest[1]
        stop = next((a for a, _ in still if a > after), end)
        last = min(first + longest, stop + SPEED_SPAN_S, end)
        if last - first > SPEED_SPAN_S:
            found.append((first, last - first, rest is not None))
        at = last
    columns = np.array(found, dtype=float).reshape(-1, 3)
    return Spans(columns[:, 0], columns[:, 1], columns[:, 2] > 0)


MIN_WINDOW_SHARE = 0.4
"""Least share of the longest window that a window has."""


def axis_windows(log: AxisLog, begin: Array, end: Array) -> SampleWindows:
    """The windows of an axis between two times in s each, (W,); weights are of one sample in m."""
    bins = int(np.ceil(float(np.max(end - begin, initial=SAMPLE_BIN_S)) / SAMPLE_BIN_S - 1e-6))
    first, stop = np.searchsorted(log.sampled, np.stack((begin - 1e-9, end)))
    row = np.repeat(np.arange(len(begin)), stop - first)
    each = zip(first, stop, strict=True)
    sample = np.concatenate([np.zeros(0, int), *(np.arange(*ends) for ends in each)])
    since = log.sampled[sample] - begin[row]
    place = np.minimum(np.floor(since / SAMPLE_BIN_S + 1e-6).astype(int), bins - 1)
    time, ball, count = average_bins(row, place, len(begin), bins, since, log.ball[sample])
    return SampleWindows(begin, time, ball[..., None], np.sqrt(count)[..., None])


def find_moving(windows: SampleWindows, min_motion_m: float) -> Mask:
    """Windows in which the ball moves along x by more than some metres, shape (W,).

    All windows if it does so in none.
    """
    there, ball = windows.weight[..., 0] > 0, windows.ball[..., 0]
    highest = np.max(ball, axis=1, where=there, initial=-np.inf)
    moves = highest - np.min(ball, axis=1, where=there, initial=np.inf) > min_motion_m
    return moves if moves.any() else np.ones_like(moves)


MAX_GAP_STEPS = 3.5
"""Time without a sample, over the usual time between two, that is no gap for a slow camera."""


def usual_step(log: AxisLog) -> float:
    """Usual time between two samples in s."""
    return float(np.median(np.diff(log.sampled))) if len(log.sampled) > 1 else MAX_COMMAND_GAP_S


def _free_stretches(log: AxisLog) -> Iterator[Array]:
    """Times of successive samples in s, without gaps, of a ball that touches no end stop."""
    free, time = ~log.touching, log.sampled
    gap = max(MAX_COMMAND_GAP_S, MAX_GAP_STEPS * usual_step(log))
    apart = (np.diff(time) > gap) | (np.diff(free.astype(int)) != 0)
    borders = np.concatenate(([0], np.flatnonzero(apart) + 1, [len(time)]))
    for first, stop in pairwise(borders):
        if stop > first and free[first]:
            yield time[first:stop]


def usual_free_time(log: AxisLog) -> float:
    """Length in s of the stretches between end stops that hold half of the free time."""
    lengths = np.sort([each[-1] - each[0] for each in _free_stretches(log)] or [0.0])
    half = np.searchsorted(np.cumsum(lengths), lengths.sum() / 2)
    return float(lengths[min(half, len(lengths) - 1)])


def spans(log: AxisLog, longest: float) -> tuple[Array, Array]:
    """Beginnings and ends of windows in sequence, s: none spans a gap or touches an end stop."""
    found = list[tuple[float, float]]()
    step = usual_step(log)
    for here in _free_stretches(log):
        length = float(here[-1] - here[0]) if len(here) else 0.0
        if length < MIN_WINDOW_SHARE * longest:
            continue
        edges = np.linspace(here[0], here[-1] + step / 2, int(np.ceil(length / longest)) + 1)
        for begin, end in pairwise(edges):
            inside = here[(here >= begin) & (here < end)]
            if len(inside) >= max(6, 0.3 * (end - begin) / step):
                found.append((float(inside[0]), float(end)))
    pairs = np.array(found).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]
