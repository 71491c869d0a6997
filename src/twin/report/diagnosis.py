"""What a record shows of why a run went as it did: timing, limits, contact, spectrum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.run.finished import Run, columns
from twin.run.metrics import Motion

LONGEST_LAG = 1.5
"""Seconds up to which a lag behind the reference is looked for."""
COARSE, FINE = 0.025, 0.005
"""Steps in s in which it is looked for, first everywhere and then about the best."""
CUT = 0.01
"""Difference of requested and applied acceleration in rad/s^2 that counts as cut by a limit."""
REST = 1.0
"""Seconds without motion at the end of a run after which a ball rests."""
STILL = 0.1e-3
"""Motion in m within that time that is none."""
AWAY = 1e-3
"""Distance in m from its reference at which a resting ball is stuck."""


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Facts of one run from ``metrics.start`` on; lengths in m, times in s, shares 0..1.

    Attributes:
        rms: Root mean square distance of ball and reference.
        lag: Delay of the reference at which, scaled, it fits the ball best; None if it rests, or
            no delay fits.
        gain: The scale about the plate's centre: below 1 the path is smaller; None without a lag.
        rest: Root mean square distance from the reference so delayed and scaled; None likewise.
        estimation: Root mean square error of the estimated position; None if the truth is unknown.
        cut: Share of time in which a limit reduced the control effort; None if not recorded.
        angle: Largest plate angle over its limit.
        lifted: Share of time in which a wheel had no contact; None if not recorded.
        untouched: Share of time in which the screen detected nothing.
        stuck: Distance at which a resting ball ended from a resting reference; None if either
            moved, or the ball is where it should be.
        tilt: Tilt of the plate then, rad.
        held: Share of the whole run in which friction held the ball at rest; None if unknown.
    """

    rms: float
    lag: float | None
    gain: float | None
    rest: float | None
    estimation: float | None
    cut: float | None
    angle: float
    lifted: float | None
    untouched: float
    stuck: float | None
    tilt: float
    held: float | None

    @classmethod
    def of(cls, run: Run) -> Diagnosis:
        """Look through a run's record."""
        motion, rows = run.motion, run.rows
        end = min(motion.time[-1], run.metrics.get("outcome_time") or motion.time[-1])
        begin = run.scenario.metrics.start if run.scenario.metrics.start < end else 0.0
        late = (motion.time >= begin - 1e-9) & (motion.time <= end + 1e-9)
        time, ball = motion.time[late], motion.ball[late]
        lag, gain, rest = _timing(run, time, ball)
        estimation = None
        if "true_x" in rows:
            seen = columns(rows, "estimated")[late, 0::4]
            estimation = _rms(seen - ball)
        requested, applied = _accelerations(rows, "requested"), _accelerations(rows, "applied")
        wheels = [rows[name] for name in ("wheel_phi_N", "wheel_theta_N") if name in rows]
        touched = rows.get("touched", np.ones_like(motion.time))
        return cls(
            rms=_rms(motion.error[late]),
            lag=lag,
            gain=gain,
            rest=rest,
            estimation=estimation,
            cut=None
            if np.isnan(requested).all()
            else float((np.abs(requested - applied) > CUT).any(axis=1).mean()),
            angle=float(np.abs(motion.plate).max() / run.limits.angle),
            lifted=float((np.min(wheels, axis=0) <= 0).mean()) if wheels else None,
            untouched=float((touched < 0.5).mean()),
            stuck=_stuck(motion),
            tilt=float(np.hypot(*motion.plate[-1])),
            held=None if motion.held is None else float(motion.held.mean()),
        )


def _stuck(motion: Motion) -> float | None:
    """How far from its resting reference the ball lay still at the end of a run."""
    last = motion.time >= motion.time[-1] - REST
    moved = max(np.ptp(where[last], axis=0).max() for where in (motion.ball, motion.reference))
    away = float(np.hypot(*motion.error[-1]))
    return away if moved < STILL and away > AWAY and motion.time[-1] >= REST else None


def _timing(run: Run, time: Array, ball: Array) -> tuple[float | None, float | None, float | None]:
    """Delay and scale of the reference that fit the ball best, and the error that is left.

    Nothing if the best delay is the longest of those tried, up to half the time that is judged.
    """
    reference = run.followed
    if len(time) < 10 or np.ptp(reference(time)[0], axis=0).max() < 1e-3:
        return None, None, None
    some = slice(None, None, max(1, len(time) // 2000))
    time, ball = time[some], ball[some]

    def fit(delay: float, every: int = 1) -> tuple[float, float]:
        desired = reference(np.maximum(time[::every] - delay, 0.0))[0]
        gain = float((desired * ball[::every]).sum() / max((desired**2).sum(), 1e-12))
        return gain, _rms(gain * desired - ball[::every])

    coarse = np.arange(-0.2, min(LONGEST_LAG, float(np.ptp(time)) / 2), COARSE)
    every = max(1, len(time) // 400)
    best = coarse[int(np.argmin([fit(delay, every)[1] for delay in coarse]))]
    if best == coarse[-1]:
        return None, None, None
    fine = best + np.arange(-COARSE, 1.5 * COARSE, FINE)
    squares = np.array([fit(delay)[1] ** 2 for delay in fine])
    i = int(np.clip(np.argmin(squares), 1, len(fine) - 2))
    before, least, after = squares[i - 1 : i + 2]
    bend = before - 2 * least + after  # of the parabola through the three: its vertex is the lag
    lag = float(fine[i] + FINE * (0.5 * (before - after) / bend if bend > 0 else 0.0))
    return lag, *fit(lag)


def spectrum(run: Run) -> tuple[Array, Array]:
    """Amplitude of the tracking error over frequency: Hz (F,), m (F, 2) for x and y.

    A Hann window from ``metrics.start`` on, scaled so that a sine of amplitude a reads a.
    """
    motion = run.motion
    late = motion.time >= run.scenario.metrics.start - 1e-9
    error = motion.error[late] if late.sum() >= 8 else motion.error
    window = np.hanning(len(error))
    weight = 2 / max(window.sum(), 1e-12)
    level = error - error.mean(axis=0)
    amplitude: Array = weight * np.abs(np.fft.rfft(window[:, None] * level, axis=0))
    period = float(np.median(np.diff(motion.time))) if len(motion.time) > 1 else 1.0
    return np.fft.rfftfreq(len(error), period), amplitude


def _accelerations(rows: Mapping[str, Array], kind: str) -> Array:
    return np.stack([rows[f"{kind}_{axis}_acc"] for axis in ("phi", "theta")], axis=1)


def _rms(error: Array) -> float:
    return float(np.sqrt((error**2).sum(axis=-1).mean()))
