"""Plate motion in a log: lag and play of the drives, and whether the ball follows the plate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, detrend, filtfilt, lfilter

from controllers.arrays import Array
from twin.base.errors import LogError
from twin.hal.cams import CamTable
from twin.identify.intervals import Estimate
from twin.identify.least_squares import Fit, FitProblem, SampleWindows, minimise
from twin.identify.parameters import DRIVE_PARAMETERS
from twin.identify.prepare import COLUMNS_OF_AXIS, ROLL_SPEED_M_S, PreparedLog, Segment, speed
from twin.identify.samples import resolution
from twin.sim.drives import Hysteresis, Play

CORNER_FREQUENCIES_HZ = (0.8, 1.5, 3.0, 6.0, 12.0, 25.0)
"""Corner frequencies in Hz; the data choose how much of the encoders to believe."""
CHUNK_S, OTHER_CHUNKS_S = 1.0, (0.5, 2.0)
"""Length in s of the pieces from which a parabola is taken, for disturbances drift the plate; and
others that would do as well: by how much the lag differs with them, the model is wrong."""
PLAY_GUESSES_RAD = np.radians((0.0, 0.03, 0.1, 0.3))
"""Play in rad from which a fit of the drives begins."""
MAX_DRIVE_STEPS = 8
"""Steps of such a fit."""
MIN_TILT_WAY_M2_S = 1e-6
"""Squared way that tilts made, beyond x0 and v0, over time, below which they tell nothing."""
MAX_GAIN_STD = 0.1
"""Standard deviation that the noise of the screen alone gives the ball's acceleration over what the
plate's angles explain, above which it is not known."""


class Drives(NamedTuple):
    """How the drives follow.

    Attributes:
        lag: Time constant, s.
        half_width: Of its 95 % interval, s; infinite where the data say nothing.
        play: What the plate loses at a reversal, rad.
    """

    lag: float
    half_width: float
    play: float


def servo_response(
    command: Array, period: float, lag: float, shift: float = 0.0
) -> tuple[Array, Array]:
    """Plate angles and rates of a first-order rate servo, from zero, both shape (K, 2).

    Solves lag * rate' = command - rate exactly for commands held over each period.

    Args:
        command: Commanded plate rates in rad/s from each instant on, shape (K, 2).
        period: Time between them in s.
        lag: Time constant in s.
        shift: Further delay of all of it in s.
    """
    stay = np.exp(-period / lag) if lag > 0 else 0.0
    rate: Array = lfilter([0.0, 1.0 - stay], [1.0, -stay], command, axis=0)
    covered = np.zeros_like(command)
    covered[1:] = period * np.cumsum(command[:-1], axis=0)
    # The integral of lag * rate' = command - rate.
    angle = covered - lag * rate
    if shift == 0.0:
        return angle, rate
    whole, part = divmod(shift / period, 1.0)
    return _delay_samples(angle, int(whole), part), _delay_samples(rate, int(whole), part)


def plate_motion(segment: Segment, lag: float, shift: float) -> tuple[Array, Array]:
    """Plate angles in rad and rates, (K, 2), from encoders and, if it was recorded, the command.

    What the encoders say beyond the servos' response is smoothed by a zero-phase second-order
    Butterworth filter: the optimal (Rauch-Tung-Striebel) smoother where disturbances are white
    accelerations and encoder errors white.

    Args:
        segment: Of the log.
        lag: Time constant of the servos in s.
        shift: Their further delay in s.
    """
    measured, period = segment.plate, float(segment.time[1] - segment.time[0])
    angle, rate = np.zeros_like(measured), np.zeros_like(measured)
    if segment.command is not None:
        angle, rate = servo_response(segment.command, period, lag, shift)
    rest = measured - angle
    smooth = np.stack(
        [_smooth(rest[:, axis], period, resolution(measured[:, axis])) for axis in (0, 1)], axis=-1
    )
    return angle + smooth, rate + np.gradient(smooth, period, axis=0)


