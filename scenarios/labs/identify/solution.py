"""Lab `identify`: friction and dead time from a log, its laps folded, its rests looked at."""

from pathlib import Path

import numpy as np
import pandas as pd

K1, C2, R = 5.886, 0.0932, 20.0  # m/s^2 for a unit sine of the slope; m; radius of the ball, mm
OMEGA = 0.7  # of the figure, rad/s
LATE = np.arange(0.01, 0.12, 0.001)  # dead times tried, s


def answer(rig: dict[str, float], folder: Path) -> dict[str, object]:
    """What the log in the folder tells, as intervals."""
    log = pd.read_csv(folder / "log.csv")
    columns = {name.split(" ")[0]: log[name].to_numpy() for name in log.columns}
    time = columns["time"]
    ball = np.stack([columns["measured_x"], columns["measured_y"]], axis=1)
    tilt = np.stack([columns["measured_phi"], -columns["measured_theta"]], axis=1)

    lap = 2 * np.pi / OMEGA
    begin = time[-1] - int((time[-1] - 3.0) // lap) * lap  # whole laps, the first seconds left out
    number = ((time - begin) // lap).astype(int)
    laps = [number == each for each in range(number.max())]
    found = np.array([fitted(time[each], ball[each], tilt[each]) for each in laps])
    arm, late = (interval(values) for values in found.T)
    slopes = taken_off(time, ball, tilt, np.mean(late))
    ratio: object = "not determined"
    if len(slopes) >= 5:
        # the plate goes on turning until the ball is seen to have left: the slope is read too large
        most = np.median(slopes) / max(np.mean(arm), 0.01)
        ratio = [0.78 * most, most]
    # laps do not show what is wrong in all of them alike: other harmonics, another least speed
    return {
        "rolling_mm": [0.985 * arm[0], 1.015 * arm[1]],
        "dead_time": [late[0] - 0.003, late[1] + 0.003],
        "breakaway_ratio": ratio,
    }


def interval(values: np.ndarray) -> tuple[float, float]:
    """Mean of the laps, and twice its standard deviation either way."""
    half = 2 * values.std(ddof=1) / np.sqrt(len(values))
    return values.mean() - half, values.mean() + half


def fitted(time: np.ndarray, ball: np.ndarray, tilt: np.ndarray) -> tuple[float, float]:
    """Arm in mm and dead time in s that explain a lap best.

    The ball: x'' = k1 sin(phi) - c2 phi'' - F x'/v, and so along y with -theta.
    """
    sine, angle = harmonics(time, np.sin(tilt)), harmonics(time, tilt)
    seen = harmonics(time, ball)
    at = np.linspace(0, 2 * np.pi / OMEGA, 600, endpoint=False)
    velocity = derived(seen, at, 1)
    speed = np.linalg.norm(velocity, axis=1)
    rolls = speed > 0.02  # m/s; slower, the additional friction at rest acts, too
    way = (velocity / speed[:, None])[rolls]
    way = way - way.mean(axis=0)
    best = (np.inf, 0.0, 0.0)
    for late in LATE:
        push = K1 * derived(sine, at - late, 0) - C2 * derived(angle, at - late, 2)
        left = (push - derived(seen, at, 2))[rolls]
        left = left - left.mean(axis=0)  # a plate out of level pushes evenly
        friction = (way * left).sum() / (way**2).sum()
        best = min(best, (((left - friction * way) ** 2).sum(), friction * R / K1, late))
    return best[1:]


def harmonics(time: np.ndarray, values: np.ndarray, count: int = 12) -> np.ndarray:
    """Complex amplitudes of the harmonics of a lap, shape (count, 2)."""
    turns = np.outer(time, OMEGA * np.arange(1, count + 1))
    basis = np.concatenate([np.ones((len(time), 1)), np.cos(turns), np.sin(turns)], axis=1)
    found = np.linalg.lstsq(basis, values, rcond=None)[0][1:]
    return found[:count] - 1j * found[count:]


def derived(amplitudes: np.ndarray, at: np.ndarray, order: int) -> np.ndarray:
    """A derivative of a series at some times, shape (n, 2), without its mean."""
    rates = 1j * OMEGA * np.arange(1, len(amplitudes) + 1)
    return (np.exp(np.outer(at, rates)) @ (amplitudes * rates[:, None] ** order)).real


def taken_off(time: np.ndarray, ball: np.ndarray, tilt: np.ndarray, late: float) -> np.ndarray:
    """Slopes, as an arm in mm, at which the ball set off after each rest."""
    step = time[1] - time[0]
    near = round(0.1 / step)
    window = np.hanning(2 * near + 1) / near
    smooth = np.stack([np.convolve(each, window, "same") for each in ball.T], axis=1)
    slow = np.linalg.norm(np.gradient(smooth, step, axis=0), axis=1) < 0.006
    slow[: round(3.0 / step)] = slow[-round(1.0 / step) :] = False
    edges = np.flatnonzero(np.diff(slow.astype(int))) + 1
    found = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if (end - begin) * step > 0.25:
            middle = (begin + end) // 2
            part = slice(middle, end + round(0.4 / step))
            way = np.linalg.norm(smooth[part] - smooth[middle], axis=1)
            first, then = np.argmax(way > 0.0015), np.argmax(way > 0.006)
            if then <= first:
                continue
            # from rest the root of the way grows evenly: back to where it was nothing
            root = np.sqrt(way[[first, then]])
            begun = first - (then - first) * root[0] / (root[1] - root[0])
            off = time[part][0] + begun * step - late
            found.append(R * np.interp(off, time, np.linalg.norm(np.sin(tilt), axis=1)))
    return np.array(found)
