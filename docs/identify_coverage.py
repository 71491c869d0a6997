"""Makes identify_coverage.md: how often the 95 % intervals of identify hold on simulated rigs.

uv run python docs/identify_coverage.py
uv run python docs/identify_coverage.py --rigs 50    # a quarter of it: some 15 minutes of a core

Logs of commands alone, one axis moved, of rigs that are simulated without any of the twin's code.
What has been identified is kept in runs/coverage and used again while the code stays the same.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import click
import numpy as np

from controllers.arrays import Array
from docs.pages import HERE, filled, kept, wilson, write
from twin.cli.output import progress
from twin.identify.any_logs import read_any
from twin.identify.any_rig import identify_axes
from twin.identify.log_columns import wanted_columns
from twin.study.work import digest

RIGS = 200
SECONDS = 45.0
"""Length of a log; a third of it is held out, as `identify` does."""
PLATE = 0.3
"""A ball that is farther away than this in m has left the plate: its rig is drawn again."""
DRAWN = {
    "rate": (30.0, 1000.0),
    "pixel": (5e-4, 1e-3),
    "dead_time": (0.02, 0.25),
    "lag": (0.02, 0.12),
    "gain": (4.0, 7.0),
    "level": (-0.1, 0.1),
    "friction": (0.01, 0.06),
    "camber": (0.3, 0.4),
    "lever": (0.0, 0.15),
}
"""Ranges from which rigs are drawn evenly, SI; the rate by its logarithm."""
COLUMNS = wanted_columns(
    "time=t:s,measured_x=x:m,command_phi=u:rad,measured_y=y:m,command_theta=v:rad"
)


def drawn(seed: int) -> dict[str, float]:
    """A rig."""
    rng = np.random.default_rng([seed, 35])
    rig = {name: float(rng.uniform(*ends)) for name, ends in DRAWN.items()}
    low, high = np.log(DRAWN["rate"])
    rig["rate"] = math.exp(low + (high - low) * rng.uniform())
    return rig


def log_of(seed: int, rig: Mapping[str, float]) -> tuple[Array, Array, Array]:
    """A log of it, under a controller as fast as its delays allow."""
    delay = rig["dead_time"] + rig["lag"]
    slow = 1 / (1 + 4 * delay)
    fast = min(3.0, 0.3 / delay)
    stiff = (fast**2 + rig["camber"]) / (rig["gain"] * slow)
    damped = 1.6 * fast / (rig["gain"] * slow**2)
    settings: dict[str, Any] = {**rig}
    return axis_log(seed, seconds=SECONDS, stiff=stiff, damped=damped, **settings)


def axis_log(
    seed: int,
    *,
    seconds: float = 60.0,
    rate: float = 30.0,
    gain: float = 6.0,
    dead_time: float = 0.1,
    lag: float = 0.08,
    level: float = 0.05,
    friction: float = 0.03,
    camber: float = 0.0,
    pixel: float = 5e-4,
    noise: float = 2e-4,
    jitter: float = 0.1,
    swing: float = 0.06,
    excited: bool = True,
    stiff: float = 0.9,
    damped: float = 0.45,
    dead_band: float = 0.0,
    slew: float = 0.0,
    play: float = 0.0,
    lever: float = 0.0,
    angles: bool = False,
) -> tuple[Array, Array, Array]:
    """Time in s, position in m and command in rad of one axis under a clumsy controller.

    Forward Euler at 0.25 ms. Half of the dead time lies between command and servo, half in the
    camera. The controller, PD on noisy readings, follows steps and sines that change with the seed.
    The servo stands until a command is further off than its dead band in rad, then goes all the
    way at its slew in rad/s (0 for at once). Behind its lag the plate follows across a gap of the
    width `play` in rad. The plate's angular acceleration moves the ball as one
    whose centre is above the plate's axis, by `lever` in m. `angles` logs the plate's in place of
    the commands.
    """
    rng = np.random.default_rng(seed)
    h = 2.5e-4
    steps = round(seconds / h)
    frames = [0.0]
    while frames[-1] < seconds:
        frames.append(frames[-1] + max(0.2, 1 + jitter * rng.standard_normal()) / rate)
    at = np.round(np.array(frames[:-1]) / h).astype(int)
    at = np.unique(at[at < steps])
    before, after = round(dead_time / 2 / h), round(dead_time / h) - round(dead_time / 2 / h)
    x, v, u, turning = 0.3 * swing * rng.standard_normal(), 0.0, 0.0, 0.0
    plate = 0.0
    places, sent = np.zeros(steps), np.zeros(steps)
    command, reading, last, speed, place, goal = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    target, until = 0.0, 0.0
    times, readings, commands, frame = [], [], [], 0
    for k in range(steps):
        places[k] = x
        if frame < len(at) and k == at[frame]:
            seen = places[max(0, k - after)] + noise * rng.standard_normal()
            reading = round(seen / pixel) * pixel if pixel else seen
            t = k * h
            if t >= until:
                target = swing * rng.uniform(-1, 1)
                until = t + rng.uniform(0.8, 3.0)
            dt = (at[frame] - at[frame - 1]) * h if frame else 1 / rate
            speed += min(1.0, dt / 0.08) * ((reading - last) / dt - speed)
            last = reading
            wave = 0.02 * math.sin(2.1 * t) + 0.015 * math.sin(5.3 * t + seed)
            slow = 1.0 / (1.0 + 4.0 * (dead_time + lag))
            command = slow * (stiff * (target - reading) - damped * slow * speed) + wave
            command = float(np.clip(command, -0.14, 0.14)) if excited else 0.0
            times.append(t)
            readings.append(reading)
            commands.append(plate if angles else command)
            frame += 1
        sent[k] = command
        wanted = sent[max(0, k - before)]
        goal = wanted if place != goal or abs(wanted - place) > dead_band else goal
        most = slew * h or math.inf
        place += min(max(goal - place, -most), most)
        u += h / lag * (place - u) if lag else place - u
        turned = min(max(plate, u - play / 2), u + play / 2) - plate
        plate += turned
        v -= gain * lever / 9.81 * (turned / h - turning)
        turning = turned / h
        a = gain * plate + level + camber * x
        if v == 0.0 and abs(a) <= friction:
            continue
        v = _after(h, v, a, friction)
        x += h * v
    return np.array(times), np.array(readings), np.array(commands)


def _after(h: float, v: float, a: float, friction: float) -> float:
    """Velocity in m/s after a step of h in s, in which the ball may turn, or come to rest."""
    slowed = a - friction * math.copysign(1.0, v or a)
    new = v + h * slowed
    return new if v * new >= 0 else new / slowed * math.copysign(max(abs(a) - friction, 0.0), a)


def identified(seed: int) -> dict[str, Any]:
    """A rig, and what `identify` says of it: parameter to value, ends of its interval, verdict."""
    for again in range(20):
        rig = drawn(seed + 10_000 * again)
        time, ball, command = log_of(seed, rig)
        if np.abs(ball).max() < PLATE:
            break
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"rig{seed}.csv"
        still = np.zeros_like(time)
        rows = np.column_stack((time, ball, command, 1e-4 * np.sin(time), still))
        np.savetxt(file, rows, fmt="%.6g", delimiter=",", header="t,x,u,y,v", comments="")
        found = identify_axes([read_any(file, COLUMNS)], 1 / 3)
    own = (each for each in found.verdicts if each.name.endswith("_x"))
    told = {each.name[:-2]: (each.value, each.low, each.high, each.word) for each in own}
    score = found.scores[0]
    errors = {who: score.median[who][1] for who in ("model", "stays", "goes on")}
    return {"rig": rig, "told": told, "errors": errors}


def known(seed: int) -> dict[str, Any]:
    """The same, as kept, or found and then kept."""
    room = sorted(Path(str(files("twin.identify"))).rglob("*.py"))
    how = " ".join(each.read_text(encoding="utf-8") for each in (Path(__file__), *room))
    return kept("coverage", digest(f"{how} {seed}"), lambda: identified(seed))


SHOWN = {
    "gain": ("gain", "m/s^2 by rad"),
    "dead_time": ("dead time", "s"),
    "lag": ("lag", "s"),
    "delay": ("dead time + lag", "s"),
    "lever": ("lever", "m"),
    "level": ("level", "m/s^2"),
    "friction": ("friction", "m/s^2"),
    "camber": ("camber", "1/s^2"),
}
"""Parameters that every rig has, in words, and their units."""


def coverage(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of each parameter: rigs with an interval, how many of these hold the truth, and verdicts."""
    rows = []
    for name in filter(SHOWN.__contains__, found[0]["told"] | {"camber": None}):
        of = [(_truth(each["rig"], name), each["told"].get(name)) for each in found]
        told = [(truth, *one) for truth, one in of if one is not None and None not in one[1:3]]
        held = sum(low <= truth <= high for truth, _, low, high, _ in told)
        off = [abs(value - truth) for truth, value, *_ in told if value is not None]
        half = [(high - low) / 2 for _, _, low, high, _ in told]
        rows.append(
            {
                "name": name,
                "rigs": len(told),
                "held": held,
                "share": wilson(held, len(told)),
                "identified": sum(word == "identified" for *_, word in told),
                "off": float(np.median(off)) if off else math.nan,
                "half": float(np.median(half)) if half else math.nan,
            }
        )
    return rows


def _truth(rig: Mapping[str, float], name: str) -> float:
    return rig["dead_time"] + rig["lag"] if name == "delay" else rig.get(name, 0.0)


def page(found: list[dict[str, Any]]) -> str:
    """The page of what was found."""
    names = {name: SHOWN.get(name, (name,))[0] for name in DRAWN}
    return filled(
        "identify_coverage",
        rigs=len(found),
        seconds=SECONDS,
        ranges=", ".join(
            f"{names[name]} {low:g} to {high:g}" for name, (low, high) in DRAWN.items()
        ),
        shown=SHOWN,
        rows=coverage(found),
        errors={
            who: f"{1000 * np.median([each['errors'][who] for each in found]):.2g}"
            for who in ("model", "stays", "goes on")
        },
    )


@click.command()
@click.option("--rigs", type=click.IntRange(min=1), default=RIGS, show_default=True)
def main(rigs: int) -> None:
    """How often the intervals of identify hold the truth of simulated rigs."""
    found = []
    with progress("rigs", rigs) as advance:
        for seed in range(rigs):
            found.append(known(seed))
            advance(seed + 1)
    write(HERE / "identify_coverage.md", page(found))


if __name__ == "__main__":
    main()
