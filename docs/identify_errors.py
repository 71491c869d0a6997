"""Makes identify_errors.md: what identify says of rigs that its model does not describe.

uv run python docs/identify_errors.py

One axis of a rig with one error of the model each, simulated without any of the twin's code. A
plain model of five numbers is fitted by scipy for comparison.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.constants import g

from controllers.arrays import Array
from docs.five_numbers import fit_five_numbers_by_scipy, predict_five_numbers
from docs.pages import HERE, clopper_pearson, filled, kept, write
from twin.base.errors import LogError
from twin.cli.output import progress
from twin.identify.any_rig import identify_axes, join_logs
from twin.identify.axis_logs import AnyLog, AxisLog
from twin.identify.verdicts import Predicted
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
        lever: Effective height of the ball above the axis of the tilt.
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
    lever: float = 0.0

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
    x, v, servo, plate, turning, seen, bristle = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
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
        angles[k] = tilt = (before_step + plate) / 2
        push = rig.gain * tilt * (1 - rig.softening * abs(tilt)) + rig.level - rig.viscous * v
        push += 0.0 if across is None else across[k]
        turned, turning = turning, (plate - before_step) / h
        push -= rig.gain * rig.lever / g * (turning - turned) / h
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


def simulate_turned(
    seed: int, rig: Rig | Sequence[Rig], angle: float
) -> dict[str, tuple[Array, ...]]:
    """Logs as `simulate_log` gives them of both axes of a rig that are turned by an angle in rad.

    The tilt of each axis moves the ball along the other by its sine. Along y a positive tilt moves
    it the other way. The plate of y stays as it was without the turn of x.
    """
    along_x, along_y = (rig, rig) if isinstance(rig, Rig) else rig
    y = simulate_log(seed + 1000, along_y)
    x = simulate_log(seed, along_x, across=math.sin(angle) * along_x.gain * y[4])
    y = simulate_log(seed + 1000, along_y, across=-math.sin(angle) * along_y.gain * x[4])
    return {"x": x, "y": (y[0], y[1], y[2], -y[3], y[4])}


SECONDS = 24.0
"""Length of each of two logs: one is fitted, the other is predicted."""
TUBE_SECONDS = 48.0
"""The same of a tube."""
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
    "two_axes": ("axes turned by 1.5 to 4 deg, unequal dead times", {}),
    "mixed": ("rigs of others: up to three of these", {}),
}
"""Kind of an error of the model to its name in words, and the ranges of its size."""
CHECKED = ("gain", "delay", "friction")
TURNED_DEG, UNEQUAL_S = (1.5, 4.0), (0.02, 0.08)
"""Angle between axes of plate and camera, and difference of the dead times of both axes."""
MIXED: dict[str, tuple[float, float]] = {
    "gain": (1.5, 12.0),
    "dead_time": (0.01, 0.2),
    "lag": (0.01, 0.15),
    "friction": (0.0, 0.12),
    "viscous": (0.0, 0.5),
    "level": (-0.15, 0.15),
    "noise": (1e-4, 2e-3),
    "seconds": (16.0, 48.0),
}
"""Ranges of rigs of others, SI."""
MIXED_RATES, MIXED_PIXELS_M = (12.0, 200.0), (0.0, 0.0, 5e-4, 1e-3, 3e-3)
"""Their rates, by the logarithm, and steps of their positions."""
MAX_ERRORS = 3
"""Largest number of errors of the model of such a rig."""
UNITS = (1.0, 57.3, 1000.0, -11.4)
"""Numbers of the log by rad: radians, degrees, milliradians, counts of a servo that turns back."""


def draw_rig(kind: str, seed: int) -> Rig:
    """A rig with one error of the model, or as one of others."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    ranges = DRAWN | KINDS[kind][1]
    values: dict[str, Any] = {name: float(rng.uniform(*ends)) for name, ends in ranges.items()}
    if kind == "tube":
        few = {name: values[name] for name in ("gain", "friction", "noise")}
        return replace(TUBE, seconds=TUBE_SECONDS, dead_time=0.02 + values["lag"] / 2, **few)
    if kind == "mixed":
        return _draw_mixed(rng)
    return replace(Rig(seconds=SECONDS, told=kind != "untold"), **values)


def _draw_mixed(rng: np.random.Generator) -> Rig:
    values: dict[str, Any] = {name: float(rng.uniform(*ends)) for name, ends in MIXED.items()}
    values["rate"] = float(np.exp(rng.uniform(*np.log(MIXED_RATES))))
    values["pixel"] = float(rng.choice(MIXED_PIXELS_M))
    single = [name for name, (_, ranges) in KINDS.items() if ranges]
    for name in rng.choice(single, rng.integers(0, MAX_ERRORS + 1), replace=False):
        values |= {key: float(rng.uniform(*ends)) for key, ends in KINDS[name][1].items()}
    if rng.random() < 1 / 4:  # in a tube or on a short beam
        values |= {"stop": float(rng.uniform(0.035, 0.1)), "nervous": True}
    return Rig(**values, told=bool(rng.random() < 1 / 2))


