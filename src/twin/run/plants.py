"""From scenarios to the plant of N rigs and what the rigs know of it, also while they run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.errors import ModelError, ScenarioError
from twin.hal.cams import CamTable, FixedRatio
from twin.hal.interface import Transmission
from twin.hal.rig import Rig
from twin.scenario.changing import at_time, times
from twin.scenario.schema import PLANTS as NAMED
from twin.scenario.schema import SLACK, Scenario
from twin.settings import changed, filled, per_rig, settings_of
from twin.sim.drives import DriveModel, PerRigTransmission, TransmissionError, WrongTransmission
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction, SurfaceMap, SurfaceModel
from twin.sim.plant.interface import Plant
from twin.sim.plant.parts import Parts
from twin.sim.rig import SimulatedDevices
from twin.sim.sensors import EncoderModel, TouchModel


def build_plant(scenarios: Sequence[Scenario], *, threads: int = 0) -> tuple[Plant, Transmission]:
    """The plant of N scenarios and the transmissions that its rigs believe in.

    Raises:
        ModelError: If the mechanism or its cam table cannot be used.
    """
    plant, known = PLANTS[scenarios[0].plant.kind].make(scenarios, threads)
    return plant, mistaken(known, scenarios)


def believed(scenario: Scenario) -> Transmission:
    """What the rig of a scenario believes of its cams; the mechanism is built only for its ratio.

    Raises:
        ModelError: If the mechanism or its cam table cannot be used.
    """
    if scenario.plant.kind == "mujoco" and scenario.rig.cams != "ratio":
        return mistaken(_cams(scenario.rig.cams, 1.0), [scenario])
    return build_plant([scenario])[1]


def mistaken(known: Transmission, scenarios: Sequence[Scenario]) -> Transmission:
    """A transmission with the errors that the scenarios have of it."""
    error = filled(TransmissionError, scenarios)
    return WrongTransmission(known, error) if error.any else known


OF_PLANTS = (Friction, SurfaceModel, Parts)
"""Dataclasses of what plants are made of."""


def differ(classes: Sequence[type], old: Sequence[Scenario], new: Sequence[Scenario]) -> bool:
    """Whether scenarios say something else of the settings of some dataclasses."""
    pairs = [pair for pair in zip(old, new, strict=True) if pair[0] is not pair[1]]
    return any(
        about.of(before) != about.of(after)
        for cls in classes
        for about in settings_of(cls).values()
        for before, after in pairs
    )


def _parts(scenarios: Sequence[Scenario]) -> list[Parts]:
    """What of each rig's mechanism differs from the model file."""
    return [changed(Parts, scenario) for scenario in scenarios]


def _exact(scenarios: Sequence[Scenario], threads: int) -> tuple[Plant, Transmission]:
    plant = ExactPlant(rigs=len(scenarios), step=scenarios[0].plant.step, **_equations(scenarios))
    return plant, FixedRatio()


def _equations(scenarios: Sequence[Scenario]) -> dict[str, Any]:
    """What scenarios say of the exact equations: ball, friction and level."""
    return {
        "model": scenarios[0].plant.ball.model,
        "friction": build_friction(scenarios),
        "level": per_rig(settings_of(Parts)["level"], scenarios),
    }


def _mechanism(scenarios: Sequence[Scenario], threads: int) -> tuple[Plant, Transmission]:
    from twin.sim.plant.mechanism import Mechanism  # noqa: PLC0415  heavy: loaded when needed

    plant = Mechanism(
        rigs=len(scenarios),
        step=scenarios[0].plant.step,
        threads=threads,
        friction=_friction(scenarios),
        parts=_parts(scenarios),
    )
    kinds = [scenario.rig.cams for scenario in scenarios]
    cams = {kind: _cams(kind, plant.ratio) for kind in set(kinds)}
    if len(cams) == 1:
        return plant, cams[kinds[0]]
    return plant, PerRigTransmission([cams[kind] for kind in kinds])


