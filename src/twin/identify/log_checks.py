"""Refuses logs whose numbers cannot mean what their columns say: wrong units, signs, axes."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from controllers.arrays import Array
from twin.errors import LogError
from twin.hal.interface import SCREEN
from twin.identify.log import Log
from twin.identify.plate_motion import servo_response
from twin.identify.prepare import ROLL, PreparedLog, speed

STEEPEST = 0.26
"""Largest plate angle in rad that any such rig reaches; the thesis's stops at 10 deg."""
COLUMNS_OF_AXIS = (("measured_x", "measured_phi"), ("measured_y", "measured_theta"))


def check_ranges(log: Log) -> None:
    """Make sure that no number is beyond what the rig can do.

    Raises:
        LogError: Naming the column, and the unit its numbers look like.
    """
    touched = log.touched & np.isfinite(log.ball).all(axis=-1)
    if not touched.any():
        raise LogError(f"{log.source}: the screen never detected the ball")
    for axis, (ball, plate) in enumerate(COLUMNS_OF_AXIS):
        edge = SCREEN[axis] / 2
        far = float(np.percentile(np.abs(log.ball[touched, axis]), 99))
        if far > 1.05 * edge:
            guess = "another unit"
            if 4 * edge < far <= 100 * edge:
                guess = "centimetres"
            elif 100 * edge < far <= 1100 * edge:
                guess = "millimetres"
            raise LogError(
                f"{log.source}: {ball}: reaches {far:.3g} where the screen ends at {edge:g} m; "
                f"{guess}? Give m, or the unit in the header"
            )
        steep = float(np.nanpercentile(np.abs(log.plate[:, axis]), 99))
        if steep > STEEPEST:
            raise LogError(
                f"{log.source}: {plate}: reaches {steep:.3g} rad, which no such plate does; "
                f"degrees? Give rad, or the unit in the header"
            )


def check_motion(log: PreparedLog) -> None:
    """Make sure that the ball rolls, and accelerates as the plate's angles say.

    Raises:
        LogError: If it hardly moves, or moves otherwise.
    """
    rolled = sum(
        log.period * float((speed(s.time, s.even_ball) > ROLL).sum()) for s in log.segments
    )
    if rolled < 5.0:
        raise LogError(
            f"{log.source}: too quiet: the ball rolls for {rolled:.1f} s of {log.length:.1f} s, "
            "at least 5 s are needed; run the scenario excite"
        )
    for axis, (ball, plate) in enumerate(COLUMNS_OF_AXIS):
        gain = _gain(log, axis)
        if gain is None or 0.25 < gain < 4:
            continue
        if -4 < gain < -0.25:
            raise LogError(
                f"{log.source}: {ball} accelerates against {plate}: one of them has the wrong sign"
            )
        raise LogError(
            f"{log.source}: {ball} accelerates {gain:.2g} times as much as {plate} explains: "
            "wrong unit, or axes exchanged"
        )
    _check_command(log)


def _check_command(log: PreparedLog) -> None:
    for axis, name in enumerate(("phi", "theta")):
        over, under = 0.0, 0.0
        for segment in log.segments:
            if segment.command is None:
                return
            response = servo_response(segment.command, log.period, log.own_lag)[0][:, axis]
            for a, b in _chunks(response, segment.plate[:, axis], log.period):
                over, under = over + float(a @ b), under + float(a @ a)
        # a plate that hardly moves says nothing
        if under * log.period / log.length < 1e-8:
            continue
        gain = over / under
        if not 0.4 < gain < 2.5:
            raise LogError(
                f"{log.source}: measured_{name} moves {gain:.2g} times as far as the commanded "
                f"applied_{name} columns say: wrong unit or sign, or exchanged axes"
            )


def _chunks(first: Array, second: Array, period: float) -> list[tuple[Array, Array]]:
    """Pieces of 2 s of two signals without their straight-line parts."""
    rows = round(2.0 / period)
    base, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, rows), 2))
    pieces: list[tuple[Array, Array]] = []
    for k in range(len(first) // rows):
        part = slice(k * rows, (k + 1) * rows)
        a, b = first[part], second[part]
        pieces.append((a - base @ (base.T @ a), b - base @ (base.T @ b)))
    return pieces


def _gain(log: PreparedLog, axis: int) -> float | None:
    """Acceleration of the ball over what the plate's angle explains, while it rolls.

    The integral form of the level model: x = x0 + v0 t + gain (k1 phi'' - b phi) - friction.
    """
    model, period = log.model, log.period
    rows = round(1.0 / period)
    line = np.vander(np.linspace(-1, 1, rows), 2)
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for segment in log.segments:
        ball = segment.even_ball
        velocity = np.gradient(ball, period, axis=0)
        smooth = np.stack([np.convolve(v, np.ones(25) / 25, "same") for v in velocity.T], axis=-1)
        rate = speed(segment.time, ball)
        for k in range(len(ball) // rows):
            part = slice(k * rows, (k + 1) * rows)
            if rate[part].min() < ROLL:
                continue
            angle = segment.plate[part, axis] * (1 if axis == 0 else -1)
            tilt = model.k1 * _double_integral(np.sin(angle), period) - model.c2 * angle
            direction = smooth[part, axis] / np.maximum(np.hypot(*smooth[part].T), 1e-4)
            drag = _double_integral(direction, period)
            columns = np.stack((tilt, drag, ball[part, axis]), axis=-1)
            columns -= line @ np.linalg.lstsq(line, columns, rcond=None)[0]
            normal += columns[:, :2].T @ columns[:, :2]
            right += columns[:, :2].T @ columns[:, 2]
    if normal[0, 0] * period < 1e-6 or np.linalg.cond(normal) > 1e8:
        return None
    return float(np.linalg.solve(normal, right)[0])


def _double_integral(values: Array, period: float) -> Array:
    """From zero, by the trapezoidal rule."""
    once = cumulative_trapezoid(values, dx=period, initial=0)
    return np.asarray(cumulative_trapezoid(once, dx=period, initial=0))
