"""Many scenarios as the rigs of one batch, through the seam's own vectorised code.

What a run gives does not depend, to the last bit, on what shares its batch: only scenarios alike in
all that a batch has once are put together, noise is drawn rig by rig, and no group is smaller than
the sizes from which on numpy and the plant calculate in one and the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.interfaces import Law, Reference
from controllers.per_rig import Fleet, Paths
from controllers.stack import Controller, SampledReference
from twin.run.assemble import (
    build_controller,
    build_friction,
    build_limits,
    build_parts,
    build_plant,
)
from twin.run.loop import Ending, drive
from twin.run.metrics import Metrics, Motion, measure
from twin.run.record import Recorder
from twin.scenario import Scenario
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Plant
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.surface import SurfaceMap
from twin.sim.rig import SimulatedRig
from twin.study.bench import Rigs

LEAST = {"mujoco": 16, "lagrange": 2}
"""Rigs from which on a plant of each kind is calculated in the same way, however many there are."""
PAIR = 2
"""Rigs a law from which on its matrix products are rounded in the same way."""


@dataclass(kw_only=True)
class Excerpt(Recorder):
    """A record of what the indicators are made from: true state and applied accelerations."""

    def append(self, time: float, **channels: NDArray[Any]) -> None:
        """Take in one control period."""
        super().append(time, state=channels["state"], applied=channels["applied"])


def simulate(scenarios: Sequence[Scenario], controllers: Sequence[Controller]) -> list[Metrics]:
    """The indicators of each scenario, all with the same ``common``.

    Args:
        scenarios: What to run.
        controllers: Of each, as ``build_controller`` makes them.

    Raises:
        KeyboardInterrupt: If the user has enough.
        TwinError: If the plant cannot be built.
    """
    order = _padded(scenarios)
    padded = [scenarios[i] for i in order]
    first = padded[0]
    plant = _plant(padded)
    rig = SimulatedRig(
        Rigs(plant, padded),
        transmission=build_plant(first)[1],
        limits=build_limits(first.rig.limits),
        period=first.rig.period,
        ideal=first.sensors.ideal,
    )
    fleet = Fleet(_shared([controllers[i].law for i in order], padded))
    originals = [controller.reference.original for controller in controllers]
    paths = _Each(originals, order, first.rig.period)
    # An observer is as good for N rigs as for one: it begins with the measurements it is given.
    whole = Controller(fleet, build_controller(first).observer, paths, first.rig.period)
    ticks = round(first.duration / first.rig.period)
    record = Excerpt(ticks=ticks, rigs=len(order), period=first.rig.period)
    with np.errstate(all="ignore"):
        outcomes = drive(rig, whole, first.duration, record)
    if any(outcome.interrupted for outcome in outcomes):
        raise KeyboardInterrupt
    wished = {path: path(record.time)[0] for path in set(originals)}
    found = []
    for index, scenario in enumerate(scenarios):
        at = order.index(index)
        outcome = outcomes[at]
        if outcome.ending is not Ending.FINISHED:
            time, reason = outcome.time, outcome.reason
            found.append(Metrics(outcome=outcome.ending, outcome_time=time, reason=reason))
            continue
        judged = scenario.metrics
        motion = Motion.of(record, wished[originals[index]], at)
        found.append(measure(motion, outcome, start=judged.start, band_percent=judged.band_percent))
    return found


class _Each(SampledReference):
    """The references of N rigs, each evaluated once however many rigs follow it.

    Args:
        given: References, some perhaps one and the same or equal.
        order: Which of them each rig follows.
        period: Control period in s.
    """

    def __init__(self, given: Sequence[Reference], order: Sequence[int], period: float) -> None:
        members = list(dict.fromkeys(given))
        super().__init__(Paths(tuple(members)), period)
        self._which = np.array([members.index(given[i]) for i in order])

    def __call__(self, t: float | Array) -> Array:
        """Positions and four derivatives, shape (5, *shape(t), N, 2)."""
        return super().__call__(t).take(self._which, axis=-2)


def _law(scenario: Scenario) -> str:
    return scenario.controller.model_dump_json()


def _padded(scenarios: Sequence[Scenario]) -> list[int]:
    """Which scenario each rig runs: law by law, some twice so that no group is too small."""
    order = sorted(range(len(scenarios)), key=lambda i: _law(scenarios[i]))
    laws = [_law(scenarios[i]) for i in order]
    found = []
    for index, law in zip(order, laws, strict=True):
        found += [index] * (PAIR if laws.count(law) < PAIR else 1)
    lacking = max(0, LEAST[scenarios[0].plant.kind] - len(found))
    return found + [found[-1]] * lacking


def _shared(laws: Sequence[Law], scenarios: Sequence[Scenario]) -> list[Law]:
    """One object for laws with the same settings."""
    known: dict[str, Law] = {}
    return [known.setdefault(_law(s), law) for s, law in zip(scenarios, laws, strict=True)]


def _plant(scenarios: Sequence[Scenario]) -> Plant:
    first = scenarios[0].plant
    each = [scenario.plant for scenario in scenarios]
    friction = _stacked([build_friction(plant) for plant in each])
    ball = np.array([(s.x, s.x_rate, s.y, s.y_rate) for s in (plant.start for plant in each)])
    if first.kind == "lagrange":
        single = build_plant(scenarios[0])[0]
        assert isinstance(single, ExactPlant)
        exact = ExactPlant(
            single.model,
            rigs=len(each),
            step=first.step,
            friction=friction,
            level=np.radians([plant.level_deg for plant in each]),
        )
        exact.start(ball)
        return exact
    mechanism = Mechanism(
        rigs=len(each),
        step=first.step,
        threads=1,
        friction=friction or Friction(),
        parts=[build_parts(plant) for plant in each],
    )
    mechanism.start(ball, first.start.spin)
    return mechanism


def _stacked(each: Sequence[Friction | None]) -> Friction | None:
    """The frictions of N rigs as one; all are None, or none is."""
    given = [friction for friction in each if friction is not None]
    if not given:
        return None
    names = ("rolling", "breakaway_ratio", "stribeck_speed", "dwell_time", "viscous")
    numbers = {name: np.array([getattr(f, name) for f in given], float) for name in names}
    # a batch has one surface
    surface: SurfaceMap | None = given[0].map
    return replace(given[0], **numbers, map=surface)