def _stays(plant: Any, *_: Any) -> None:
    kind = type(plant).__name__
    raise ModelError(f"plant.kind: {kind} cannot be changed while it runs; see PlantKind")


class PlantKind(NamedTuple):
    """A plant that ``plant.kind`` can name.

    Attributes:
        make: From N scenarios and a number of threads; the plant, and what its rigs know of cams.
        label: What a run on it is called beside runs on others.
        least: Rigs from which on it is calculated in the same way, to the bit, however many.
        change: Lets it go on as scenarios say; by default it cannot.
        rebuild: Lets rigs of some numbers be what the scenarios of all say.
        foresee: Does ahead of time what takes long of ``change``.
    """

    make: Callable[[Sequence[Scenario], int], tuple[Plant, Transmission]]
    label: str
    least: int = 16
    change: Callable[[Any, Sequence[Scenario]], None] = _stays
    rebuild: Callable[[Any, NDArray[np.integer], Sequence[Scenario]], None] = _stays
    foresee: Callable[[Any, Sequence[Scenario]], None] = _stays


PLANTS = {
    "lagrange": PlantKind(
        _exact,
        "exact equations",
        least=2,
        change=lambda plant, scenarios: plant.change(**_equations(scenarios)),
        rebuild=lambda plant, _, scenarios: plant.change(**_equations(scenarios)),
        foresee=lambda *_: None,
    ),
    "mujoco": PlantKind(
        _mechanism,
        "honest twin",
        change=lambda plant, scenarios: plant.change(_friction(scenarios), _parts(scenarios)),
        rebuild=lambda plant, rigs, scenarios: plant.rebuild(
            rigs, _parts([scenarios[rig] for rig in rigs]), _friction(scenarios)
        ),
        foresee=lambda plant, scenarios: plant.foresee(_parts(scenarios)),
    ),
}
"""The plants by what ``plant.kind`` calls them."""


def register(name: str, kind: PlantKind) -> None:
    """Let scenarios of this process name a further plant."""
    PLANTS[name] = kind
    if name not in NAMED:
        NAMED.append(name)


@lru_cache(maxsize=8)
def _cams(kind: str, ratio: float) -> Transmission:
    """What a rig knows of its cams."""
    if kind == "ratio":
        return FixedRatio(ratio)
    table = CamTable.packaged()
    return table.per_axis() if kind == "per_axis" else table


def build_friction(scenarios: Sequence[Scenario]) -> Friction | None:
    """The resistance of N balls on their screens; None if all are level and without friction."""
    surfaces = SurfaceMap.stacked([_drawn(_surface(scenario)) for scenario in scenarios])
    friction = filled(Friction, scenarios, map=surfaces)
    return None if friction.absent.all() and friction.map is None else friction


def _friction(scenarios: Sequence[Scenario]) -> Friction:
    return build_friction(scenarios) or Friction()


_surface = attrgetter(*(about.key for about in settings_of(SurfaceModel).values()))
"""What a scenario says of its surface."""


@lru_cache(maxsize=4096)
def _drawn(said: tuple[Any, ...]) -> SurfaceMap | None:
    """The map of a surface, drawn once: rigs that go on are asked for theirs again and again."""
    given = zip(settings_of(SurfaceModel).items(), said, strict=True)
    return SurfaceModel(**{name: about.unit.to_si(value) for (name, about), value in given}).map()


Act = Callable[[Sequence[Scenario], Sequence[Scenario]], None]
"""Is given what the scenarios of N rigs said until now, and what they say from now on."""


