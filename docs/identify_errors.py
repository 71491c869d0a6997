"""Makes identify_errors.md: what identify says of rigs that its model does not describe.

uv run python docs/identify_errors.py

One axis of a rig with one error of the model each, simulated without any of the twin's code. A
plain model of five numbers is fitted by scipy for comparison.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter

from controllers.arrays import Array

STEP_S = 1e-3
"""Step of the simulation."""


@dataclass(frozen=True, kw_only=True)
class Rig:
    """An axis of a rig in SI units: a solid ball on a plate or beam, or in a tube.

    Attributes:
        seconds: Length of the log.
        rate: Positions in 1/s.
        gain: Acceleration by the tilt, m/s^2 by rad.
        dead_time: Half of it before the servo, half behind the camera.
        lag: Of the servo.
        friction: Against the direction of the ball, m/s^2.
        viscous: 1/s.
        level: m/s^2.
        noise: Standard deviation of a position.
        pixel: Step of the positions; 0 for none.
        stop: Distance of the end stops from the middle.
        restitution: Of a bounce.
        nervous: Whether the controller is one that drives the ball from stop to stop.
        play: Width of the gap between servo and plate, rad.
        filtered: Time constant of a filter of the positions.
        drift: By how much the clock of the positions goes faster, as a share.
        irregular: By what share of a period the times of rows are off at most.
        told: Whether the log has these times; else it has even ones.
        servo_step: Step of the servo, rad; the log has the finer command.
        softening: Share of the gain that is lost by rad of tilt.
        presliding: Way over which friction builds up, as Dahl has it.
    """

    seconds: float = 45.0
    rate: float = 60.0
    gain: float = 7.007
    dead_time: float = 0.05
    lag: float = 0.05
    friction: float = 0.025
    viscous: float = 0.0
    level: float = 0.0
    noise: float = 4e-4
    pixel: float = 0.0
    stop: float = math.inf
    restitution: float = 0.3
    nervous: bool = False
    play: float = 0.0
    filtered: float = 0.0
    drift: float = 0.0
    irregular: float = 0.0
    told: bool = True
    servo_step: float = 0.0
    softening: float = 0.0
    presliding: float = 0.0

    def turned(self, command: float) -> float:
        """Where the servo turns by a command, rad."""
        return round(command / self.servo_step) * self.servo_step if self.servo_step else command


TUBE = Rig(
    seconds=72.0,
    rate=100.0,
    gain=7.0,
    dead_time=0.04,
    lag=0.0,
    friction=0.05,
    noise=5e-4,
    pixel=1e-3,
    stop=0.04,
    nervous=True,
)
"""A steel ball in a tube of 8 cm, with a sensor of its distance, as teaching rigs have it."""


def simulate_log(seed: int, rig: Rig, across: Array | None = None) -> tuple[Array, ...]:
    """Times of commands and of positions in s, positions in m, commands and plate angles in rad.

    Trapezoids of 1 ms. The controller, proportional and differential on noisy positions,
    follows steps and sines that change with the seed.

    Args:
        seed: Of noise and motion.
        rig: What is simulated.
        across: Acceleration by the plate's other axis, m/s^2, at each step.
    """
    rng, h = np.random.default_rng(seed), STEP_S
    steps = round(rig.seconds / h)
    after = round(rig.dead_time / 2 / h)
    before = round(rig.dead_time / h) - after
    x, v, servo, plate, seen, bristle = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    shown, sent, angles = np.zeros((3, steps))
    due, until, target, command, last, speed, then = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    slow = 1 / (1 + 4 * (rig.dead_time + rig.lag))
    rows: list[tuple[float, float, float]] = []
    for k in range(steps):
        t = k * h
        seen = seen + h / rig.filtered * (x - seen) if rig.filtered else x
        shown[k] = seen
        if t >= due:
            place = shown[max(0, k - after)] + rig.noise * rng.standard_normal()
            if rig.pixel:
                place = round(place / rig.pixel) * rig.pixel
            passed = max(t - then, h)
            speed += min(1.0, passed / 0.08) * ((place - last) / passed - speed)
            last, then = place, t
            if t >= until:
                target, until = rng.uniform(-1, 1), t + rng.uniform(0.5, 2.0)
            if rig.nervous:
                command = 2 * (0.08 * target - place) - 0.35 * speed
                command = min(max(command + 0.03 * math.sin(3.1 * t + seed), -0.25), 0.25)
            else:
                command = slow * (0.9 * (0.06 * target - place) - 0.45 * slow * speed)
                command += 0.02 * math.sin(2.1 * t) + 0.015 * math.sin(5.3 * t + seed)
                command = min(max(command, -0.14), 0.14)
            rows.append((t if rig.told else len(rows) / rig.rate, place, command))
            due = (len(rows) + rig.irregular * rng.uniform(-1, 1)) / rig.rate
        sent[k] = command
        servo += (h / rig.lag if rig.lag else 1.0) * (rig.turned(sent[max(0, k - before)]) - servo)
        before_step = plate
        plate = min(max(plate, servo - rig.play / 2), servo + rig.play / 2)
        tilt = (before_step + plate) / 2
        angles[k] = tilt
        push = rig.gain * tilt * (1 - rig.softening * abs(tilt)) + rig.level - rig.viscous * v
        push += 0.0 if across is None else across[k]
        was, v = v, v + h * push
        if rig.presliding:
            bristle += h * (was - abs(was) * bristle) / rig.presliding
            v -= h * rig.friction * bristle
        else:
            v -= math.copysign(min(abs(v), h * rig.friction), v)
        x += h * (was + v) / 2
        if abs(x) > rig.stop:
            x, v = math.copysign(rig.stop, x), -rig.restitution * v
    time, ball, commands = np.array(rows).T
    return time, time * (1 + rig.drift), ball, commands, angles


LEAD_S, AHEAD_S = 0.4, 1.0
"""Windows of the plain model: time from which a prediction starts, and its length."""
GRID_S = 0.01
"""Step of its integrals."""


@dataclass(frozen=True)
class FiveNumbers:
    """x'' = gain u(t - dead time, behind a lag) + offset - damping x'.

    Attributes:
        gain: m/s^2 by the unit of the command.
        offset: m/s^2.
        damping: 1/s.
        dead_time: s.
        lag: s.
    """

    gain: float
    offset: float
    damping: float
    dead_time: float
    lag: float


def _responses(time: Array, command: Array, begin: Array, delays: Array) -> Array:
    """Ways from rest by command and offset, and by a speed of 1 m/s, on a grid, (3, W, N)."""
    dead_time, lag, damping = delays.tolist()
    grid = np.arange(time[0], time[-1], GRID_S)
    held = command[np.clip(np.searchsorted(time, grid, "right") - 1, 0, None)]
    stay = math.exp(-GRID_S / lag) if lag > GRID_S / 10 else 0.0
    lagged = lfilter([1 - stay], [1, -stay], held, zi=[stay * held[0]])[0]
    since = GRID_S * np.arange(round((LEAD_S + AHEAD_S + 0.1) / GRID_S))
    pushed = np.interp(begin[:, None] - LEAD_S + since - dead_time, grid, lagged)
    keeps = 1 - damping * GRID_S
    each = np.stack((pushed, np.ones_like(pushed)))
    speed = lfilter([0, GRID_S], [1, -keeps], each, axis=-1)
    way = lfilter([0, GRID_S], [1, -1], speed, axis=-1) + GRID_S / 2 * speed
    rolls = lfilter([0, GRID_S], [1, -1], keeps ** np.arange(len(since)))
    return np.concatenate((way, np.broadcast_to(rolls, (1, *way.shape[1:]))))


def _rows(sampled: Array, ball: Array, begin: Array, ways: Array) -> list[tuple[Array, ...]]:
    """Of each window: seconds since its beginning, positions, and the ways there, (3, K)."""
    since, rows = GRID_S * np.arange(ways.shape[-1]), list[tuple[Array, ...]]()
    for w, at in enumerate(begin):
        some = slice(*np.searchsorted(sampled, (at - LEAD_S, at + AHEAD_S + 0.05)))
        here = sampled[some] - at + LEAD_S
        rows.append((here, ball[some], np.stack([np.interp(here, since, e[w]) for e in ways])))
    return rows


def fit_five_numbers(time: Array, command: Array, sampled: Array, ball: Array) -> FiveNumbers:
    """The plain model by least squares of windows with a free start each, as a textbook has it."""
    begin = np.arange(sampled[0] + LEAD_S, sampled[-1] - AHEAD_S, AHEAD_S / 2)

    def solve(delays: Array) -> tuple[float, Array]:
        if (delays < 0).any() or delays[0] > 0.5 or delays[1] > 0.5 or delays[2] > 5:
            return 1e9, np.zeros(2)
        normal, size = np.zeros((3, 3)), 0
        ways = _responses(time, command, begin, delays)
        for _, where, way in _rows(sampled, ball, begin, ways):
            if len(where) < 8:
                continue
            start = np.linalg.qr(np.stack((np.ones_like(where), way[2]), axis=-1))[0]
            free = np.stack((way[0], way[1], where), axis=-1)
            free = free - start @ (start.T @ free)
            normal += free.T @ free
            size += len(where)
        found = np.linalg.lstsq(normal[:2, :2], normal[:2, 2], rcond=1e-12)[0]
        return float(normal[2, 2] - found @ normal[:2, 2]) / max(size, 1), found

    guesses = [(delay, lag, 0.1) for delay in (0.03, 0.1, 0.2) for lag in (0.01, 0.08)]
    best = min(guesses, key=lambda each: solve(np.array(each))[0])

    def cost(delays: Array) -> float:
        return 1e6 * solve(delays)[0]

    dead_time, lag, damping = minimize(cost, np.array(best), method="Nelder-Mead").x.tolist()
    gain, offset = solve(np.array([dead_time, lag, damping]))[1].tolist()
    return FiveNumbers(gain, offset, damping, dead_time, lag)


def predict_five_numbers(
    model: FiveNumbers, time: Array, command: Array, sampled: Array, ball: Array, begin: Array
) -> Array:
    """Errors of its predictions after 1 s in m, from some times in s on; NaN without a sample."""
    ways = _responses(time, command, begin, np.array([model.dead_time, model.lag, model.damping]))
    errors = np.full(len(begin), np.nan)
    for w, (since, where, way) in enumerate(_rows(sampled, ball, begin, ways)):
        lead, off = since < LEAD_S, np.abs(since - LEAD_S - AHEAD_S)
        if lead.sum() < 3 or off.min() > 0.06:
            continue
        last = int(off.argmin())
        pushed = model.gain * way[0] + model.offset * way[1]
        start = np.stack((np.ones_like(since), way[2]), axis=-1)
        begun = np.linalg.lstsq(start[lead], (where - pushed)[lead], rcond=None)[0]
        errors[w] = (pushed + start @ begun - where)[last]
    return errors