def fit_drives(log: PreparedLog) -> Drives | None:
    """How the drives follow their commands; None if these were not recorded.

    What else lies between motor and plate shows in the same band and is fitted along: elasticity,
    which lets the plate of either axis lead by its acceleration over the square of the resonance,
    and play. Where the drives follow a different law, the lag depends on the length of the
    pieces: this difference is taken for a standard deviation and added to the interval, as is the
    delay of a damped resonance, see ``_resonance_delay``.
    """
    lengths = [round(each / log.period) for each in (CHUNK_S, *OTHER_CHUNKS_S)]
    segments = [s for s in log.segments if s.command is not None and len(s.time) >= max(lengths)]
    if not segments:
        return None
    guesses = np.array([(0.02, 0.0, 0.0, play) for play in PLAY_GUESSES_RAD])
    found = _fit_plate(log, segments, guesses, lengths[0])
    others = [_fit_plate(log, segments, found.value[None], rows).value[0] for rows in lengths[1:]]
    apart = float(np.abs(others - found.value[0]).max())
    delay = _resonance_delay(log, segments, found.value)
    half = float(np.linalg.norm((found.half_width[0], 2 * apart, 2 * delay)))
    return Drives(lag=float(found.value[0]), half_width=half, play=float(found.value[3]))


def _resonance_delay(log: PreparedLog, segments: list[Segment], value: Array) -> float:
    """Delay in s that the damping of the resonance may add to the lag; the model has none.

    A mode at w0 that delays slow motion by T delays motion at w by T (1 + w^2 / w0^2) to second
    order. The lag is shown in proportion to the squared rate, so the mean of w^2 is the mean
    squared acceleration over the mean squared rate. The larger of both axes counts.

    Args:
        log: With the delay T of the twin's own drives, ``own_lag``.
        segments: Parts of it with commands.
        value: Fitted lag in s and 1/w0^2 of both axes in s^2, then others.
    """
    squares = np.zeros((2, 2))
    for segment in segments:
        assert segment.command is not None
        _, rate = servo_response(segment.command, log.period, float(value[0]))
        squares += [(np.gradient(rate, log.period, axis=0) ** 2).sum(axis=0), (rate**2).sum(axis=0)]
    mean_square_frequency = squares[0] / np.maximum(squares[1], 1e-30)
    return float(log.own_lag * np.max(np.abs(value[1:3]) * mean_square_frequency))


@dataclass(frozen=True)
class DriveProblem(FitProblem[SampleWindows]):
    """How plates follow commands, in pieces without their parabola.

    Attributes:
        log: What was recorded.
        segments: Parts of it with commands.
    """

    log: PreparedLog
    segments: list[Segment]
    about = DRIVE_PARAMETERS
    start_steps = np.zeros(0)
    prior = np.zeros((0, 0))
    grows = True

    def simulate_samples(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """The pieces as drives would make them, twice, shape (C, W, rows, 2)."""
        angles = [_plate(segment, self.log, theta) for segment in self.segments]
        found = _remove_parabola(angles, self.windows.time.shape[1])
        return found, found


def _remove_parabola(angles: list[Array], rows: int) -> Array:
    """Angles in pieces of some rows, without their parabola, shape (..., W, rows, 2)."""
    base, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, rows), 3))
    cut = np.concatenate([_pieces(each, rows) for each in angles], axis=-3)
    return np.asarray(cut - base @ (base.T @ cut))


def _fit_plate(log: PreparedLog, segments: list[Segment], theta: Array, rows: int) -> Estimate:
    """Lag in s, elasticity of both axes in s^2, play in rad: the best from C guesses, (C, 4).

    Pieces that do not follow at all (a wheel off its cam) must not decide: all are weighed by the
    usual misfit of the best guess.
    """
    measured = [segment.plate for segment in segments]
    ball = _remove_parabola(measured, rows)
    begin, starts = np.zeros(len(ball)), np.zeros((0, len(theta), len(ball)))
    weight = np.broadcast_to(np.arange(2) < log.axes, ball.shape).astype(float)
    for _ in range(2):
        windows = SampleWindows(begin, np.zeros(ball.shape[:2]), ball, weight)
        problem = DriveProblem(windows, tuple(DRIVE_PARAMETERS), log, segments)
        misfit = problem.misfit(problem.linearise(theta, starts, slopes=False).r)
        weight = weight / np.sqrt(max(float(np.median(misfit.min(axis=0))), 1e-30))
        problem = replace(problem, windows=replace(windows, weight=weight))
        found = minimise(problem, theta, starts, MAX_DRIVE_STEPS)
        theta = found.theta
    return Fit(problem, found.best(1)).estimate()


