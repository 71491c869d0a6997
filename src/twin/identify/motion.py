"""The plate's motion in a log: the servos' answer to the command, corrected by the encoders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, filtfilt, lfilter

from controllers.arrays import Array

CORNERS = (0.8, 1.5, 3.0, 6.0, 12.0, 25.0)
"""Corner frequencies in Hz; the data choose how much of the encoders to believe."""


@dataclass(frozen=True)
class Motion:
    """Angles and rates of the plate at equal times.

    Attributes:
        time: Seconds, shape (K,).
        angle: phi and theta in rad, shape (K, 2).
        rate: Their rates in rad/s, shape (K, 2).
    """

    time: Array
    angle: Array
    rate: Array


def servo(command: Array, period: float, lag: float, shift: float = 0.0) -> tuple[Array, Array]:
    """Plate angles and rates of a first-order rate servo, from zero, both shape (K, 2).

    Solves lag * rate' = command - rate exactly for commands held over each period.

    Args:
        command: Commanded plate rates in rad/s from each instant on, shape (K, 2).
        period: Time between them in s.
        lag: Time constant in s.
        shift: Time in s by which all of it comes later.
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
    return _later(angle, int(whole), part), _later(rate, int(whole), part)


def plate_motion(
    time: Array,
    measured: Array,
    command: Array | None = None,
    lag: float = 0.0,
    shift: float = 0.0,
) -> Motion:
    """Estimate what the plate did from encoders and, where it was recorded, the command.

    What the encoders say beyond the servos' answer is smoothed by a zero-phase second-order
    Butterworth filter: the optimal (Rauch-Tung-Striebel) smoother where disturbances are white
    accelerations and encoder errors white.

    Args:
        time: Equally spaced seconds, shape (K,).
        measured: Encoder angles in rad, shape (K, 2).
        command: Commanded plate rates in rad/s, shape (K, 2).
        lag: Time constant of the servos in s.
        shift: What they come later besides, in s.
    """
    period = float(time[1] - time[0])
    angle, rate = np.zeros_like(measured), np.zeros_like(measured)
    if command is not None:
        angle, rate = servo(command, period, lag, shift)
    rest = measured - angle
    smooth = np.stack(
        [_smooth(rest[:, axis], period, resolution(measured[:, axis])) for axis in (0, 1)], axis=-1
    )
    return Motion(time, angle + smooth, rate + np.gradient(smooth, period, axis=0))


def resolution(measured: Array) -> float:
    """Smallest step between two different readings, 0 if there is none."""
    steps = np.diff(np.unique(measured))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if len(steps) else 0.0


def _smooth(values: Array, period: float, count: float) -> Array:
    """The strongest smoothing that leaves over nothing but the encoder's own errors."""
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


def _later(values: Array, whole: int, part: float) -> Array:
    """Values a number of samples later, between two of them by a straight line."""
    held = np.concatenate((np.repeat(values[:1], whole + 1, axis=0), values))[: len(values) + 1]
    return (1 - part) * held[1:] + part * held[:-1]
