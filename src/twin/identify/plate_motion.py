"""The plate's motion in a log, and how far its drives lag behind their commands.

The motion is the servos' response to the command, corrected by the encoders.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, filtfilt, lfilter

from controllers.arrays import Array
from twin.identify.bootstrap import Estimate, estimate
from twin.identify.parameters import SERVO
from twin.identify.prepare import PreparedLog, Segment, resolution
from twin.sim.rig import Play

CORNERS = (0.8, 1.5, 3.0, 6.0, 12.0, 25.0)
"""Corner frequencies in Hz; the data choose how much of the encoders to believe."""
CHUNK = 1.0
"""Length in s of the pieces from which a parabola is taken, for disturbances drift the plate."""


PLAYS = np.radians((0.0, 0.03, 0.1, 0.3))
"""Play in rad from which a fit of the drives begins."""
STEPS = 8
"""Steps of such a fit."""
DIFFERENCES = np.array((1e-4, 1e-5, 1e-5, 1e-5))
"""Steps of its finite differences: lag in s, elasticity of both axes in s^2, play in rad."""
MOST = np.array((SERVO.most, 1e-3, 1e-3, 0.035))
"""Largest values of these."""


class Drives(NamedTuple):
    """How the drives follow.

    Attributes:
        lag: Time constant, s.
        half_width: Of its 95 % interval, s; infinite where the data say nothing.
        agree: Whether angles and rates of the plate give the same; the interval holds both.
        play: What the plate loses at a reversal, rad.
        play_half_width: Of its interval.
    """

    lag: float
    half_width: float
    agree: bool
    play: float
    play_half_width: float


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


def fit_drives(log: PreparedLog) -> Drives | None:
    """How the drives follow their commands; None if these were not recorded.

    What else lies between motor and plate shows in the same band and is fitted along: elasticity,
    which lets the plate of either axis lead by its acceleration over the square of the resonance,
    and play. What is fitted to the angles is then fitted to their rates, which see higher
    frequencies: where the model is right, both give one lag.
    """
    rows = round(CHUNK / log.period)
    segments = [s for s in log.segments if s.command is not None and len(s.time) >= rows]
    if not segments:
        return None
    guesses = np.array([(0.02, 0.0, 0.0, play) for play in PLAYS])
    angle = _fitted(log, segments, guesses, 0)
    rate = _fitted(log, segments, angle.value[None], 1)
    half, other = float(angle.half_width[0]), float(rate.half_width[0])
    apart = abs(float(angle.value[0] - rate.value[0]))
    agree = not apart > np.hypot(half, other)
    return Drives(
        lag=float(angle.value[0]),
        half_width=half if agree else apart + other,
        agree=agree,
        play=float(angle.value[3]),
        play_half_width=float(angle.half_width[3]),
    )


def _fitted(log: PreparedLog, segments: list[Segment], theta: Array, order: int) -> Estimate:
    """Lag in s, elasticity of both axes in s^2, play in rad: the best from C guesses, (C, 4).

    Damped Gauss-Newton steps. Squares of pieces that do not follow at all (a wheel off its cam)
    must not decide.

    Args:
        log: What was recorded.
        segments: Parts of it with commands.
        theta: The guesses.
        order: Of the differences that are compared: 0 for angles, 1 for rates.
    """
    rows = round(CHUNK / log.period)
    base, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, rows - order), 3))

    def pieces(values: list[Array]) -> Array:
        """Pieces of ``CHUNK`` without their parabola, shape (..., W, rows, 2)."""
        cut = [
            v[..., : v.shape[-2] // rows * rows, :].reshape(*v.shape[:-2], -1, rows, 2)
            for v in values
        ]
        each = np.diff(np.concatenate(cut, axis=-3), n=order, axis=-2)
        return np.asarray(each - base @ (base.T @ each))

    measured = pieces([segment.plate for segment in segments])

    def linearised(theta: Array) -> tuple[Array, Array, Array]:
        """Residuals (C, W, M), slopes (C, W, M, 4), and mean squares (C, W)."""
        moved = np.concatenate((theta[None], theta + np.diag(DIFFERENCES)[:, None]))
        modelled = pieces([_plate(s, log, moved.reshape(-1, 4)) for s in segments])
        modelled = modelled.reshape(5, len(theta), len(measured), -1)
        r = modelled[0] - measured.reshape(len(measured), -1)
        slopes = (modelled[1:] - modelled[0]) / DIFFERENCES[:, None, None, None]
        return r, np.moveaxis(slopes, 0, -1), (r**2).mean(axis=-1)

    r, J, square = linearised(theta)  # noqa: N806
    damping = np.full(len(theta), 1e-3)
    for _ in range(STEPS):
        usual = max(3 * float(np.median(square.min(axis=0))), 1e-30)
        weight = 1 / (1 + square / usual)
        information = np.einsum("cwmi,cwmj,cw->cwij", J, J, weight)
        score = np.einsum("cwmi,cwm,cw->cwi", J, r, weight)
        normal = information.sum(axis=1)
        scale = np.diagonal(normal, axis1=-2, axis2=-1)[..., None] * np.eye(4)
        damped = normal + damping[:, None, None] * scale + 1e-300 * np.eye(4)
        step = np.linalg.solve(damped, score.sum(axis=1)[..., None])[..., 0]
        trial = np.clip(theta - step, 0.0, MOST)
        found = linearised(trial)
        better = np.log1p(found[2] / usual).sum(axis=1) < np.log1p(square / usual).sum(axis=1)
        theta = np.where(better[:, None], trial, theta)
        r, J, square = (  # noqa: N806
            np.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
            for new, old in zip(found, (r, J, square), strict=True)
        )
        damping = np.where(better, damping / 10, damping * 10)
    best = int(np.log1p(square / usual).sum(axis=1).argmin())
    return estimate(theta[best], information[best], score[best])


def _plate(segment: Segment, log: PreparedLog, theta: Array) -> Array:
    """Plate angles of C drives, rad, shape (C, K, 2)."""
    assert segment.command is not None
    responses = [
        servo_response(segment.command, log.period, each, log.own_lag) for each in theta[:, 0]
    ]
    angle, rate = (np.stack(each) for each in zip(*responses, strict=True))
    part = Play(theta[:, 3:])
    turns = np.diff(angle, axis=1, prepend=0.0)
    followed = np.cumsum([part.follow(turn) for turn in np.moveaxis(turns, 1, 0)], axis=0)
    lead = theta[:, None, 1:3] * np.gradient(rate, log.period, axis=1)
    return np.asarray(np.moveaxis(followed, 0, 1) - lead)


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
