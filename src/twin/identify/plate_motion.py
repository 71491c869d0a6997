"""The plate's motion in a log, and how far its drives lag behind their commands.

The motion is the servos' response to the command, corrected by the encoders.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, filtfilt, lfilter

from controllers.arrays import Array
from twin.identify.bootstrap import Estimate, estimate
from twin.identify.parameters import SERVO
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.samples import resolution

CORNERS = (0.8, 1.5, 3.0, 6.0, 12.0, 25.0)
"""Corner frequencies in Hz; the data choose how much of the encoders to believe."""
CHUNK = 1.0
"""Length in s of the pieces from which a parabola is taken, for disturbances drift the plate."""


@dataclass(frozen=True)
class PlateMotion:
    """Angles and rates of the plate at equal times.

    Attributes:
        time: Seconds, shape (K,).
        angle: phi and theta in rad, shape (K, 2).
        rate: Their rates in rad/s, shape (K, 2).
    """

    time: Array
    angle: Array
    rate: Array


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
    return _delayed(angle, int(whole), part), _delayed(rate, int(whole), part)


def plate_motion(segment: Segment, lag: float, shift: float) -> PlateMotion:
    """Estimate what the plate did from encoders and, where it was recorded, the command.

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
    return PlateMotion(segment.time, angle + smooth, rate + np.gradient(smooth, period, axis=0))


def fit_lag(log: PreparedLog) -> Estimate | None:
    """Time constant in s of the drives; None if the command was not recorded."""
    rows = round(CHUNK / log.period)
    parabola, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, rows), 3))
    recorded = [
        (s.command, s.plate) for s in log.segments if s.command is not None and len(s.time) >= rows
    ]
    if not recorded:
        return None

    def pieces(values: Array) -> Array:
        """Pieces of ``CHUNK`` without their parabola, shape (W, rows, 2)."""
        cut = values[: len(values) // rows * rows].reshape(-1, rows, 2)
        return np.asarray(cut - parabola @ (parabola.T @ cut))

    measured = np.concatenate([pieces(plate) for _, plate in recorded])

    def residual(lag: float) -> Array:
        angles = [
            servo_response(command, log.period, lag, log.own_lag)[0] for command, _ in recorded
        ]
        left: Array = measured - np.concatenate([pieces(angle) for angle in angles])
        return left

    # Squares of pieces that do not follow at all (a wheel off its cam) must not decide.
    usual = float(np.median((residual(0.02) ** 2).mean(axis=(1, 2))))

    def cost(lag: float) -> float:
        square = (residual(lag) ** 2).mean(axis=(1, 2))
        return float(np.log1p(square / (3 * usual)).sum())

    lag = float(minimize_scalar(cost, bounds=(0, SERVO.most), options={"xatol": 1e-6}).x)
    step = 1e-4
    r = residual(lag)
    J = (residual(lag + step) - r) / step  # noqa: N806
    weight = 1 / (1 + (r**2).mean(axis=(1, 2)) / (3 * usual))
    information = weight * (J**2).sum(axis=(1, 2))
    score = weight * (J * r).sum(axis=(1, 2))
    return estimate(np.array([lag]), information[:, None, None], score[:, None])


def _smooth(values: Array, period: float, count: float) -> Array:
    """The strongest smoothing that removes nothing but the encoder's own errors."""
    tried: list[tuple[float, Array]] = []
    for corner in CORNERS:
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


def _delayed(values: Array, whole: int, part: float) -> Array:
    """Values a number of samples later, between two of them by a straight line."""
    held = np.concatenate((np.repeat(values[:1], whole + 1, axis=0), values))[: len(values) + 1]
    return (1 - part) * held[1:] + part * held[:-1]