class RigChanges:
    """What changes of N rigs while they run; call it with the time before each period passes.

    Args:
        scenarios: One per rig.
        act: Makes the rigs what the scenarios say from now on.
    """

    def __init__(self, scenarios: Sequence[Scenario], act: Act) -> None:
        self.scenarios = tuple(scenarios)
        self._act = act
        self._times = times(scenarios)
        self.done = 0
        """How many of the times at which something changes have passed."""

    def stages(self) -> list[list[Scenario]]:
        """What the scenarios say from each of those times on."""
        return [[at_time(each, time) for each in self.scenarios] for time in self._times]

    def now(self) -> list[Scenario]:
        """What the scenarios say now."""
        if not self.done:
            return list(self.scenarios)
        return [at_time(each, self._times[self.done - 1]) for each in self.scenarios]

    def catch_up(self, time: float) -> None:
        """Let everything have happened that was due by a time in s, and nothing else."""
        self.done = 0
        if any(each < time + SLACK for each in self._times):
            self(time)

    def follow(self, scenarios: Sequence[Scenario], time: float) -> None:
        """Go on with scenarios that say the same until a time in s, and perhaps more from then."""
        self.scenarios = tuple(scenarios)
        self._times = times(scenarios)
        self.done = sum(each < time - SLACK for each in self._times)

    def __call__(self, time: float) -> None:
        """Change what has to be changed by a time in s."""
        before = self.done
        while self.done < len(self._times) and time > self._times[self.done] - SLACK:
            self.done += 1
        if self.done > before:
            old = self._times[before - 1] if before else -1.0
            self._act([at_time(each, old) for each in self.scenarios], self.now())


def change_devices(
    devices: SimulatedDevices,
    old: Sequence[Scenario],
    new: Sequence[Scenario],
    *,
    plant: bool = True,
) -> None:
    """Make simulated devices and their plant what scenarios say now.

    Args:
        devices: Of N rigs.
        old: What the scenarios said until now, one per rig.
        new: What they say now.
        plant: Whether the plant is to go on as they say, too.

    Raises:
        ModelError: If a number is out of range.
    """
    if plant and differ(OF_PLANTS, old, new):
        PLANTS[new[0].plant.kind].change(devices.plant, new)
    devices.change(
        touch=filled(TouchModel, new) if differ((TouchModel,), old, new) else None,
        encoders=filled(EncoderModel, new) if differ((EncoderModel,), old, new) else None,
        drives=filled(DriveModel, new) if differ((DriveModel,), old, new) else None,
    )


def change_transmission(
    rig: Rig, known: Transmission, old: Sequence[Scenario], new: Sequence[Scenario]
) -> None:
    """Give rigs the errors of what they know of their cams that scenarios have now.

    Args:
        rig: The rigs.
        known: The transmission without errors.
        old: What the scenarios said until now, one per rig.
        new: What they say now.
    """
    if differ((TransmissionError,), old, new):
        rig.replace_transmission(mistaken(known, new))


def without_error(transmission: Transmission) -> Transmission:
    """What a rig would know of its cams if it made no mistake."""
    return transmission.known if isinstance(transmission, WrongTransmission) else transmission


def changing(
    rig: Rig, devices: SimulatedDevices, transmission: Transmission, scenarios: Sequence[Scenario]
) -> RigChanges:
    """The changes of simulated rigs, made ready so that none of them takes long.

    Args:
        rig: The rigs.
        devices: What they are made of.
        transmission: Of the rigs.
        scenarios: One per rig.

    Raises:
        ScenarioError: If rigs on the exact equations would have different balls.
        ModelError: If a number is out of range.
    """
    known = without_error(transmission)

    def act(old: Sequence[Scenario], new: Sequence[Scenario]) -> None:
        change_devices(devices, old, new)
        change_transmission(rig, known, old, new)

    changes = RigChanges(scenarios, act)
    for stage in changes.stages():
        balls = {(each.plant.ball.mass, each.plant.ball.inertia) for each in stage}
        if len(balls) > 1 and stage[0].plant.kind == "lagrange":
            raise ScenarioError("change: plant.ball: rigs on the exact equations have one ball")
        PLANTS[stage[0].plant.kind].foresee(devices.plant, stage)
    return changes
