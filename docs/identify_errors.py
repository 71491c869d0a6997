"""Makes identify_errors.md: what identify says of rigs that its model does not describe.

uv run python docs/identify_errors.py

One axis of a rig with one error of the model each, simulated without any of the twin's code. A
plain model of five numbers is fitted by scipy for comparison.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter

from controllers.arrays import Array
from docs.pages import HERE, filled, kept, wilson, write
from twin.base.errors import LogError
from twin.cli.output import progress
from twin.identify.any_rig import identify_axes, join_logs, split_axes
from twin.identify.logs import AnyLog, AxisLog
from twin.study.work import digest

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


def simulate_turned(seed: int, rig: Rig, angle: float) -> dict[str, tuple[Array, ...]]:
    """Logs as `simulate_log` gives them of both axes of a rig that are turned by an angle in rad.

    The tilt of each axis moves the ball along the other by its sine. Along y a positive tilt moves
    it the other way. The plate of y stays as it was without the turn of x.
    """
    y = simulate_log(seed + 1000, rig)
    x = simulate_log(seed, rig, across=math.sin(angle) * rig.gain * y[4])
    y = simulate_log(seed + 1000, rig, across=-math.sin(angle) * rig.gain * x[4])
    return {"x": x, "y": (y[0], y[1], y[2], -y[3], y[4])}


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


SECONDS = 36.0
"""Length of a log; a third of it is held out."""
DRAWN = {
    "gain": (5.0, 8.0),
    "dead_time": (0.02, 0.1),
    "lag": (0.02, 0.1),
    "friction": (0.01, 0.06),
    "level": (-0.05, 0.05),
    "noise": (2e-4, 6e-4),
    "rate": (30.0, 100.0),
}
"""Ranges from which rigs are drawn evenly, SI."""
KINDS: dict[str, tuple[str, dict[str, tuple[float, float]]]] = {
    "none": ("none", {}),
    "play": ("play of 0.5 to 1.2 deg", {"play": (0.009, 0.021)}),
    "filtered": ("positions filtered with 40 to 100 ms", {"filtered": (0.04, 0.1)}),
    "drift": ("clock of the camera 200 to 800 ppm fast", {"drift": (2e-4, 8e-4)}),
    "untold": ("times off by 0.2 to 0.5 periods, logged as even", {"irregular": (0.2, 0.5)}),
    "servo_step": ("servo with steps of 0.5 to 1.5 deg", {"servo_step": (0.009, 0.026)}),
    "softening": ("gain that falls by 0.5 to 2 by rad", {"softening": (0.5, 2.0)}),
    "presliding": ("friction that builds up over 0.3 to 3 mm", {"presliding": (3e-4, 3e-3)}),
    "tube": ("end stops, a third of the time at one", {}),
}
"""Kind of an error of the model to its name in words, and the ranges of its size."""
CHECKED = ("gain", "delay", "friction")


def draw_rig(kind: str, seed: int) -> Rig:
    """A rig with one error of the model."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    ranges = DRAWN | KINDS[kind][1]
    values: dict[str, Any] = {name: float(rng.uniform(*ends)) for name, ends in ranges.items()}
    if kind == "tube":
        few = {name: values[name] for name in ("gain", "friction", "noise")}
        return replace(TUBE, seconds=72.0, dead_time=0.02 + values["lag"] / 2, **few)
    return replace(Rig(seconds=SECONDS, told=kind != "untold"), **values)


def identify_rig(kind: str, seed: int) -> dict[str, Any]:
    """A rig, and what `identify` and the plain model say of it."""
    rig = draw_rig(kind, seed)
    time, sampled, ball, command, _ = simulate_log(seed, rig)
    log = AnyLog("rig.csv", {"x": AxisLog(time, command, True, sampled, ball)}, {"x": "rad"}, ())
    truth = {
        "gain": rig.gain,
        "delay": rig.dead_time + rig.lag + rig.filtered,
        "friction": rig.friction,
    }
    try:
        found = identify_axes([log], 1 / 3)
    except LogError as error:
        return {"rig": asdict(rig), "truth": truth, "refused": str(error)}
    told = {each.name[:-2]: (each.value, each.low, each.high, each.word) for each in found.verdicts}
    known, held = (join_logs([each["x"]]) for each in split_axes(log, 1 / 3))
    plain = fit_five_numbers(known.time, known.tilt, known.sampled, known.ball)
    errors = {}
    if "x" in found.predictions:
        each = found.predictions["x"]
        both = {
            "identify": each.errors("level followed", 1.0),
            "five numbers": predict_five_numbers(
                plain, held.time, held.tilt, held.sampled, held.ball, each.begin
            ),
        }
        errors = {w: float(np.nanmedian(np.abs(e[each.moves]))) for w, e in both.items()}
    return {"rig": asdict(rig), "truth": truth, "told": told, "errors": errors}


def known_rig(kind: str, seed: int) -> dict[str, Any]:
    """The same, as kept, or found and then kept."""
    key = digest(f"{_read_sources()} {kind} {seed}")
    return kept("errors", key, lambda: identify_rig(kind, seed))


@cache
def _read_sources() -> str:
    """What the results depend on, as it is when the first rig is identified."""
    room = sorted(Path(str(files("twin.identify"))).rglob("*.py"))
    return " ".join(each.read_text(encoding="utf-8") for each in (Path(__file__), *room))


def count_held(found: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """How many rigs have a parameter identified, and how many of these intervals hold the truth."""
    told = [(each["truth"][name], each["told"].get(name)) for each in found if "told" in each]
    sure = [(truth, one) for truth, one in told if one and one[3] == "identified"]
    held = sum(one[1] <= truth <= one[2] for truth, one in sure)
    return {"identified": len(sure), "held": held, "share": wilson(held, len(sure))}


def make_page(found: dict[str, list[dict[str, Any]]]) -> str:
    """The page of what was found, kind to rigs."""
    rows = []
    for kind, rigs in found.items():
        errors = [each["errors"] for each in rigs if each.get("errors")]
        medians = {
            who: 1000 * float(np.median([each[who] for each in errors]))
            for who in ("identify", "five numbers")
        }
        better = sum(each["identify"] <= each["five numbers"] for each in errors)
        rows.append(
            {
                "kind": KINDS[kind][0],
                "rigs": len(rigs),
                "counts": {name: count_held(rigs, name) for name in CHECKED},
                "medians": medians,
                "better": better,
            }
        )
    return filled("identify_errors", seconds=SECONDS, rows=rows, checked=CHECKED)


@click.command()
@click.option("--rigs", type=click.IntRange(1), default=12, help="Rigs of each kind.")
def main(rigs: int) -> None:
    """Verdicts of identify on rigs that its model does not describe."""
    found: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    with progress("rigs", rigs * len(KINDS)) as advance:
        for k in range(rigs * len(KINDS)):
            kind = list(KINDS)[k % len(KINDS)]
            found[kind].append(known_rig(kind, k // len(KINDS)))
            advance(k + 1)
    write(HERE / "identify_errors.md", make_page(found))


if __name__ == "__main__":
    main()