def _plate(segment: Segment, log: PreparedLog, theta: Array) -> Array:
    """Plate angles of C drives, rad, shape (C, K, 2)."""
    assert segment.command is not None
    responses = [
        servo_response(segment.command, log.period, each, log.own_lag) for each in theta[:, 0]
    ]
    angle, rate = (np.stack(each) for each in zip(*responses, strict=True))
    # behind a gap the plate stands until the shaft has crossed it
    half, at = theta[:, 3:] / 2, np.zeros((len(theta), 2))
    followed = np.moveaxis(np.stack((angle - half[:, None], angle + half[:, None])), 2, 0)
    for low, high in followed:
        np.minimum(np.maximum(at, low, out=at), high, out=at)
        low[:] = at
    lead = theta[:, None, 1:3] * np.gradient(rate, log.period, axis=1)
    return np.asarray(np.moveaxis(followed[:, 0], 0, 1) - lead)


def _smooth(values: Array, period: float, count: float) -> Array:
    """The strongest smoothing that removes nothing but the encoder's own errors."""
    tried: list[tuple[float, Array]] = []
    for corner in CORNER_FREQUENCIES_HZ:
        if corner * period > 0.4 and tried:
            break
        b, a = butter(2, corner, fs=1 / period)
        pad = min(len(values) - 1, round(1.0 / (corner * period)))
        smooth = np.asarray(filtfilt(b, a, values, padlen=pad))
        # Share of white noise that the filter 1 / (1 + (f / corner)^4) lets pass.
        share = np.pi / np.sqrt(2) * corner * period
        tried.append((float(np.mean((values - smooth) ** 2)) / (1 - share) ** 2, smooth))
    floor = max(count**2 / 12, tried[-1][0])
    return next((smooth for misfit, smooth in tried if misfit <= 1.02 * floor), tried[-1][1])


def _delay_samples(values: Array, whole: int, part: float) -> Array:
    """Values a number of samples later, between two of them by a straight line."""
    held = np.concatenate((np.repeat(values[:1], whole + 1, axis=0), values))[: len(values) + 1]
    return (1 - part) * held[1:] + part * held[:-1]


def check_motion(log: PreparedLog) -> None:
    """Make sure that the ball rolls, and accelerates as the plate's angles say.

    Raises:
        LogError: If it hardly moves, or moves otherwise.
    """
    rolled = sum(
        log.period * float((speed(s.time, s.even_ball) > ROLL_SPEED_M_S).sum())
        for s in log.segments
    )
    if rolled < 5.0:
        raise LogError(
            f"{log.source}: too quiet: the ball rolls for {rolled:.1f} s of {log.length:.1f} s, "
            f"at least 5 s are needed; run the scenario {'line' if log.axes == 1 else 'excite'}"
        )
    for (ball, plate), gain in zip(COLUMNS_OF_AXIS, _gains(log), strict=True):
        if gain is not None and not 0.25 < gain < 4:
            raise LogError(
                f"{log.source}: {ball} accelerates {gain:.2g} times as much as {plate} explains: "
                "wrong sign or unit, or axes exchanged"
            )
    _check_command(log)


def _check_command(log: PreparedLog) -> None:
    """Make sure that the plate moves about as far as was commanded, by pieces without a drift."""
    over, under = np.zeros(2), np.zeros(2)
    for segment in log.segments:
        if segment.command is None:
            return
        response = servo_response(segment.command, log.period, log.own_lag)[0]
        both = _pieces(np.stack((response, segment.plate)), round(2.0 / log.period))
        commanded, moved = detrend(both, axis=-2)
        over += (commanded * moved).sum(axis=(0, 1))
        under += (commanded**2).sum(axis=(0, 1))
    for name, far, whole in zip(("phi", "theta"), over, under, strict=True):
        # a plate that hardly moves shows nothing
        if whole * log.period / log.length >= 1e-8 and not 0.4 < far / whole < 2.5:
            raise LogError(
                f"{log.source}: measured_{name} moves {far / whole:.2g} times as far as the "
                f"commanded applied_{name} columns say: wrong unit or sign, or exchanged axes"
            )


