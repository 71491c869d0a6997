"""Evidence of the plate's angle on the drives: lag, lost motion, and what the cams make of it.

Beyond the servos' response to the command, the plate's angle is a doubly integrated white
disturbance seen by noisy encoders. A Kalman filter's innovations of it are white, and what a
parameter would add to the angle is whitened by the same filter: then least squares is likelihood.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter, ss2tf

from controllers.arrays import Array
from twin.base.settings import from_scenarios
from twin.identify.plate_motion import servo_response
from twin.identify.prepare import PreparedLog, Segment
from twin.run.plants import parts_of
from twin.shadow.belief import DRIVE_BELIEFS, TWIN_ERROR_STD, Belief
from twin.shadow.evidence import (
    NO_EVIDENCE,
    PLATE_WINDOW_S,
    Evidence,
    without_gaps,
    without_rest,
)
from twin.sim.calibration import MECHANISM_STATES, linear_mechanism
from twin.sim.drives import DriveModel

FILTER_SETTLE_S = 1.0
"""Seconds after which the filter has forgotten where it began."""
INNOVATIONS_PER_SAMPLE = 4.0
"""Innovations that count as one: a slow plate stays on one count of its encoder for a while."""
LAG_DIFFERENCE = 0.005
"""Step of the difference by the time constant, s."""
MIN_PLATE_RANGE_STDS = 40.0
"""Range of the plate's angle in a window, in standard deviations of its encoder, below which it
tells nothing: the readings then stay on a few counts."""
MAX_LINEAR_TILT_RAD = np.radians(5.0)
"""Tilt in rad up to which the mechanism is linear to within what the transmission may differ by
from window to window: tilt^2 / 2 is below 0.004."""
PLAY_WIDTHS_RAD = (np.radians(0.05), np.radians(0.2))
"""Widths in rad of a narrow and of a wide gap."""
PLAY_ERROR_RAD = TWIN_ERROR_STD["narrow_play"] * PLAY_WIDTHS_RAD[0]
"""Standard deviation in rad of what the width of an identified gap is wrong by."""


def plate_evidence(
    log: PreparedLog, belief: Belief, gaps: Array, since: float = -np.inf
) -> Evidence:
    """Evidence of ``DRIVES``; none if no part of the log is long enough.

    Args:
        log: What was recorded.
        belief: The twin.
        gaps: Of the log; where one is still felt there is no evidence.
        since: When the first window begins, s, where the log goes back further.
    """
    parts = (_plate_of(segment, log.period, belief, since) for segment in log.segments)
    return without_gaps(parts, gaps, FILTER_SETTLE_S)


def _plate_of(segment: Segment, period: float, belief: Belief, since: float) -> Evidence:
    rows = round(PLATE_WINDOW_S / period)
    skipped = round(max(FILTER_SETTLE_S, since - segment.time[0]) / period)
    count = (len(segment.time) - skipped) // rows
    if count < 1 or segment.command is None:
        return NO_EVIDENCE
    angle, *slopes = plate_slopes(segment.command, period, belief)
    size = len(slopes)
    information, score = np.zeros((count, size, size)), np.zeros((count, size))
    tilted = np.abs(segment.plate[skipped : skipped + count * rows]).reshape(count, -1).max(axis=1)
    for axis in (0, 1):
        both = np.stack((segment.plate - angle, *slopes))[..., axis]
        used = slice(skipped, skipped + count * rows)
        white = whiten(both, period, belief.disturbance[axis], belief.encoders[axis])[:, used]
        moved = np.ptp(segment.plate[used, axis].reshape(count, rows), axis=1)
        counted = moved > MIN_PLATE_RANGE_STDS * np.sqrt(belief.encoders[axis])
        counted &= tilted < MAX_LINEAR_TILT_RAD
        e, J = white[0].reshape(count, rows), white[1:].reshape(size, count, rows)  # noqa: N806
        J = J * counted[:, None]  # noqa: N806
        information += np.einsum("iwk,jwk->wij", J, J) / INNOVATIONS_PER_SAMPLE
        score += np.einsum("iwk,wk->wi", J, e) / INNOVATIONS_PER_SAMPLE
    begin = segment.time[skipped] + PLATE_WINDOW_S * np.arange(count)
    spans = np.stack((begin, begin + PLATE_WINDOW_S), axis=-1)
    return Evidence.of(DRIVE_BELIEFS, spans, *without_rest(information, score, len(DRIVE_BELIEFS)))


def plate_slopes(command: Array, period: float, belief: Belief) -> list[Array]:
    """The plate's angles, their slopes by ``DRIVE_BELIEFS``, and what a wrong gap adds, (K, 2).

    What a plate behind a gap does at a reversal is not linear in the gap's width: where it moves
    slowly, the slopes over a narrow and a wide gap miss what an error of the width s does, and a
    lag makes up for it. With the changes g+ and g- of the angles by a gap wider and narrower by
    the standard deviation of s, the covariance of what the error adds is (g+ g+' + g- g-') / 2
    (unscented transform). This is the covariance of g+ / sqrt(2) and g- / sqrt(2), each times a
    standard normal number; these two are the last, in rad.

    Args:
        command: Plate rates in rad/s from each row on, shape (K, 2).
        period: Seconds between rows.
        belief: The twin.
    """
    lag, play = belief.lag, belief.play
    wider = (*PLAY_WIDTHS_RAD, PLAY_ERROR_RAD, -PLAY_ERROR_RAD)
    drives = [(lag + LAG_DIFFERENCE, play), *((lag, max(0.0, play + more)) for more in wider)]
    angle, *others = plate_angles(command, period, belief, (lag, play), *drives)
    late, narrow, wide, *errors = (each - angle for each in others)
    return [angle, late / LAG_DIFFERENCE, narrow, wide, angle, *(g / np.sqrt(2) for g in errors)]


def whiten(signals: Array, period: float, disturbance: float, encoder: float) -> Array:
    """Innovations of the steady Kalman filter in their standard deviations, shape (..., K).

    Args:
        signals: Angles in rad, shape (..., K).
        period: Seconds between them.
        disturbance: Variance of the acceleration of a period, (rad/s^2)^2.
        encoder: Variance of a reading, rad^2.
    """
    F = np.array([[1.0, period], [0.0, 1.0]])  # noqa: N806
    g = np.array([[period**2 / 2], [period]])
    h = np.array([[1.0, 0.0]])
    # without any disturbance or noise there is no filter: a thousandth of Table B.1 stands for none
    q, r = max(disturbance, 1e-7), max(encoder, 1e-12)
    P = solve_discrete_are(F.T, h.T, q * g @ g.T, np.array([[r]]))  # noqa: N806
    variance = float((h @ P @ h.T)[0, 0]) + r
    gain = F @ P @ h.T / variance
    out = lfilter(np.poly(F), np.poly(F - gain @ h), signals, axis=-1)
    return np.asarray(out / np.sqrt(variance))


def plate_angles(
    command: Array, period: float, belief: Belief, *drives: tuple[float, float]
) -> list[Array]:
    """The plate's angles as drives make them of commands, from rest at zero, rad, (K, 2) each.

    Args:
        command: Plate rates in rad/s from each row on, shape (K, 2).
        period: Seconds between rows.
        belief: The twin.
        drives: Time constants in s and widths of the gap in rad.
    """
    servo = from_scenarios(DriveModel, [belief.scenario]).servo(period)
    if servo.acts.any():
        turns = [servo.follow(turn) for turn in period * command[:, None]]
        command = np.concatenate(turns) / period
    shafts = [belief.turned * servo_response(command, period, lag)[0] for lag, _ in drives]
    behind = [_with_play(shaft, play) for shaft, (_, play) in zip(shafts, drives, strict=True)]
    if belief.scenario.plant.kind != "mujoco":
        whole, part = divmod(belief.own_lag / period, 1.0)
        delay = np.concatenate((np.zeros(int(whole)), [1 - part, part]))
        return [lfilter(delay, [1.0], angle, axis=0) for angle in behind]
    filters = _mechanism(belief, period)
    rates = [np.diff(angle, axis=0, append=angle[-1:]) / period for angle in behind]
    return [
        np.stack([lfilter(*filters[axis], rate[:, axis]) for axis in (0, 1)], axis=-1)
        for rate in rates
    ]


def _mechanism(belief: Belief, period: float) -> list[tuple[Array, Array]]:
    """Numerators and denominators from rates of the shafts to angles of the plate, phi and theta.

    The mechanism about its level rest: servos that turn motors, a plate that swings on its wheels.
    A law that moves the plate a few times a second makes it swing farther than its shafts turn.
    """
    plant = belief.scenario.plant
    # what a ball off its middle or oval does to the plate is left out
    parts = replace(parts_of(belief.scenario), offset=None, oval=None)
    steps = max(1, round(period / plant.step))
    A, B, _, ratio = linear_mechanism(parts, period / steps)  # noqa: N806
    B = ratio * B  # noqa: N806
    found = []
    for axis, name in enumerate(("phi", "theta")):
        own = (name, f"{name}_rate", f"motor_{name}", f"motor_{name}_rate", f"servo_{name}")
        keep = [MECHANISM_STATES.index(each) for each in own]
        once, pushed = A[np.ix_(keep, keep)], B[keep, axis, None]
        powers = [np.linalg.matrix_power(once, k) for k in range(steps + 1)]
        top, bottom = ss2tf(powers[-1], sum(powers[:-1]) @ pushed, np.eye(1, len(keep)), [[0.0]])
        found.append((top[0], bottom))
    return found


def _with_play(angle: Array, width: float) -> Array:
    """The angle behind a gap of a width in rad, shape (K, 2), the gap's middle at the first.

    In plain numbers, not arrays: a step depends on the one before.
    """
    if width == 0:
        return angle
    behind = np.empty_like(angle)
    half = width / 2
    for axis in (0, 1):
        at = float(angle[0, axis])
        out: list[float] = []
        for value in angle[:, axis].tolist():
            if value - at > half:
                at = value - half
            elif at - value > half:
                at = value + half
            out.append(at)
        behind[:, axis] = out
    return behind
