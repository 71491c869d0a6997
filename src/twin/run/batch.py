"""Many scenarios as the rigs of one batch, each with the result it has alone.

What a run gives does not depend, to the last bit, on what shares its batch: only scenarios that are
``alike`` are put together, noise is drawn rig by rig, and no group is smaller than the sizes from
which on numpy and the plant calculate in one and the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from controllers.ballplate import BallPlate
from controllers.controller import PerRigReference
from twin.run.assemble import assemble, shared
from twin.run.control import law_of, own_errors
from twin.run.loop import Ending, drive
from twin.run.metrics import Metrics, Motion, measure
from twin.run.plants import PLANTS, build_friction
from twin.run.record import Recorder
from twin.scenario import Scenario

PAIR = 2
"""Matrix products of a law's rigs, a multiple of it, are rounded in the same way, whatever the
multiple: kernels of OpenBLAS take rows in pairs, and an odd one by another way."""

SEEN_EVERY = 5
"""Control periods from one instant to the next of what the rig's computer sees."""


def alike(scenario: Scenario) -> dict[str, Any]:
    """What scenarios must have in common to share a batch that changes none of their bits.

    Besides what the rigs of a batch share, that is what makes a plant or an observer calculate in
    another way.
    """
    friction = build_friction([scenario])
    surface = None if friction is None or friction.map is None else friction.map
    return shared(scenario) | {
        "observer": scenario.observer.model_dump(),
        "predictor": None if scenario.predictor is None else scenario.predictor.model_dump(),
        "model": repr(scenario.designed_on),
        "resisted": friction is not None,
        "free": friction is None or bool(friction.absent),
        "constant": friction is None or friction.constant,
        "ageing": friction is not None and friction.ageing,
        "balanced": not any(scenario.plant.ball.offset_mm),
        "level": any(scenario.plant.level_deg),
        "sloping": surface is not None and surface.sloping,
        "patches": surface is not None,
        "change": [change.model_dump() for change in scenario.change],
    }


@own_errors()
def simulate(scenarios: Sequence[Scenario], *, seen: bool = False) -> list[Metrics]:
    """The indicators of each scenario, all of them alike.

    Args:
        scenarios: What to run.
        seen: Whether to judge what the rig's computer sees, the ball as estimated and the plate
            as its encoders count, every few periods; by default the truth of every period.

    Raises:
        KeyboardInterrupt: If the user interrupts.
        TwinError: If rigs or controllers cannot be built.
    """
    order = _padded(scenarios)
    first = scenarios[0]
    rig, controller = assemble([scenarios[i] for i in order], threads=1)
    ticks = round(first.duration / first.rig.period)
    record = Recorder(
        ticks,
        len(order),
        first.rig.period,
        keep=("estimate", "measured", "applied") if seen else ("state", "applied"),
        every=SEEN_EVERY if seen else 1,
    )
    with np.errstate(all="ignore"):
        outcomes = drive(rig, controller, first.duration, record)
    if any(outcome.interrupted for outcome in outcomes):
        raise KeyboardInterrupt
    assert isinstance(controller.reference, PerRigReference)
    paths = controller.reference.members
    desired = {path: path(record.time)[0] for path in set(paths)}
    found = []
    for index, scenario in enumerate(scenarios):
        at = order.index(index)
        outcome = outcomes[at]
        if outcome.ending is not Ending.FINISHED:
            time, reason = outcome.time, outcome.reason
            found.append(Metrics(outcome=outcome.ending, outcome_time=time, reason=reason))
            continue
        judged = scenario.metrics
        motion = (Motion.seen if seen else Motion.of)(record, desired[paths[at]], at)
        found.append(measure(motion, outcome, start=judged.start, band_percent=judged.band_percent))
    return found


def _padded(scenarios: Sequence[Scenario]) -> list[int]:
    """Which scenario each rig runs: law by law, the last of one twice to make its number even."""
    groups: dict[tuple[str, BallPlate], list[int]] = {}
    for index, scenario in enumerate(scenarios):
        groups.setdefault(law_of(scenario), []).append(index)
    found: list[int] = []
    for its in groups.values():
        found += its + its[-1:] * (len(its) % PAIR)
    lacking = max(0, PLANTS[scenarios[0].plant.kind].least - len(found))
    return found + [found[-1]] * lacking