def _pieces(values: Array, rows: int) -> Array:
    """Signals of shape (..., K, 2) in whole pieces, shape (..., W, rows, 2)."""
    whole = values[..., : values.shape[-2] // rows * rows, :]
    return whole.reshape(*values.shape[:-2], -1, rows, 2)


def _gains(log: PreparedLog) -> Iterator[float | None]:
    """Acceleration of the ball over what the plate's angles explain, while it rolls, by axis.

    The integral form of the level model, x = x0 + v0 t + gain (k1 phi'' - b phi) - friction + level
    - dead time k1 phi', in pieces with an x0 and v0 each; two and one primes for integrals. A ball
    that rolls steadily is held by its tilt against friction and level: only what these and the dead
    time leave of the tilt tells the gain. None where that is less than the screen shows.
    """
    model, period, rows = log.model, log.period, round(1.0 / log.period)

    def integrate(values: Array) -> Array:
        return np.asarray(cumulative_trapezoid(values, dx=period, axis=-2, initial=0))

    products = np.zeros((2, 5, 5))
    for segment in log.segments:
        ball = segment.even_ball
        velocity = uniform_filter1d(np.gradient(ball, period, axis=0), 25, axis=0, mode="constant")
        way = velocity / np.maximum(np.hypot(*velocity.T), 1e-4)[:, None]
        rolls = (
            speed(segment.time, ball)[: len(ball) // rows * rows].reshape(-1, rows)
            >= ROLL_SPEED_M_S
        )
        if not rolls.all(axis=1).any():
            continue
        every = _pieces(np.stack((segment.plate * (1, -1), way, ball)), rows)
        angle, way, ball = every[:, rolls.all(axis=1)]
        gained = integrate(model.k1 * np.sin(angle))
        tilt = integrate(gained) - model.c2 * angle
        braked, level = (integrate(integrate(each)) for each in (way, np.ones_like(way)))
        columns = detrend(np.stack((braked, level, gained, tilt, ball)), axis=-2)
        products += np.einsum("iwra,jwra->aij", columns, columns)
    for each, sigma in zip(products, log.sigma, strict=True):
        others = np.linalg.lstsq(each[:3, :3], each[:3, 3:], rcond=1e-9)[0]
        left, shown = each[3, 3:] - each[3, :3] @ others
        noise = float(sigma) ** 2 * log.sample_period / period
        vague = each[3, 3] * period < MIN_TILT_WAY_M2_S or noise > MAX_GAIN_STD**2 * left
        yield None if vague else float(shown / left)


PLAY_SHAPES: dict[str, type[Play] | type[Hysteresis]] = {"flat": Play, "round": Hysteresis}
"""Corners of the loop, and the part of the twin that makes them."""
PLAY_KEYS = {"flat": "plant.servo.backlash_deg", "round": "plant.servo.hysteresis_deg"}
"""The scenario keys that take the width."""
CYCLE_POINTS = 400
"""Instants of a cycle that are compared."""
RULED_OUT_RATIO = 1.5
"""How many times as much one shape must leave as the other to be ruled out."""
NO_LOOP = 0.01
"""Width in deg up to which there is none: servos and wheels of a rig without any lose half of it at
1 deg/s."""


@dataclass(frozen=True, kw_only=True)
class LostMotion:
    """The loop of plate angle over motor angle of one axis. All in deg of the plate.

    Attributes:
        axis: ``phi`` or ``theta``.
        width: Of the loop along the motor's angle: twice what is lost to each side.
        spread: By how much the cycles differ, largest width less smallest.
        shape: Its corners: ``flat``, ``round``, ``either`` if both fit, or ``none``.
        left: Residual of the best loop of each shape, root mean square.
        gain: Plate angle per motor angle outside the loop, 1 where the cam table is right.
    """

    axis: str
    width: float
    spread: float
    shape: str
    left: dict[str, float]
    gain: float

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {**asdict(self), "key": PLAY_KEYS.get(self.shape), "verdict": self.words}

    @property
    def words(self) -> str:
        """The verdict in words."""
        if self.shape == "none":
            return f"no lost motion: the loop is {self.width:.3f} deg wide"
        corners = {
            "flat": "flat corners: play, or dry friction in the plate's joint; motor torque, which "
            "jumps at a reversal by friction alone, tells them apart",
            "round": "round corners: hysteresis of elastic parts",
            "either": "flat and round corners fit equally well",
        }[self.shape]
        known = f"{self.width:.3f} deg ({self.spread:.3f} between cycles)"
        return f"lost motion of {known}, {self.width / 2:.3f} to each side; {corners}"


def triangle(amplitude: float, rate: float, cycles: int, period: float) -> Array:
    """Angles of a triangle that begins at 0: a quarter of a cycle, then whole ones, shape (K,).

    Args:
        amplitude: Its largest angle, rad.
        rate: How fast, rad/s.
        cycles: Whole cycles.
        period: From one angle to the next, s.
    """
    length = 4 * amplitude / rate
    phase = np.arange(round((cycles + 0.25) * length / period) + 1) * period / length
    return amplitude * (4 * np.abs((phase - 0.25) % 1.0 - 0.5) - 1)


def as_plate(cams: CamTable, motor: Array, axis: int) -> Array:
    """Plate angles that motor angles of one axis mean while the other stands level, rad, (K,)."""
    line = np.zeros((len(cams.grid), 2))
    line[:, axis] = cams.grid
    return np.interp(motor, cams.motor(line)[:, axis], cams.grid)


def lost_motion(axis: str, motor: Array, plate: Array, cycles: int) -> LostMotion:
    """The loop of a few cycles of a triangle.

    Args:
        axis: Which.
        motor: Motor angle as plate angle, by the cam table, in rad, evenly in time over a quarter
            of a cycle and then whole ones, shape (K,).
        plate: Angle of the plate's encoder in rad, shape (K,).
        cycles: Whole cycles, 2 or more: the first closes the loop and is left out.

    Raises:
        LogError: If the motor or the plate did not move.
    """
    every = max(1, round(len(motor) / (cycles + 0.25) / CYCLE_POINTS))
    s, p = np.degrees(motor[::every]), np.degrees(plate[::every])
    travel = float(np.ptp(s))
    if min(travel, float(np.ptp(p))) < NO_LOOP:
        raise LogError(f"{axis}: motor moved {travel:.4f} deg, plate {np.ptp(p):.4f} deg: too few")
    ends = np.linspace(len(s) * 0.25 / (cycles + 0.25), len(s), cycles + 1).round().astype(int)
    closed = ends[1]
    found = {
        shape: _best_loop(shape, s[closed:], p[closed:], s[:closed], travel)
        for shape in PLAY_SHAPES
    }
    left = {shape: each[1] for shape, each in found.items()}
    ahead = min(left, key=lambda shape: left[shape])
    width, _, gain = found[ahead]
    own = [
        _best_loop(ahead, s[start:end], p[start:end], s[:start], travel)[0]
        for start, end in pairwise(ends[1:])
    ]
    shape = ahead if max(left.values()) > RULED_OUT_RATIO * left[ahead] else "either"
    return LostMotion(
        axis=axis,
        width=width,
        spread=float(np.ptp(own)),
        shape=shape if width > NO_LOOP else "none",
        left=left,
        gain=gain,
    )


def _best_loop(
    shape: str, s: Array, p: Array, before: Array, travel: float
) -> tuple[float, float, float]:
    """Width in deg, residual in deg rms, and gain, by three ever finer grids."""
    middle, reach = travel / 4, travel / 4
    for _ in range(3):
        widths = np.clip(np.linspace(middle - reach, middle + reach, 41), 0, None)
        left, gains = _left_by(shape, widths, s, p, before)
        at = int(left.argmin())
        middle, reach = float(widths[at]), reach / 15
    return middle, float(left[at]), float(gains[at])


def _left_by(shape: str, widths: Array, s: Array, p: Array, before: Array) -> tuple[Array, Array]:
    """Residuals of loops of some widths, in deg rms, and their gains, shapes (widths,).

    Offset and gain are fitted. What was before brings the loop to where it is.
    """
    part = PLAY_SHAPES[shape](widths[:, None])
    turns = np.diff(np.concatenate((before, s)), prepend=before[0])
    moved = np.cumsum([part.follow(np.full((1, 2), turn))[:, 0] for turn in turns], axis=0)
    followed = np.where(part.acts[:, 0], moved, np.cumsum(turns)[:, None])[len(before) :]
    followed = followed - followed.mean(axis=0)
    measured = (p - p.mean())[:, None]
    gains = (followed * measured).sum(axis=0) / np.maximum((followed**2).sum(axis=0), 1e-12)
    return np.sqrt(((measured - gains * followed) ** 2).mean(axis=0)), gains