def _make_logs(kind: str, seed: int) -> tuple[list[AnyLog], list[dict[str, float]]]:
    """Two logs of a rig of some kind, and what is true along each axis."""
    rig = draw_rig(kind, seed)
    rng = np.random.default_rng([seed, 7])
    rigs = [rig]
    unit = float(rng.choice(UNITS)) if kind == "mixed" else 1.0
    if kind == "two_axes":
        rigs = [rig, replace(rig, dead_time=rig.dead_time + float(rng.uniform(*UNEQUAL_S)))]
    turned = math.radians(rng.uniform(*TURNED_DEG))
    logs = []
    for run in (seed, seed + 5000):
        if kind == "two_axes":
            found = simulate_turned(run, rigs, turned)
        else:
            found = {"x": simulate_log(run, rig)}
        axes = {
            axis: AxisLog(time, unit * command, True, sampled, ball)
            for axis, (time, sampled, ball, command, _) in found.items()
        }
        units = dict.fromkeys(axes, "rad" if unit == 1.0 else "counts")
        logs.append(AnyLog("rig.csv", axes, units, ()))
    # along y a positive tilt moves the ball the other way
    truth = [
        {
            "gain": sign * each.gain / unit,
            "delay": each.dead_time + each.lag + each.filtered,
            "friction": each.friction,
        }
        for each, sign in zip(rigs, (1, -1), strict=False)
    ]
    return logs, truth


def identify_rig(kind: str, seed: int) -> dict[str, Any]:
    """What `identify` says of a rig, and how it and five numbers predict another log of it."""
    (fitted, held), truth = _make_logs(kind, seed)
    found = None
    try:
        found = identify_axes([fitted], [held])
    except LogError as error:
        refused = str(error)
    told: dict[str, list[Any]] = {name: [] for name in CHECKED}
    for axis, true in zip(fitted.axes, truth, strict=True):
        each = {v.name: v for v in found.verdicts} if found else {}
        for name in CHECKED:
            one = each.get(f"{name}_{axis}")
            told[name].append(
                {"truth": true[name], "low": one and one.low, "high": one and one.high}
                | {"word": one.word if one else ""}
            )
    predicted = found.predictions.get("x") if found else None
    errors = _compare_errors(fitted.axes["x"], held.axes["x"], predicted)
    return {"told": told, "errors": errors, "refused": "" if found else refused}


def _compare_errors(fitted: AxisLog, held: AxisLog, found: Predicted | None) -> dict[str, Any]:
    """Median errors of the predictions of an axis after 1 s where the ball moves, m.

    Of those that begin at the same times.
    """
    known, unseen = join_logs([fitted]), join_logs([held])
    plain = fit_five_numbers_by_scipy(known.time, known.tilt, known.sampled, known.ball)
    if found is None:
        return {}
    off = predict_five_numbers(
        plain, unseen.time, unseen.tilt, unseen.sampled, unseen.ball, found.begin
    )
    both = {
        "identify": found.errors("level followed", 1.0),
        "model": found.errors("model", 1.0),
        "five numbers": off,
    }
    same = found.moves & np.isfinite(list(both.values())).all(axis=0)
    return {who: float(np.median(np.abs(e[same]))) for who, e in both.items()}


def known_rig(kind: str, seed: int) -> dict[str, Any]:
    """The same, as kept, or found and then kept."""
    key = digest(f"{_read_sources()} {kind} {seed}")
    return kept("errors", key, lambda: identify_rig(kind, seed))


@cache
def _read_sources() -> str:
    """What the results depend on, as it is when the first rig is identified."""
    room = sorted(Path(str(files("twin.identify"))).rglob("*.py"))
    own = (Path(__file__), HERE / "five_numbers.py")
    return " ".join(each.read_text(encoding="utf-8") for each in (*own, *room))


def count_held(found: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """How many axes have a parameter identified, and how many of these intervals hold the truth."""
    told = [one for each in found for one in each["told"][name]]
    sure = [one for one in told if one["word"] == "identified"]
    held = sum(one["low"] <= one["truth"] <= one["high"] for one in sure)
    return {"of": len(told), "identified": len(sure), "held": held}


def make_page(found: dict[str, list[dict[str, Any]]]) -> str:
    """The page of what was found, kind to rigs."""
    rows = []
    for kind, rigs in found.items():
        errors = [each["errors"] for each in rigs if each["errors"]]
        medians = {
            who: 1000 * float(np.median([each[who] for each in errors]))
            for who in ("identify", "model", "five numbers")
        }
        better = {
            who: sum(each[who] <= each["five numbers"] for each in errors)
            for who in ("identify", "model")
        }
        rows.append(
            {
                "kind": KINDS[kind][0],
                "rigs": len(rigs),
                "refused": sum(bool(each["refused"]) for each in rigs),
                "counts": {name: count_held(rigs, name) for name in CHECKED},
                "medians": medians,
                "better": better,
                "compared": len(errors),
            }
        )
    return filled(
        "identify_errors",
        seconds=SECONDS,
        tube_seconds=TUBE_SECONDS,
        rows=rows,
        checked=CHECKED,
        interval=clopper_pearson,
    )


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
