"""The state of rig and controller at a moment of a run or a log, from which a simulation goes on.

A simulated run is simulated again up to it, to the bit. With a log, or a run in which a person
pushed or chose a different law, the twin is synchronised: it follows the log for a while and begins
in the state that the log shows, if the log is complete enough for that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from controllers.arrays import Array
from controllers.controller import Controller
from controllers.interfaces import DelayedObserver, Measurement
from twin.base.errors import RecordError
from twin.hal.interface import Clamp
from twin.identify.logs import Log
from twin.identify.prepare import interpolate
from twin.run.assemble import assemble
from twin.run.controller_building import build_controller, build_limits, build_reference, law_of
from twin.run.finished import Run
from twin.run.loop import drive
from twin.run.metrics import Motion
from twin.run.record import Recorder
from twin.run.state import Snapshot, restore
from twin.scenario.schema import Scenario
from twin.sim.rig import SimulatedRig


@dataclass(frozen=True, kw_only=True)
class PathFit:
    """How position and velocity of the ball follow from touch samples.

    Attributes:
        half_width_s: Half of the time in s over which a parabola is fitted.
        frames: Number of frames of a slow camera that replaces this time, and ``max_gap_s``, where
            they take longer.
        min_touches: Smallest number of samples for a parabola.
        max_gap_s: Time in s between two samples above which a log has a gap. A loop that is overdue
            for less leaves the last command in force, which is known.
    """

    half_width_s: float = 0.08
    frames: int = 5
    min_touches: int = 5
    max_gap_s: float = 0.1

    def half_width(self, frame_s: float) -> float:
        """Half of the time in s over which a parabola is fitted, for a time from frame to frame."""
        return max(self.half_width_s, self.frames * frame_s)

    def max_gap(self, frame_s: float) -> float:
        """Time in s above which a log has a gap, for a time in s from frame to frame."""
        return max(self.max_gap_s, self.frames * frame_s)


PATH_FIT = PathFit()


def touches(log: Log, dead_time: float) -> tuple[Array, Array]:
    """Times in s, shape (K,), and positions of the ball in m, (K, 2): one entry per new sample.

    Args:
        log: The log.
        dead_time: Time in s from a touch to its arrival.
    """
    shown = log.time - log.age - dead_time
    seen = log.touched & np.isfinite(log.ball).all(axis=1) & np.isfinite(shown)
    time, ball = shown[seen], log.ball[seen]
    # a sample that waits is one and the same, read again
    new = np.concatenate(([True], np.diff(time) > 1e-6)) if len(time) else np.zeros(0, bool)
    return time[new], ball[new]


def path(time: Array, samples: tuple[Array, Array], fit: PathFit = PATH_FIT) -> tuple[Array, Array]:
    """Position in m and velocity in m/s at some times, each (M, 2); NaN with too few samples.

    Those of a parabola through the samples about each time, by least squares.

    Args:
        time: Times in s, shape (M,).
        samples: Times in s, shape (K,), and positions in m, shape (K, 2).
        fit: Constants of the fit.
    """
    known, ball = samples
    half = fit.half_width(frame(known))
    found = np.full((len(time), 2, 2), np.nan)
    first, last = np.searchsorted(known, time - half), np.searchsorted(known, time + half)
    enough = np.flatnonzero(last - first >= fit.min_touches)
    about = known[first[enough]] <= time[enough], known[last[enough] - 1] >= time[enough]
    rows = enough[about[0] & about[1]]
    at = first[rows, None] + np.arange(np.max(last - first, initial=0))
    there = at < last[rows, None]
    at = np.minimum(at, len(known) - 1)
    s = np.where(there, (known[at] - time[rows, None]) / half, 0.0)
    powers = there[..., None] * s[..., None] ** np.arange(3)
    flipped = powers.swapaxes(1, 2)
    fitted = np.linalg.solve(flipped @ powers, flipped @ ball[at])
    found[rows, 0], found[rows, 1] = fitted[:, 0], fitted[:, 1] / half
    return found[:, 0], found[:, 1]


def frame(time: Array) -> float:
    """Median time in s from one touch to the next; 0 with fewer than two."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


