"""Measures the dead time: the plate is rocked a little, the ball's path compared with it."""

from __future__ import annotations

from collections.abc import Iterator
from math import radians

import numpy as np
import scipy

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.devices.rig import HardwareRig
from twin.doctor.check import CheckResult, failed, passed, warned
from twin.errors import TwinError
from twin.hal.states import State

ROCKS = (radians(0.8), radians(2.0))
"""Plate angles of two rockings: more than the half degree on which friction holds a ball."""
TURNS = (3.0, 7.0)
"""Their angular frequencies, rad/s: a delay shifts phases in proportion to them, friction not."""
SECONDS = 10.0
PART = 2.5
"""Length in s of the parts that are fitted with a start, speed and tilt of their own: more than a
turn of the slower rocking, or that goes into them."""
SMOOTH = 0.5
"""Window in s over which the ball's direction is judged, by a polynomial of fourth order: in less,
noise turns it, and a wrong direction of the friction reads as another delay."""
DELAYS = np.arange(0.0, 0.2, 0.001)
"""Dead times tried, s."""


def dead_time(rig: HardwareRig, expected: float) -> Iterator[CheckResult]:
    """Rock the plate about both axes and measure the delay of the touch screen."""
    try:
        with rig:
            rig.start()
            time, y = _rock(rig)
            reason = rig.supervisor.reason[0]
    except TwinError as error:
        yield failed("dead time", str(error), "fix that first")
        return
    if reason or len(time) < SECONDS / rig.period / 2:
        advice = "see the reason; put the ball in the middle"
        yield failed("dead time", f"rocking was stopped: {reason}", advice)
        return
    found, rest = delay(time, y[:, 1::2], y[:, 0::2])
    seen = f"{1e3 * found:.0f} ms from touch to use, mean over a frame (fit to {1e3 * rest:.1f} mm)"
    if abs(found - expected) > 0.015:
        advice = f"set predictor.delay = {found:.3f} and sensors.touch.dead_time in the scenario"
        yield warned("dead time", f"{seen}; the scenario says {1e3 * expected:.0f} ms", advice)
    else:
        yield passed("dead time", seen)


def _rock(rig: HardwareRig) -> tuple[Array, Array]:
    """Times and measurements while the plate rocks about both axes and the ball runs."""
    times, values = [], []
    for _ in range(round(SECONDS / rig.period)):
        measurement = rig.read()
        if rig.supervisor.state[0] != State.RUNNING:
            break
        t = measurement.time
        times.append(t)
        values.append(measurement.y[0])
        # two swings a turn apart, begun softly: the ball stays about the middle
        both = zip(ROCKS, TURNS, strict=True)
        goal = min(1.0, t) * sum(rock * _swing(turn * t) for rock, turn in both)
        rig.write(10 * (goal - rig.supervisor.angle))
        rig.wait()
    return np.array(times), np.array(values)


def _swing(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle)])


def delay(time: Array, plate: Array, ball: Array) -> tuple[float, float]:
    """Dead time in s that explains a ball's measured path best, and the RMS error left in m.

    The ball's acceleration is c1 g sin(angle), (5.8) for small angles, less a friction against
    its measured direction. Both are integrated twice and of unknown size; every part has its own
    start, speed and tilt of the base.

    Args:
        time: Times of the measurements, s, shape (K,).
        plate: Measured plate angles (phi, theta), rad, shape (K, 2).
        ball: Measured ball positions, m, shape (K, 2).
    """
    pull = BallPlate().c1 * 9.81 * np.sin(plate) * [1.0, -1.0]
    window = max(5, round(SMOOTH / float(np.median(np.diff(time)))) | 1)
    speed = scipy.signal.savgol_filter(ball, window, 4, deriv=1, axis=0)
    size = np.linalg.norm(speed, axis=1, keepdims=True)
    against = -speed / np.maximum(size, 1e-12)
    way, friction = (_twice(each, time) for each in (pull, against))
    kept = time > time[0] + DELAYS[-1]
    parts = np.array_split(np.flatnonzero(kept), max(1, round(np.ptp(time[kept]) / PART)))
    rests = []
    for late in DELAYS:
        shifted = np.stack([np.interp(time - late, time, each) for each in way.T], axis=1)
        columns = np.stack((shifted, friction, ball), axis=2)
        bent = np.concatenate([_bend(time[part], columns[part]) for part in parts])
        rests.append(_rest(bent[..., :2].reshape(-1, 2), bent[..., 2].ravel()))
    best = int(np.argmin(rests))
    return float(DELAYS[best]), rests[best]


def _bend(time: Array, values: Array) -> Array:
    """What is left of the columns, shape (K, 2, 3), without start, speed and acceleration."""
    basis = np.vander(time - time[0], 3)
    flat = values.reshape(len(values), -1)
    rest = flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
    return np.asarray(rest.reshape(values.shape))


def _twice(rate: Array, time: Array) -> Array:
    """Integrated twice over time."""
    once = scipy.integrate.cumulative_trapezoid(rate, time, axis=0, initial=0)
    return np.asarray(scipy.integrate.cumulative_trapezoid(once, time, axis=0, initial=0))


def _rest(basis: Array, goal: Array) -> float:
    """What least squares leave over, root mean square."""
    rest = goal - basis @ np.linalg.lstsq(basis, goal, rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2)))
