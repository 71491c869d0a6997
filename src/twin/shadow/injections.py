"""Simulated rigs for trying the shadow: healthy ones, and ones that something happens to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from twin.identify.log import GRIPS, MECHANISM_LAG, Log
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario.load import load
from twin.scenario.schema import Scenario
from twin.scenario.study_step import at_study_step
from twin.shadow.belief import CONSTANT, PARAMETERS
from twin.shadow.plate import GAPS

DURATION = 60.0
"""Seconds of a run."""
AT = 20.0
"""When something happens, s."""
RAMP = 10.0
"""How long a ramp takes, s."""
ROLLING, BREAKAWAY = "plant.friction.rolling_mm", "plant.friction.breakaway_ratio"
DELAY, LEVEL = "sensors.touch.dead_time", "plant.level_deg"
BANDWIDTH, BACKLASH = "plant.servo.bandwidth_hz", "plant.servo.backlash_deg"
CAMS = "rig.cam_error_percent"
Drawn = Mapping[str, float | str]
Settings = dict[str, Any]
SPREADS = {"rolling": 0.15, "breakaway": 0.15, "delay": 0.003, "level": 0.05}
"""How rigs differ (standard deviations): rolling relative, breakaway ratio, s, deg."""


class Kind(NamedTuple):
    """Something that happens to a rig.

    Attributes:
        name: In words.
        causes: Which causes of ``twin.shadow.causes`` are right.
        ramps: Whether it can also come slowly.
    """

    name: str
    causes: tuple[str, ...]
    ramps: bool = True


KINDS = (
    Kind("rolling friction +30 %", ("rolling friction",)),
    Kind("level 0.1 deg", ("level",)),
    Kind("dead time +5 ms", ("dead time",)),
    Kind("another ball (steel)", ("another ball",), ramps=False),
    Kind("rolling friction -30 %", ("rolling friction",)),
    Kind("breakaway ratio +0.5", ("breakaway",)),
    Kind("servo lag 8 Hz", ("servo lag",), ramps=False),
    Kind("lost motion 0.1 deg", ("lost motion",)),
    Kind("cams 10 % wrong", ("cams",)),
    Kind("patch of three times the friction", ("patch of the screen",), ramps=False),
    Kind("screen's noise x 1.5", ("sensor noise",)),
)
"""The first four are those with goals."""
HEALTHY = Kind("healthy", ())


def rig(
    seed: int, scenario: str = "excite", kind: Kind = HEALTHY, drawn: Drawn | None = None
) -> tuple[Scenario, Scenario]:
    """What the twin believes of a rig drawn at random, and the rig itself.

    The belief is what an identification would have found: the truth but for its own errors.

    Args:
        seed: Which rig; an odd one gets a ramp where there can be one.
        scenario: What it does.
        kind: What happens to it.
        drawn: What the rig is, by dotted keys, ``key.0`` the first number of a list; by default
            it is drawn as ``SPREADS`` says.
    """
    rng = np.random.default_rng([seed, 18])
    known = _usual(rng) if drawn is None else _whole(drawn)
    true = _with_errors(known, rng)
    common = [f"duration={DURATION}", f"seed={seed}"]
    more = []
    if kind != HEALTHY:
        over = RAMP if seed % 2 and kind.ramps else 0.0
        more = [f"change=[{{at={AT}, over={over}, set={{{_change(kind, true, rng)}}}}}]"]
    belief, truth = ([f"{key}={value}" for key, value in each.items()] for each in (known, true))
    return (
        at_study_step(load(scenario, [*common, *belief])),
        at_study_step(load(scenario, [*common, *truth, *more])),
    )


def _usual(rng: np.random.Generator) -> Settings:
    """A rig like the one the project describes."""
    return {
        ROLLING: 0.18 * np.exp(SPREADS["rolling"] * rng.standard_normal()),
        BREAKAWAY: 1 + abs(SPREADS["breakaway"] * rng.standard_normal()),
        DELAY: 0.042 + SPREADS["delay"] * rng.standard_normal(),
        LEVEL: (SPREADS["level"] * rng.standard_normal(2)).tolist(),
    }


def _whole(drawn: Drawn) -> Settings:
    """Settings with the numbers of a list put together."""
    whole: Settings = {}
    for key, value in drawn.items():
        name, _, place = key.rpartition(".")
        if place.isdigit():
            whole.setdefault(name, []).append(value)
        else:
            whole[key] = value
    return whole


def _with_errors(known: Settings, rng: np.random.Generator) -> Settings:
    """A rig that differs from what is known of it by the errors of an identification."""
    off = dict(zip(PARAMETERS, rng.standard_normal(len(PARAMETERS)), strict=True))
    off = {name: CONSTANT[name] * error for name, error in off.items()}
    level = np.degrees([off["level_phi"], off["level_theta"]])
    true = {
        **known,
        ROLLING: known[ROLLING] * (1 + off["rolling"]),
        BREAKAWAY: max(1.0, known[BREAKAWAY] + off["breakaway"]),
        DELAY: known[DELAY] + off["delay"],
        LEVEL: (np.array(known[LEVEL]) + level).tolist(),
    }
    if BANDWIDTH in known:
        lag = 1 / (2 * np.pi * known[BANDWIDTH]) + off["lag"]
        true[BANDWIDTH] = 1 / (2 * np.pi * max(lag, 1e-3))
    if BACKLASH in known:
        true[BACKLASH] = max(0.0, known[BACKLASH] + np.degrees(GAPS[0]) * off["narrow_play"])
    if CAMS in known:
        true[CAMS] = [percent + float(100 * off["transmission"]) for percent in known[CAMS]]
    return true


def _change(kind: Kind, true: Settings, rng: np.random.Generator) -> str:
    """What happens to a rig, as the settings of a change."""
    heading = rng.uniform(0, 2 * np.pi)
    tilted = np.array(true[LEVEL]) + 0.1 * np.array([np.cos(heading), np.sin(heading)])
    return {
        "rolling friction +30 %": f'"{ROLLING}"={1.3 * true[ROLLING]}',
        "rolling friction -30 %": f'"{ROLLING}"={0.7 * true[ROLLING]}',
        "level 0.1 deg": f'"{LEVEL}"={tilted.tolist()}',
        "dead time +5 ms": f'"{DELAY}"={true[DELAY] + 0.005}',
        "another ball (steel)": '"plant.ball.mass"=0.263, "plant.ball.inertia"=4.208e-5, '
        f'"{ROLLING}"=0.05',
        "breakaway ratio +0.5": f'"{BREAKAWAY}"={true[BREAKAWAY] + 0.5}',
        "servo lag 8 Hz": f'"{BANDWIDTH}"=8.0',
        "lost motion 0.1 deg": f'"{BACKLASH}"=0.1',
        "cams 10 % wrong": f'"{CAMS}"=[10.0, 10.0]',
        "patch of three times the friction": f'"plant.surface.relative"={_patch(rng)}',
        "screen's noise x 1.5": '"sensors.touch.variance"=[1.632e-6, 3.987e-7]',
    }[kind.name]


def logs(pairs: Sequence[tuple[Scenario, Scenario]]) -> list[Log]:
    """Logs of rigs that run side by side, each with what is believed of it.

    Args:
        pairs: Belief and truth of each.
    """
    truths = [truth for _, truth in pairs]
    first = truths[0]
    period = first.rig.period
    record = Recorder(
        round(first.duration / period),
        len(pairs),
        period,
        keep=("measured", "age", "touched", "applied"),
    )
    simulated, controller = assemble(truths, threads=1)
    drive(simulated, controller, first.duration, record)
    found = []
    for index, (belief, _) in enumerate(pairs):
        measured = record["measured"][:, index]
        mechanism = belief.plant.kind == "mujoco"
        found.append(
            Log(
                source=f"rig {index}",
                time=record.time.copy(),
                ball=measured[:, 0::2],
                plate=measured[:, 1::2],
                age=record["age"][:, index, 0],
                touched=record["touched"][:, index, 0] > 0.5,
                command=period * np.cumsum(record["applied"][:, index], axis=0),
                model=belief.plant.ball.model,
                own_lag=MECHANISM_LAG if mechanism else period / 2,
                grips=GRIPS[belief.plant.kind],
                scenario=belief.model_dump(mode="json"),
            )
        )
    return found


def _patch(rng: np.random.Generator) -> str:
    """Relative friction on a grid of points, three times as much at one of the inner ones."""
    grid = np.ones((7, 5))
    grid[rng.integers(3, 5), rng.integers(2, 4)] = 3.0
    return str(grid.tolist())