@dataclass(frozen=True, kw_only=True)
class Synchronisation:
    """How a twin gets into the state that a record shows, and how well it is there.

    Attributes:
        duration_s: Time in s for which the twin follows the log before the prediction starts.
        catch_up_s: Time in s of it within which the plate tilts from level to the log's angle.
        plate_time_constant_s: Time constant in s with which the plate is held at the log's angles.
        smoothed_s: Time in s over which the angles that encoders count are smoothed.
        observer_s: Longest time in s for which an observer reads the log; a law with a memory reads
            all of it.
        compared_s: Time in s before the moment over which twin and record are compared.
        max_distance_mm: Distance in mm of twin and record, above which a future is not reliable.
        max_limited_deg: Angle in deg by which limits may keep the twin's plate off the commands
            within the compared time without a note.
    """

    duration_s: float = 0.6
    catch_up_s: float = 0.3
    plate_time_constant_s: float = 0.1
    smoothed_s: float = 0.042
    observer_s: float = 60.0
    compared_s: float = 1.0
    max_distance_mm: float = 5.0
    max_limited_deg: float = 0.5


SYNCHRONISATION = Synchronisation()


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A moment of a run.

    Attributes:
        name: Name of the run.
        at: Its time, s; a whole number of periods.
        scenario: Scenario of the run.
        recorded: The recorded motion before and after it, for comparison; the ball of a log is
            smoothed, NaN where there is none.
        exact: Whether the state is the run's own to the bit, or estimated.
        before_mm: Largest distance in mm of twin and record over the last second before it; None
            if there is no such second.
        controller: Makes a controller of the run in its state at the moment.
        put: Puts a rig, switched on, into its state at the moment; returns the measurement of the
            period.
        gaps: Beginning and end in s of each part without a record.
        notes: Remarks on it, a sentence each.
    """

    name: str
    at: float
    scenario: Scenario
    recorded: Motion
    exact: bool
    before_mm: float | None
    controller: Callable[[], Controller]
    put: Callable[[SimulatedRig], Measurement]
    gaps: tuple[tuple[float, float], ...] = ()
    notes: tuple[str, ...] = ()


def take_over(
    new: Controller, old: Controller, was: Scenario, now: Scenario, at: float = 0.0
) -> None:
    """Give a controller, just started, the unchanged parts of the previous one.

    Args:
        new: The controller.
        old: The previous one, in its state.
        was: Scenario of the old one.
        now: Scenario of the new one.
        at: Time in s: a new plan begins there.
    """
    new.rate, new.requested = old.rate, old.requested
    if now.controller == was.controller:
        new.memory = old.memory
    if (now.observer, now.predictor) == (was.observer, was.predictor):
        if isinstance(old.observer, DelayedObserver):
            old.observer.needed = new.law.needs
        new.observer = old.observer
    else:
        new.observer.start(old.observer.x)
    if now.reference == was.reference:
        new.reference = old.reference
    if now.reference == was.reference and law_of(now) == law_of(was):
        # the law's plan and the held command remain
        new.plan = old.plan
    else:
        new.take_over_at(at)


def exact(run: Run, at: float) -> Moment:
    """A moment of a simulated run of this version.

    Args:
        run: The run, opened.
        at: The moment, s; a whole number of periods within the run.

    Raises:
        RecordError: If the run ends before the twin gets there.
    """
    snapshot, times, ball = _simulated_again(run.scenario, at)
    motion = run.motion
    known = motion.ball[np.searchsorted(motion.time, times - 1e-9)]
    last = times > at - SYNCHRONISATION.compared_s
    apart = float(np.hypot(*(ball - known)[last].T).max()) if last.any() else None
    return Moment(
        name=run.name,
        at=at,
        scenario=run.scenario,
        recorded=motion,
        exact=True,
        before_mm=None if apart is None else 1000 * apart,
        controller=partial(_controller, run.scenario, snapshot),
        put=snapshot.restore,
    )


def _controller(scenario: Scenario, snapshot: Snapshot) -> Controller:
    """The controller of a scenario in the state of a snapshot."""
    controller = build_controller(scenario)
    controller.start(snapshot.measured)
    restore(controller, snapshot.controller)
    return controller


def _simulated_again(scenario: Scenario, at: float) -> tuple[Snapshot, Array, Array]:
    """The state at a moment; times in s, shape (K,), and positions of the ball in m before it.

    Raises:
        RecordError: If the run ends before.
    """
    rig, controller = assemble(scenario, unseen=True)
    period = scenario.rig.period
    record = Recorder(round(at / period) + 1, 1, period, rig.channels, keep=("state",))
    kept: list[Snapshot] = []

    def keep(tick: int, measurement: Measurement) -> None:
        if tick == round(at / period):
            kept.append(Snapshot.take(rig, controller, measurement))

    drive(rig, controller, at + period, record, keep=keep)
    if not kept:
        raise RecordError(f"--at {at:g}: the twin's run ended before, at {record.end:g} s")
    return kept[0], record.time[:-1], record["state"][:-1, 0, 0::4]


@dataclass(frozen=True, kw_only=True)
class ReplayableLog(Log):
    """A log from which the twin can continue, its incomplete rows left out.

    Where the screen detected no ball, its position is the last detected one.

    Attributes:
        command: Commanded plate rates in rad/s from each row on, shape (K, 2).
        samples: Touch samples of the ball: times in s, (M,), and positions in m, (M, 2).
        gaps: Beginning and end in s of each part in which the ball's path is not known: its last
            touch, and the arrival of the next one.
    """

    command: Array
    samples: tuple[Array, Array]
    gaps: tuple[tuple[float, float], ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """The gaps in a sentence; none without gaps."""
        if not self.gaps:
            return ()
        spans = ", ".join(f"{begin:.3f} to {end:.3f} s" for begin, end in self.gaps)
        return (f"{self.source}: gaps, which are not filled: {spans}",)

    def unbroken_since(self, at: float) -> float:
        """Time in s after which there is no gap before a moment."""
        ends = [end for _, end in self.gaps if end <= at]
        return max([float(self.time[0]), *ends])

    def measurement(self, row: int) -> Measurement:
        """The measurement of the rig in a row."""
        y = np.empty((1, 4))
        y[0, 0::2], y[0, 1::2] = self.ball[row], self.plate[row]
        one = slice(row, row + 1)
        return Measurement(float(self.time[row]), y, self.age[one], self.touched[one])

    def commanded(self, time: Array) -> Array:
        """Plate rates in rad/s in force at some times, shape (M, 2)."""
        return self.command[np.maximum(0, np.searchsorted(self.time, time + 1e-9) - 1)]


def make_replayable(
    log: Log, scenario: Scenario, at: float, fit: PathFit = PATH_FIT
) -> ReplayableLog:
    """The log in the form that the twin can use.

    Args:
        log: The log as it was read.
        scenario: The scenario that ran.
        at: The moment from which to continue, s.
        fit: How the ball's path follows from touch samples.

    Raises:
        RecordError: If it has no commands, or does not know the moment.
        LogError: If it is of a different rig, or in a wrong unit.
    """
    if log.command is None:
        raise RecordError(
            f"{log.source}: no commands; what-if needs applied_phi_acc and applied_theta_acc, or "
            "applied_phi_rate and applied_theta_rate"
        )
    whole = np.isfinite(np.column_stack((log.time, log.plate, log.command))).all(axis=1)
    kept, period = log.rows(whole), scenario.rig.period
    time = kept.time
    _check_rows(log, time, period)
    if not time[0] - period / 2 <= at <= time[-1] + period / 2:
        raise RecordError(f"--at {at:g}: {log.source} goes from {time[0]:g} to {time[-1]:g} s")
    samples = touches(log, scenario.sensors.touch.dead_time)
    max_gap = fit.max_gap(frame(samples[0]))
    gaps = tuple(
        (float(samples[0][k]), float(samples[0][k + 1] + scenario.sensors.touch.dead_time))
        for k in np.flatnonzero(np.diff(samples[0]) > max_gap)
    )
    for begin, end in gaps:
        if begin < at < end:
            raise RecordError(f"--at {at:g}: {log.source} has a gap from {begin:g} to {end:g} s")
    if not np.isfinite(path(np.array([at]), samples, fit)[0]).all():
        raise RecordError(
            f"--at {at:g}: {log.source}: the ball is not seen often enough around this time"
        )
    felt = kept.touched & np.isfinite(kept.ball).all(axis=1)
    held = np.maximum.accumulate(np.where(felt, np.arange(len(felt)), np.argmax(felt)))
    about = vars(kept) | {"ball": kept.ball[held], "touched": felt}
    return ReplayableLog(**about, samples=samples, gaps=gaps)


def _check_rows(log: Log, time: Array, period: float) -> None:
    steps = np.diff(time)
    if len(time) < 2 or not (steps > 0).all():
        raise RecordError(f"{log.source}: time: must rise from row to row")
    own = float(np.median(steps))
    if abs(own - period) > 0.1 * period:
        raise RecordError(
            f"{log.source}: a row every {1000 * own:.3g} ms, but the scenario has rig.period = "
            f"{period:g} s; is it a log of this rig?"
        )


def estimate_moment(
    name: str,
    log: ReplayableLog,
    scenario: Scenario,
    at: float,
    synchronisation: Synchronisation = SYNCHRONISATION,
) -> Moment:
    """A moment of a log.

    Args:
        name: Name of the log.
        log: The log, see ``make_replayable``.
        scenario: The scenario that ran.
        at: The moment, s; a whole number of periods within the log.
        synchronisation: How the twin gets into its state.
    """
    period = float(np.median(np.diff(log.time)))
    return Moment(
        name=name,
        at=at,
        scenario=scenario,
        recorded=Motion(
            time=log.time,
            ball=path(log.time, log.samples)[0],
            plate=log.plate,
            u=np.diff(log.command, axis=0, prepend=log.command[:1]) / period,
            reference=build_reference(scenario)(log.time)[0],
        ),
        exact=False,
        before_mm=_largest_distance(log, scenario, at, synchronisation),
        controller=partial(_warm_up, log, scenario, at, synchronisation.observer_s),
        put=partial(_synchronise, log, at, synchronisation),
        gaps=log.gaps,
        notes=(*log.notes, *_describe_limits(log, scenario, at, synchronisation)),
    )


def _describe_limits(
    log: ReplayableLog, scenario: Scenario, at: float, about: Synchronisation
) -> Iterator[str]:
    """A note on limits of the twin's rig that keep its plate off the commands before a moment.

    Drives of another rig, as hobby servos, follow commands that the twin's own may not.
    """
    period, limits, known = scenario.rig.period, scenario.rig.limits, build_limits(scenario)
    # a plate that leaves its range of angles is no slow drive
    clamp = Clamp(replace(known, angle=np.inf), period)
    times = at - about.compared_s + period * np.arange(round(about.compared_s / period))
    wanted = log.commanded(times)
    rate, off, apart = np.clip(wanted[:1], -known.rate, known.rate), np.zeros((1, 2)), 0.0
    for each in wanted:
        rate = clamp(each[None], rate, off)
        off = off + (rate - each) * period
        apart = max(apart, float(np.abs(off).max()))
    if math.degrees(apart) > about.max_limited_deg:
        steps = np.abs(np.diff(log.command, axis=0)).max() / period
        yield (
            f"{log.source}: the twin's rig.limits keep its plate up to {math.degrees(apart):.2g} "
            f"deg off the commands of the second before (acceleration {limits.acceleration:g} "
            f"rad/s^2, rate_deg {limits.rate_deg:g} deg/s): if your drives follow faster, write it "
            f"into the file of --on; rig.limits.acceleration = {math.ceil(steps)} and "
            f"rig.limits.rate_deg = {math.ceil(math.degrees(np.abs(log.command).max()))} let all "
            "commands of this log pass"
        )


def _warm_up(log: ReplayableLog, scenario: Scenario, at: float, longest_s: float) -> Controller:
    """The controller of a scenario after it has read the log up to a moment, without a gap."""
    controller = build_controller(scenario)
    since = log.unbroken_since(at)
    if not controller.law.memory:
        since = max(since, at - longest_s)
    rows = np.flatnonzero((log.time > since - 1e-9) & (log.time < at - 1e-9))
    for number, row in enumerate(rows.tolist()):
        measurement = log.measurement(row)
        if number == 0:
            controller.start(measurement)
            controller.rate = log.command[max(row - 1, 0)][None]
        controller.command(measurement)
        controller.applied(log.command[row : row + 1])
    return controller


def _synchronise(
    log: ReplayableLog, at: float, about: Synchronisation, rig: SimulatedRig
) -> Measurement:
    """Let a rig follow the log up to a moment; the measurement of that period."""
    period = rig.period
    ticks = min(round(about.duration_s / period), round((at - log.unbroken_since(at)) / period))
    begin = at - ticks * period
    rig.devices.begin_at(begin)
    times = begin + period * np.arange(ticks + 1)
    angle = interpolate(times, log.time, _smooth(log.plate, about.smoothed_s / period))
    rate = log.commanded(times)
    catch_up = min(about.catch_up_s, max(about.duration_s / 2, period))
    share = np.minimum(1.0, (times - begin) / catch_up)
    blend = share**2 * (3 - 2 * share)
    ball, velocity = path(times, log.samples)
    state = np.stack((ball[:, 0], velocity[:, 0], ball[:, 1], velocity[:, 1]), axis=1)
    # right after a gap the path is not known yet: the ball is held at its first known position
    known = np.isfinite(state).all(axis=1)
    state = state[np.maximum(np.arange(ticks + 1), int(np.argmax(known)))]
    rig.devices.place(state[:1])
    rig.devices.forget()
    rig.supervisor.forget_ball()
    for tick in range(ticks):
        rig.devices.place(state[tick : tick + 1])
        measured = rig.read().y[0, 1::2]  # behind drives that lag it is not what was commanded
        # d/dt (blend angle), and the error of the angle fed back
        blend_rate = (blend[tick + 1] - blend[tick]) / period
        forward = blend[tick] * rate[tick] + blend_rate * angle[tick]
        error = blend[tick] * angle[tick] - measured
        rig.write((forward + error / about.plate_time_constant_s)[None])
        rig.wait()
    rig.devices.place(state[ticks : ticks + 1])
    rig.supervisor.rate = log.commanded(np.array([at - period]))
    return rig.read()


def _smooth(angles: Array, rows: float) -> Array:
    """Angles of shape (K, 2), each the mean of so many rows around it, an odd number of them."""
    window = min(2 * int(rows / 2) + 1, len(angles))
    if window < 3:
        return angles
    return np.asarray(scipy.signal.savgol_filter(angles, window, 1, axis=0))


def _largest_distance(
    log: ReplayableLog, scenario: Scenario, at: float, about: Synchronisation
) -> float | None:
    """Largest distance in mm of twin and log over the last second, under the log's commands."""
    begin = at - about.compared_s
    period = scenario.rig.period
    if log.unbroken_since(at) > begin - about.duration_s / 2:
        return None
    rig, _ = assemble(scenario, unseen=True)
    times = begin + period * np.arange(round(about.compared_s / period))
    found: list[Array] = []
    with rig:
        rig.read()
        rig.start()
        _synchronise(log, begin, about, rig)
        for rate in log.commanded(times):
            rig.write(rate[None])
            rig.wait()
            rig.read()
            found.append(rig.devices.state[0, 0::4])
    known, _ = path(times + period, log.samples)
    apart = np.hypot(*(np.array(found) - known).T)
    return float(1000 * np.nanmax(apart)) if np.isfinite(apart).any() else None
