"""From scenarios to the objects that run them: N simulated rigs and the controller of each.

There is one way: N scenarios make N rigs, one is N = 1. Whatever the scenarios say differently of
plant, surface, drives, sensors, cams, limits, start, law, observer and reference becomes an array
with one entry per rig; what the rigs of a batch have only once is refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from controllers.controller import Controller
from twin.errors import ScenarioError
from twin.hal.interface import Transmission
from twin.hal.limits import Limits
from twin.hal.rig import Rig
from twin.run.changes import changing
from twin.run.control import build_controllers
from twin.run.plants import build_plant
from twin.scenario.schema import Scenario
from twin.settings import filled, settings_of, value_of
from twin.sim.drives import DriveModel
from twin.sim.encoders import EncoderModel
from twin.sim.plant.interface import BallStart, Plant
from twin.sim.rig import SimulatedDevices, SimulatedRig
from twin.sim.touch import TouchModel

SHARED = ("plant.kind", "plant.step", "rig.period", "duration", "sensors.ideal")
"""Keys in which the rigs of a batch must agree: engine, time base, whether the truth is seen."""
SHARED_EXACT = ("plant.ball.mass", "plant.ball.radius", "plant.ball.inertia")
"""The same of rigs on the exact equations, besides."""


class Experiment(NamedTuple):
    """Rigs and the controller to drive them."""

    rig: SimulatedRig
    controller: Controller


def assemble(
    scenarios: Scenario | Sequence[Scenario],
    *,
    threads: int = 0,
    seeds: Sequence[np.random.SeedSequence] | None = None,
    anchor: float = Rig.ANCHOR,
    changeable: bool = False,
) -> Experiment:
    """N rigs and their controllers from N scenarios.

    Args:
        scenarios: One per rig, or one for a single rig.
        threads: Threads of the engine; 0 for one per processor.
        seeds: Root of the noise, one per rig; made from each scenario's seed by default, so that a
            rig has the same noise alone and in a batch.
        anchor: Time in s from one look of the rig at its measured plate angle to the next.
        changeable: Whether it may be told of further changes while it runs (``Changes.follow``).

    Raises:
        ScenarioError: If the parts do not fit together, or scenarios differ in what the rigs of a
            batch share.
        ModelError: If the mechanism or its cam table cannot be used.
    """
    each = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
    for other in each[1:]:
        agree(shared(each[0]), shared(other), "rigs that run side by side")
    controller = build_controllers(each)
    plant, transmission = build_plant(each, threads=threads)
    return Experiment(
        build_rig(each, plant, transmission, seeds, anchor, changeable=changeable), controller
    )


def build_rig(
    scenarios: Sequence[Scenario],
    plant: Plant,
    transmission: Transmission,
    seeds: Sequence[np.random.SeedSequence] | None = None,
    anchor: float = Rig.ANCHOR,
    *,
    changeable: bool = False,
) -> SimulatedRig:
    """The rigs of scenarios that agree in what a batch shares, around their plant.

    Args:
        scenarios: One per rig.
        plant: All of them.
        transmission: Plate angles to motor angles, as the rigs believe.
        seeds: Root of the noise, one per rig.
        anchor: Time in s from one look of the rig at its measured plate angle to the next.
        changeable: Whether they may be changed while they run, also where no scenario says so.
    """
    rig = SimulatedRig(
        build_devices(scenarios, plant, seeds=seeds),
        transmission=transmission,
        limits=filled(Limits, scenarios),
        period=scenarios[0].rig.period,
        ideal=scenarios[0].sensors.ideal,
        anchor=anchor,
    )
    if changeable or any(scenario.change for scenario in scenarios):
        rig.changes = changing(rig, rig.devices, transmission, scenarios)
    return rig


def shared(scenario: Scenario) -> dict[str, Any]:
    """What a scenario says of that in which the rigs of a batch must agree, by key."""
    keys = SHARED + (SHARED_EXACT if scenario.plant.kind == "lagrange" else ())
    return {key: value_of(scenario, key) for key in keys}


def agree(first: Mapping[str, Any], other: Mapping[str, Any], who: str) -> None:
    """Make sure that scenarios say the same of some keys.

    Raises:
        ScenarioError: If they do not, for ``who`` must.
    """
    for key, value in other.items():
        if first.get(key, value) != value:
            raise ScenarioError(f"{key}: {who} must agree, got {first[key]} and {value}")


def build_devices(
    scenarios: Sequence[Scenario],
    plant: Plant,
    *,
    period: float | None = None,
    seeds: Sequence[np.random.SeedSequence] | None = None,
    touch: TouchModel | None = None,
    encoders: EncoderModel | None = None,
) -> SimulatedDevices:
    """The scenarios' devices around their plant, the plant started.

    Args:
        scenarios: One per rig.
        plant: All of them.
        period: Control period in s; that of the scenarios by default.
        seeds: Root of the noise, one per rig.
        touch: Imperfections of the touch screen in place of the scenarios' own.
        encoders: Imperfections of the plate encoders in place of the scenarios' own.
    """
    start_plant(plant, scenarios)
    period = period or scenarios[0].rig.period
    holds = [round(max(s.sensors.noise_hold, s.rig.period) / period) for s in scenarios]
    if seeds is None:
        seeds = [np.random.SeedSequence(s.seed, spawn_key=(0,)) for s in scenarios]
    return SimulatedDevices(
        plant,
        period=period,
        touch=touch or filled(TouchModel, scenarios),
        encoders=encoders or filled(EncoderModel, scenarios),
        drives=filled(DriveModel, scenarios),
        hold=holds[0] if len(set(holds)) == 1 else np.array(holds),
        seeds=seeds,
    )


def start_plant(plant: Plant, scenarios: Sequence[Scenario]) -> None:
    """Put the balls where the scenarios start, the plates level."""
    start = filled(BallStart, scenarios)
    plant.start(np.broadcast_to(start.ball, (plant.rigs, 4)), start.spin)


def build_limits(table: Any) -> Limits:
    """The limits of a table ``limits`` of a scenario or a rig file, in SI units."""
    return Limits(
        **{
            name: about.unit.to_si(getattr(table, about.key.rpartition(".")[2]))
            for name, about in settings_of(Limits).items()
        }
    )
