"""Many scenarios as the rigs of one batch, each with the result it has alone.

What a run gives does not depend, to the last bit, on what shares its batch: only scenarios that are
``alike`` are put together, noise is drawn rig by rig, and no group is smaller than the sizes from
which on numpy and the plant calculate in one and the same way.

N simulated rigs that run side by side, and of which any may begin again while others go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from controllers.controller import PerRigReference
from controllers.interfaces import Measurement
from twin.errors import ScenarioError, TwinError
from twin.hal.supervisor import State
from twin.run.assemble import (
    OF_PLANTS,
    PLANTS,
    agree,
    assemble,
    build_friction,
    build_plant,
    build_rig,
    change_devices,
    change_transmission,
    differ,
    law_of,
    mistaken,
    own_errors,
    shared,
    without_error,
)
from twin.run.loop import RAN_AWAY, Ending, drive
from twin.run.metrics import Motion, measure, unjudged
from twin.run.record import Recorder
from twin.scenario import Scenario
from twin.settings import value_of
from twin.sim.plant.interface import SomeRigs
from twin.sim.rig import SimulatedRig

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
def simulate(
    scenarios: Sequence[Scenario], *, seen: bool = False, requested: list[Array] | None = None
) -> list[dict[str, Any]]:
    """The indicators of each scenario, all of them alike.

    Args:
        scenarios: What to run.
        seen: Whether to judge what the rig's computer sees, the ball as estimated and the plate
            as its encoders count, every few periods; by default the truth of every period.
        requested: Takes in what each controller requested, rad/s^2, shape (ticks, 2).

    Raises:
        KeyboardInterrupt: If the user interrupts.
        TwinError: If rigs or controllers cannot be built.
    """
    order = _padded(scenarios)
    first = scenarios[0]
    rig, controller = assemble([scenarios[i] for i in order], threads=1)
    ticks = round(first.duration / first.rig.period)
    late = [bool(scenario.controller.computing_time) for scenario in scenarios]
    record = Recorder(
        ticks,
        len(order),
        first.rig.period,
        keep=(
            *(("estimate", "measured", "applied") if seen else ("state", "applied")),
            *(["computing"] if any(late) else ()),
            *(["requested"] if requested is not None else ()),
        ),
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
        if requested is not None:
            requested.append(record["requested"][:, at].copy())
        if outcome.ending is not Ending.FINISHED:
            found.append(unjudged(outcome))
            continue
        motion = Motion.of(record, desired[paths[at]], at, seen=seen)
        if not late[index]:
            motion = replace(motion, lateness=None)
        found.append(measure(motion, outcome, **dict(scenario.metrics)))
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


EPISODES = ("rig.limits", "rig.cams", "sensors.noise_hold", "sensors.encoders.counts", "change")
"""Keys in which all episodes must agree, besides those in which the rigs of any batch must."""


class Episodes:
    """N rigs, each within an episode: a run of its own, from its own start.

    Rigs are those of ``ballplate run``, noise and limits included. What they look at together stays
    in step with the first of them: every 20 ms the plate is measured again, over 40 ms each the
    ball's speed is judged. An episode that begins a multiple of 40 ms after them has the same bits
    as one that begins with them.

    Args:
        scenarios: One per rig, that of its first episode.
        threads: Threads of the engine; 0 for one per processor.

    Raises:
        ScenarioError: If they differ in what all episodes must agree in, or change while running.
        ModelError: If the mechanism or its cam table cannot be used.

    Attributes:
        scenarios: One per rig, that of its present episode.
        measurement: The newest: ``y`` = (x, phi, y, theta), shape (N, 4), m and rad.
        applied: Plate rates that were applied in the last period, rad/s, shape (N, 2).
        ticks: Control periods since each episode began, shape (N,).
    """

    measurement: Measurement
    applied: Array
    ticks: NDArray[np.integer]

    def __init__(self, scenarios: Sequence[Scenario], *, threads: int = 0) -> None:
        self.scenarios = list(scenarios)
        self._threads = threads
        self._common = _common(self.scenarios[0])
        self.period = self.scenarios[0].rig.period
        """Control period in s."""
        if self.scenarios[0].change:
            raise ScenarioError("change: rigs of episodes do not change while they run")
        self._all = np.arange(len(self.scenarios))
        self.begin(self._all, self.scenarios)

    @property
    def state(self) -> Array:
        """The true states, shape (N, 8), as no real rig knows them."""
        return self._rig.devices.state

    @property
    def over(self) -> Mask:
        """Whose ball left the plate, was lost or passed a limit, shape (N,)."""
        stopped: Mask = self._rig.supervisor.state != State.RUNNING
        return stopped | self._rig.fallen | self._rig.diverged

    def reasons(self, rigs: NDArray[np.integer]) -> list[str]:
        """Why the episodes of some rigs are over, in words."""
        told, diverged = self._rig.supervisor.reason, self._rig.diverged
        found = [told[rig] or "ball left the plate" for rig in rigs]
        return [RAN_AWAY if ran else text for ran, text in zip(diverged[rigs], found, strict=True)]

    def begin(self, rigs: NDArray[np.integer], scenarios: Sequence[Scenario]) -> None:
        """Let some rigs begin an episode; the others do not notice, to the last bit.

        Args:
            rigs: Numbers of those that begin, shape (k,).
            scenarios: What each of them is from now on.

        Raises:
            ScenarioError: If they differ in what all episodes must agree in.
            ModelError: If a number is out of range.
        """
        for scenario in scenarios:
            agree(self._common, _common(scenario), "all episodes")
        before = list(self.scenarios)
        for rig, scenario in zip(rigs.tolist(), scenarios, strict=True):
            self.scenarios[rig] = scenario
        try:
            self._begin(rigs, before)
        except TwinError:
            self.scenarios[:] = before  # the plant is still theirs
            raise

    def _begin(self, rigs: NDArray[np.integer], before: Sequence[Scenario]) -> None:
        """Let rigs begin with their present scenarios."""
        if len(rigs) == len(self._all):
            plant, transmission = build_plant(self.scenarios, threads=self._threads)
            self._known = without_error(transmission)
            self._rig = build_rig(self.scenarios, plant, transmission)
            self.measurement = _own(_started(self._rig))
            self.applied = np.zeros((len(rigs), 2))
            self.ticks = np.zeros(len(rigs), int)
            return
        self._join(rigs, before)

    def _join(self, rigs: NDArray[np.integer], before: Sequence[Scenario]) -> None:
        """Let rigs be made of their present scenarios and begin among the others."""
        new, rig = [self.scenarios[each] for each in rigs], self._rig
        plant = rig.devices.plant
        old = [before[each] for each in rigs]
        if differ(OF_PLANTS, old, new):
            PLANTS[new[0].plant.kind].rebuild(plant, rigs, self.scenarios)
        change_devices(rig.devices, before, self.scenarios, plant=False)
        change_transmission(rig, self._known, before, self.scenarios)
        begun = build_rig(new, SomeRigs(plant, rigs), mistaken(self._known, new))
        seen = _started(begun)
        rig.devices.adopt(rigs, begun.devices)
        rig.adopt(rigs, begun)
        now = self.measurement
        for mine, theirs in ((now.y, seen.y), (now.age, seen.age), (now.touched, seen.touched)):
            mine[rigs] = theirs
        self.applied[rigs] = 0.0
        self.ticks[rigs] = 0

    def advance(self, rate: Array, ticks: int) -> Array:
        """Command plate rates for a number of control periods.

        Args:
            rate: Plate rates (phi', theta') in rad/s, shape (N, 2).
            ticks: How many.

        Returns:
            The true ball position after each, m, shape (ticks, N, 2).
        """
        rig, found = self._rig, np.empty((ticks, len(self._all), 2))
        for tick in range(ticks):
            self.applied = rig.write(rate)
            rig.wait()
            self.measurement = rig.read()
            found[tick] = rig.devices.state[:, 0::4]
        self.ticks = self.ticks + ticks
        self.applied, self.measurement = self.applied.copy(), _own(self.measurement)
        return found


def _started(rig: SimulatedRig) -> Measurement:
    """The first measurement of rigs that are switched on and started here.

    They are never switched off: a simulation holds nothing but memory.
    """
    rig.__enter__()
    seen = rig.read()
    rig.start()
    return seen


def _own(seen: Measurement) -> Measurement:
    """A measurement whose arrays are nobody else's: rigs that begin are put into them."""
    y, age, touched = seen.y.copy(), seen.age.copy(), seen.touched.copy()
    return Measurement(seen.time, y, age, touched, seen.state)


def _common(scenario: Scenario) -> dict[str, object]:
    return shared(scenario) | {key: value_of(scenario, key) for key in EPISODES}
