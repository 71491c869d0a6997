"""Assembles N simulated rigs, and the controller of each, from N scenarios.

There is one way: N scenarios make N rigs, one is N = 1. Whatever the scenarios state differently of
plant, surface, drives, sensors, cams, limits, start, law, observer and reference becomes an array
with one entry per rig; what the rigs of a batch have only once is refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from controllers.controller import Controller
from twin.base.errors import ScenarioError
from twin.base.settings import from_scenarios, settings_of, value_of
from twin.hal.interface import Limits, Transmission
from twin.hal.linkage import Linkage, TiltTable
from twin.hal.rig import Rig
from twin.run.controller_building import build_controllers
from twin.run.plants import build_plant, start_plant
from twin.run.rig_changes import changing
from twin.scenario.schema import Scenario
from twin.sim.drives import DriveModel
from twin.sim.plant.interface import Plant
from twin.sim.rig import SimulatedDevices, SimulatedRig
from twin.sim.sensors import EncoderModel, TouchModel

SHARED_KEYS = (
    *("plant.kind", "plant.step", "plant.axes", "rig.period", "duration", "sensors.ideal"),
    *(about.key for cls in (Linkage, TiltTable) for about in settings_of(cls).values()),
)
"""Keys in which the rigs of a batch must agree: engine, time base, whether the truth is seen, and
what tilts the plate."""
SHARED_EXACT = (
    *("plant.ball_spin", "plant.plate.height"),
    *(f"plant.ball.{of}" for of in ("mass", "radius", "inertia")),
)
"""Further keys in which the rigs of a batch on the exact equations must agree."""


class Assembled(NamedTuple):
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
    unseen: bool = False,
    as_alone: bool | None = None,
) -> Assembled:
    """N rigs and their controllers from N scenarios.

    Args:
        scenarios: One per rig, or one for a single rig.
        threads: Threads of the engine; 0 for one per processor.
        seeds: Root of the noise, one per rig; made from each scenario's seed by default, so that a
            rig has the same noise alone and in a batch.
        anchor: Time in s from one look of the rig at its measured plate angle to the next.
        changeable: Whether it accepts further changes while it runs (``Changes.follow``).
        unseen: Whether nobody sees how the plate is left, so that it need not be levelled.
        as_alone: As for ``build_plant``.

    Raises:
        ScenarioError: If the parts do not fit together, or scenarios differ in what the rigs of a
            batch share.
        ModelError: If the mechanism or its cam table cannot be used.
    """
    each = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
    for other in each[1:]:
        agree(batch_keys(each[0]), batch_keys(other), "rigs that run side by side")
    controller = build_controllers(each)
    plant, transmission = build_plant(each, threads=threads, as_alone=as_alone)
    rig = build_rig(each, plant, transmission, seeds, anchor, changeable=changeable)
    if unseen:
        rig.levelling_s = 0.0
    return Assembled(rig, controller)


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
        changeable: Whether they may be changed while they run, also where no scenario has changes.
    """
    rig = SimulatedRig(
        build_devices(scenarios, plant, seeds=seeds),
        transmission=transmission,
        limits=from_scenarios(Limits, scenarios),
        period=scenarios[0].rig.period,
        ideal=scenarios[0].sensors.ideal,
        anchor=anchor,
    )
    rig.supervisor.axes = scenarios[0].plant.axes
    if changeable or any(scenario.change for scenario in scenarios):
        rig.changes = changing(rig, rig.devices, transmission, scenarios)
    return rig


def batch_keys(scenario: Scenario) -> dict[str, Any]:
    """Values of the keys that must be equal within a batch."""
    keys = SHARED_KEYS + (SHARED_EXACT if scenario.plant.kind == "lagrange" else ())
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
        period: Control period in s; by default the period of the scenarios.
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
        touch=touch or from_scenarios(TouchModel, scenarios),
        encoders=encoders or from_scenarios(EncoderModel, scenarios),
        drives=from_scenarios(DriveModel, scenarios),
        hold=holds[0] if len(set(holds)) == 1 else np.array(holds),
        axes=scenarios[0].plant.axes,
        seeds=seeds,
    )
