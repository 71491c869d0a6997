"""Simulated rigs for trying the shadow: healthy ones, and ones that something happens to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from controllers.ballplate import BallPlate
from twin.identify.log import GRIPS, MECHANISM_LAG, Log
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario.load import load
from twin.scenario.schema import Scenario
from twin.scenario.study_step import at_study_step
from twin.shadow.belief import CONSTANT

DURATION = 60.0
"""Seconds of a run."""
AT = 20.0
"""When something happens, s."""
RAMP = 10.0
"""How long a ramp takes, s."""
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


def rig(seed: int, scenario: str = "excite", kind: Kind = HEALTHY) -> tuple[Scenario, Scenario]:
    """What the twin believes of a rig drawn at random, and the rig itself.

    The belief is what an identification would have found: the truth but for its own errors.

    Args:
        seed: Which rig; an odd one gets a ramp where there can be one.
        scenario: What it does.
        kind: What happens to it.
    """
    rng = np.random.default_rng([seed, 18])
    rolling = 0.18 * np.exp(SPREADS["rolling"] * rng.standard_normal())
    breakaway = 1 + abs(SPREADS["breakaway"] * rng.standard_normal())
    delay = 0.042 + SPREADS["delay"] * rng.standard_normal()
    level = SPREADS["level"] * rng.standard_normal(2)
    off = rng.standard_normal(5)
    known = [
        f"plant.friction.rolling_mm={rolling}",
        f"plant.friction.breakaway_ratio={breakaway}",
        f"sensors.touch.dead_time={delay}",
        f"plant.level_deg=[{level[0]}, {level[1]}]",
    ]
    level = level + np.degrees(CONSTANT["level_phi"]) * off[:2]
    rolling *= 1 + CONSTANT["rolling"] * off[2]
    delay += CONSTANT["delay"] * off[3]
    breakaway = max(1.0, breakaway + CONSTANT["breakaway"] * off[4])
    true = [
        f"plant.friction.rolling_mm={rolling}",
        f"plant.friction.breakaway_ratio={breakaway}",
        f"sensors.touch.dead_time={delay}",
        f"plant.level_deg=[{level[0]}, {level[1]}]",
    ]
    common = [f"duration={DURATION}", f"seed={seed}"]
    heading = rng.uniform(0, 2 * np.pi)
    tilted = level + 0.1 * np.array([np.cos(heading), np.sin(heading)])
    what = {
        "rolling friction +30 %": f'"plant.friction.rolling_mm"={1.3 * rolling}',
        "rolling friction -30 %": f'"plant.friction.rolling_mm"={0.7 * rolling}',
        "level 0.1 deg": f'"plant.level_deg"=[{tilted[0]}, {tilted[1]}]',
        "dead time +5 ms": f'"sensors.touch.dead_time"={delay + 0.005}',
        "another ball (steel)": '"plant.ball.mass"=0.263, "plant.ball.inertia"=4.208e-5, '
        '"plant.friction.rolling_mm"=0.05',
        "breakaway ratio +0.5": f'"plant.friction.breakaway_ratio"={breakaway + 0.5}',
        "servo lag 8 Hz": '"plant.servo.bandwidth_hz"=8.0',
        "lost motion 0.1 deg": '"plant.servo.backlash_deg"=0.1',
        "cams 10 % wrong": '"rig.cam_error_percent"=[10.0, 10.0]',
        "patch of three times the friction": f'"plant.surface.relative"={_patch(rng)}',
        "screen's noise x 1.5": '"sensors.touch.variance"=[1.632e-6, 3.987e-7]',
    }
    if kind.name in what:
        over = RAMP if seed % 2 and kind.ramps else 0.0
        true.append(f"change=[{{at={AT}, over={over}, set={{{what[kind.name]}}}}}]")
    belief = at_study_step(load(scenario, [*common, *known]))
    return belief, at_study_step(load(scenario, [*common, *true]))


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
        measured, ball = record["measured"][:, index], belief.plant.ball
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
                model=BallPlate(mass=ball.mass, radius=ball.radius, inertia=ball.inertia),
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
