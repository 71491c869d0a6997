"""Lets simulated rigs change while they run, when their scenarios say so."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from twin.errors import ScenarioError
from twin.hal.interface import Transmission
from twin.hal.rig import Rig
from twin.run.plants import change_plant, differ, mistaken, prepare_plant
from twin.scenario.changing import at_time, times
from twin.scenario.schema import SLACK, Scenario
from twin.settings import filled
from twin.sim.drives import DriveModel, TransmissionError, WrongTransmission
from twin.sim.plant.friction import Friction, SurfaceModel
from twin.sim.plant.parts import Parts
from twin.sim.rig import SimulatedDevices
from twin.sim.sensors import EncoderModel, TouchModel

Act = Callable[[Sequence[Scenario], Sequence[Scenario]], None]
"""Is given what the scenarios of N rigs said until now, and what they say from now on."""


class Changes:
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
    touch: dict[str, Any] | None = None,
    plant: bool = True,
) -> None:
    """Make simulated devices and their plant what scenarios say now.

    Args:
        devices: Of N rigs.
        old: What the scenarios said until now, one per rig.
        new: What they say now.
        touch: Imperfections of the touch screen that are not the scenarios' own.
        plant: Whether the plant is to go on as they say, too.

    Raises:
        ModelError: If a number is out of range.
    """
    if plant and differ((Friction, SurfaceModel, Parts), old, new):
        change_plant(devices.plant, new)
    devices.change(
        touch=replace(filled(TouchModel, new), **touch or {})
        if differ((TouchModel,), old, new)
        else None,
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
) -> Changes:
    """The changes of simulated rigs, made ready so that none of them takes long.

    Args:
        rig: The rigs.
        devices: What they are made of.
        transmission: Of the rigs.
        scenarios: One per rig.

    Raises:
        TwinError: If they cannot be made.
    """
    known = without_error(transmission)

    def act(old: Sequence[Scenario], new: Sequence[Scenario]) -> None:
        change_devices(devices, old, new)
        change_transmission(rig, known, old, new)

    return changing_devices(devices, scenarios, act)


def changing_devices(devices: SimulatedDevices, scenarios: Sequence[Scenario], act: Act) -> Changes:
    """Changes that an act makes, the plant made ready so that none of them takes long.

    Args:
        devices: What the rigs are made of.
        scenarios: One per rig.
        act: Makes the devices what the scenarios say.

    Raises:
        ScenarioError: If rigs on the exact equations would have different balls.
        ModelError: If a number is out of range.
    """
    changes = Changes(scenarios, act)
    for stage in changes.stages():
        balls = {(each.plant.ball.mass, each.plant.ball.inertia) for each in stage}
        if len(balls) > 1 and stage[0].plant.kind == "lagrange":
            raise ScenarioError("change: plant.ball: rigs on the exact equations have one ball")
        prepare_plant(devices.plant, stage)
    return changes
